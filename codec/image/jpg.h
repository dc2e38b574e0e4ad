/* Plain JPEG pictures, by libjpeg alone. OpenImageIO uses the same library and needs 250 others:
 * 0.8 s of processor time in each process that reads or writes a photograph.
 *
 * A plain picture has 8 bits, is grey or has three channels, and is undamaged. For any other
 * picture these functions return false without a reason. image.c then asks OpenImageIO, which
 * handles the picture or gives the reason.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_JPG_H
#define CODEC_JPG_H

#include <stdbool.h>
#include <stdint.h>

struct buf;
struct jpg; /* an open file */

/* Reads the head. The size is as the file states it and unchecked. Returns whether the file is
 * plain; if so, the caller closes *out. */
bool jpg_open(const char *path, struct jpg **out, uint32_t *width_px, uint32_t *height_px);
/* Reads the pixels as RGB: px [h][w][3]. Call it once. Grey is expanded. Returns whether nothing is
 * damaged or missing. */
bool jpg_read(struct jpg *j, uint8_t *px);
void jpg_close(struct jpg *j); /* NULL is allowed */

/* Appends the picture px [h][w][channels] as a file to `out`. quality is 1..100; from 95 on chroma
 * is not subsampled. The bytes are those that OpenImageIO writes. Returns whether it was encoded;
 * if not, `out` is as it was. */
bool jpg_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px, uint32_t channels,
                int quality, struct buf *out);

#endif
