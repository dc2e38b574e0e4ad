/* Masks: which pixels of a photograph are to be ignored (moving things, the sky, the drone itself).
 *
 * COLMAP's convention: one 8-bit picture a photograph, 0 = ignore (here: below 128), named
 * <photograph's name>.png. Ingest takes lens distortion out of them and stores them as
 * scene/masks/<name>.png; a photograph without one is used whole.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_MASK_H
#define TRAIN_MASK_H

#include "train/ingest.h"
#include "train/train.h"

/* Path of a photograph's mask in a folder of masks. ERR_LIMIT. */
enum err_code mask_path(const char *dir, const char *photo_name, char out[FILE_PATH_MAX],
                        struct err *e) ERR_USE;
/* One channel, 255 = use, 0 = ignore. ERR_DATA names the file when its size is not the one given.
 * image_free it. */
enum err_code mask_read(const char *path, uint32_t width_px, uint32_t height_px, struct image *out,
                        struct err *e) ERR_USE;
/* To another size: a pixel is ignored when any pixel under it is. */
enum err_code mask_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                          struct image *out, struct err *e) ERR_USE;
/* The mask of a photograph for the pinhole picture that ingest makes of it, as PNG. */
enum err_code mask_convert(const struct ingest_view *v, const char *from, const char *to,
                           struct err *e) ERR_USE;
/* use[i] = 0 for every point that one of these photographs observes on an ignored pixel. Reads
 * scene/masks; nothing to do without it. */
enum err_code mask_points(const struct scene *s, const uint32_t *images, size_t n_images,
                          uint8_t *use, struct err *e) ERR_USE;

/* Robust weighting: ignore (0) the pixels whose residual is more than 3 * 1.4826 MAD above the
 * median residual, where most of their 5 x 5 neighbours are such pixels too, so that thin detail is
 * not taken for a moving thing (RobustNeRF, Sabour 2023, trims the same way). color: planar
 * [3][h][w]; px: [h][w][3]; out: [h][w], pixels that are 0 in it stay 0; scratch: [h][w]. */
void mask_robust(const float *color, const uint8_t *px, uint32_t width_px, uint32_t height_px,
                 float *scratch, uint8_t *out);

#endif
