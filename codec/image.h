/* Pictures in files and in memory (OpenImageIO): image.c, image_shim.cc, image_resize.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_IMAGE_H
#define CODEC_IMAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/drone.h"
#include "codec/exif.h"
#include "core/base.h"

struct codec_limits;

#ifdef __cplusplus
extern "C" {
#endif

struct image {                              /* {0} is empty */
    uint32_t width_px, height_px, channels; /* 1 or 3; 4 with alpha, not premultiplied: png, webp */
    uint8_t *px;                            /* [h][w][channels], sRGB values as stored */
};
/* Load OpenImageIO now instead of with the first image: 0.4 s. Any thread. All that read, and write
 * .jpg and .tif, do it and fail as it does: ERR_NOENT (not installed), ERR_INTERNAL. */
enum err_code image_load(struct err *e) ERR_USE;
/* Read as 8-bit RGB (grey is expanded, alpha dropped), EXIF orientation ignored as COLMAP does.
 * ERR_NOENT, ERR_FORMAT (not an image; says which file), ERR_LIMIT, ERR_MEM. image_free it. */
enum err_code image_read(const char *path, const struct codec_limits *lim, struct image *out,
                         struct err *e) ERR_USE;
/* Size, EXIF and drones' XMP only, without decoding pixels. Any output may be NULL. ERR_NOENT,
 * ERR_FORMAT, ERR_LIMIT, ERR_IO, ERR_MEM. */
enum err_code image_read_info(const char *path, uint32_t *width_px, uint32_t *height_px,
                              struct image_gps *gps, struct drone_meta *drone,
                              struct err *e) ERR_USE;
/* First channel as floats, [h][w]: 8- and 16-bit files as 0..1, float files (.pfm .tif .exr) as
 * they are. For maps, not photographs. *data is allocated; mem_free it. ERR_NOENT,
 * ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code image_read_map(const char *path, const struct codec_limits *lim, uint32_t *width_px,
                             uint32_t *height_px, float **data, struct err *e) ERR_USE;
/* By extension: .jpg .png .webp .tif. quality 1..100 for jpg and webp (0 = 95; jpg >= 95 writes
 * 4:4:4). gps (may be NULL) goes into EXIF. ERR_ARG (extension), ERR_LIMIT (larger than the format
 * holds), ERR_IO, ERR_FORMAT (no place for EXIF), ERR_MEM, ERR_INTERNAL. */
enum err_code image_write(const char *path, const struct image *img, int quality,
                          const struct image_gps *gps, struct err *e) ERR_USE;
/* The same into memory, appended to out; format is "jpg", "png" or "webp". ERR_ARG, ERR_LIMIT,
 * ERR_MEM, ERR_INTERNAL. */
enum err_code image_encode(const struct image *img, const char *format, int quality,
                           struct buf *out, struct err *e) ERR_USE;
/* image_resize.c: Lanczos3. out is allocated; image_free it. ERR_ARG (a size of 0), ERR_MEM. */
enum err_code image_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                           struct image *out, struct err *e) ERR_USE;
/* Zeroed pixels. ERR_ARG, ERR_MEM. */
enum err_code image_alloc(uint32_t width_px, uint32_t height_px, uint32_t channels,
                          struct image *out, struct err *e) ERR_USE;
void image_free(struct image *img);

#ifdef __cplusplus
}
#endif
#endif
