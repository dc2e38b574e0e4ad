/* Pictures in files and in memory, by libjpeg, libwebp and OpenImageIO: image.c, jpg.c, webp.c,
 * png.c, image_shim.cc, image_resize.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_IMAGE_H
#define CODEC_IMAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/image/drone.h"
#include "codec/image/exif.h"
#include "core/base.h"

struct codec_limits;

#ifdef __cplusplus
extern "C" {
#endif

struct image { /* {0} is empty */
    /* channels: 1 or 3; for png and webp also 4, with alpha that is not premultiplied */
    uint32_t width_px, height_px, channels;
    uint8_t *px; /* [h][w][channels], sRGB values as stored */
};
/* The first function that needs OpenImageIO loads it. Loading takes 0.8 s of processor time and may
 * fail with ERR_NOENT (not installed) or ERR_INTERNAL. Plain JPEGs (jpg.h) and writing .png and
 * .webp do not need it. Any thread may call these functions. */
/* Reads a picture as 8-bit RGB. Grey is expanded and alpha dropped. The EXIF orientation is
 * ignored, as in COLMAP. Free it with image_free. ERR_NOENT, ERR_FORMAT (not an image; names the
 * file), ERR_LIMIT, ERR_MEM. */
enum err_code image_read(const char *path, const struct codec_limits *lim, struct image *out,
                         struct err *e) ERR_USE;
/* Reads the alpha of a picture into the first of three channels; out->px is NULL if it has none.
 * Free it with image_free. ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code image_read_alpha(const char *path, const struct codec_limits *lim, struct image *out,
                               struct err *e) ERR_USE;
/* Reads size, EXIF and the drone's XMP without decoding pixels. Where EXIF has no position, XMP's
 * is taken, and where EXIF does not say the hemisphere, XMP's signs. Any output may be NULL.
 * ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_IO, ERR_MEM. */
enum err_code image_read_info(const char *path, uint32_t *width_px, uint32_t *height_px,
                              struct image_gps *gps, struct drone_meta *drone,
                              struct err *e) ERR_USE;
/* Reads the first channel as floats [h][w]: 8- and 16-bit files as 0..1, float files (.pfm .tif
 * .exr) unchanged. It is for maps, not for photographs. Free *data with mem_free. ERR_NOENT,
 * ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code image_read_map(const char *path, const struct codec_limits *lim, uint32_t *width_px,
                             uint32_t *height_px, float **data, struct err *e) ERR_USE;
/* Writes .jpg, .png, .webp or .tif, by the extension. quality is 1..100 for jpg and webp (0 = 95);
 * jpg of 95 and more is 4:4:4. gps (may be NULL) becomes EXIF. ERR_ARG (extension), ERR_LIMIT (too
 * large for the format), ERR_IO, ERR_FORMAT (no place for EXIF), ERR_MEM, ERR_INTERNAL. */
enum err_code image_write(const char *path, const struct image *img, int quality,
                          const struct image_gps *gps, struct err *e) ERR_USE;
/* Appends an encoded picture to `out`. format is "jpg", "png" or "webp". ERR_ARG, ERR_LIMIT,
 * ERR_MEM, ERR_INTERNAL. */
enum err_code image_encode(const struct image *img, const char *format, int quality,
                           struct buf *out, struct err *e) ERR_USE;
/* Resizes with Lanczos3 (image_resize.c). Free *out with image_free. ERR_ARG (a size is 0),
 * ERR_MEM. */
enum err_code image_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                           struct image *out, struct err *e) ERR_USE;
/* Allocates a picture with pixels of 0. ERR_ARG, ERR_MEM. */
enum err_code image_alloc(uint32_t width_px, uint32_t height_px, uint32_t channels,
                          struct image *out, struct err *e) ERR_USE;
void image_free(struct image *img);

#ifdef __cplusplus
}
#endif
#endif
