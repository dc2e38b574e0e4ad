/* Masks: pixels of a photograph to ignore (moving things, the sky, the drone itself).
 *
 * They follow COLMAP's convention: one 8-bit picture a photograph, named <photograph's name>.png. A
 * value below 128 means ignore; where none is above, 0 does (so in COLMAP). Ingest removes lens
 * distortion from masks and stores them as scene/masks/<name>.png. A photograph without a mask is
 * used whole.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_MASK_H
#define CODEC_MASK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/err.h"

struct err;
struct image;
struct scene;

/* Path of a photograph's mask in the folder `dir`. ERR_LIMIT. */
enum err_code mask_path(const char *dir, const char *photo_name, char out[FILE_PATH_MAX],
                        struct err *e) ERR_USE;
/* Reads a mask: one channel, 255 = use, 0 = ignore. The first of a process that has greys from 1 to
 * 127 alone is reported: it masks nothing. Free it with image_free. ERR_DATA names the
 * file: the mask has another size, or several colours. ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_MEM as
 * in image_read. */
enum err_code mask_read(const char *path, uint32_t width_px, uint32_t height_px, struct image *out,
                        struct err *e) ERR_USE;
/* Whether all of it is ignored. */
bool mask_is_empty(const uint8_t *px, size_t n);
/* As mask_read, from the alpha of a photograph. out->px is NULL if it has none, none below 128, or
 * nothing else (*blank), which is no mask. ERR_DATA, ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code mask_read_alpha(const char *photo, uint32_t width_px, uint32_t height_px,
                              struct image *out, bool *blank, struct err *e) ERR_USE;
/* Changes the size of a mask. An output pixel is ignored if any input pixel under it is. Free *out
 * with image_free. ERR_ARG, ERR_MEM. */
enum err_code mask_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                          struct image *out, struct err *e) ERR_USE;
/* Sets use[i] = 0 for every point that one of these photographs observes on an ignored pixel. use
 * [n_points]. It reads scene/masks; without that folder it does nothing. It uses all cores.
 * ERR_DATA, ERR_FORMAT, ERR_LIMIT, ERR_MEM as in mask_read. */
enum err_code mask_points(const struct scene *s, const uint32_t *images, size_t n_images,
                          uint8_t *use, struct err *e) ERR_USE;

#endif
