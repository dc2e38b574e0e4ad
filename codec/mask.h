/* Masks: which pixels of a photograph are to be ignored (moving things, the sky, the drone itself).
 *
 * COLMAP's convention: one 8-bit picture a photograph, 0 = ignore (here: below 128), named
 * <photograph's name>.png. Ingest takes lens distortion out of them and stores them as
 * scene/masks/<name>.png; a photograph without one is used whole.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_MASK_H
#define CODEC_MASK_H

#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/err.h"

struct err;
struct image;
struct scene;

/* Path of a photograph's mask in a folder of masks. ERR_LIMIT. */
enum err_code mask_path(const char *dir, const char *photo_name, char out[FILE_PATH_MAX],
                        struct err *e) ERR_USE;
/* One channel, 255 = use, 0 = ignore. ERR_DATA names the file when its size is not the one given.
 * image_free it. ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_MEM as image_read. */
enum err_code mask_read(const char *path, uint32_t width_px, uint32_t height_px, struct image *out,
                        struct err *e) ERR_USE;
/* To another size: a pixel is ignored when any pixel under it is. image_free it. ERR_ARG,
 * ERR_MEM. */
enum err_code mask_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                          struct image *out, struct err *e) ERR_USE;
/* use[i] = 0 for every point that one of these photographs observes on an ignored pixel. Reads
 * scene/masks; nothing to do without it. use: [n_points]. Errors of mask_read: ERR_DATA,
 * ERR_FORMAT, ERR_LIMIT, ERR_MEM. Works on all cores. */
enum err_code mask_points(const struct scene *s, const uint32_t *images, size_t n_images,
                          uint8_t *use, struct err *e) ERR_USE;

#endif
