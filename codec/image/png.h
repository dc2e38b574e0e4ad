/* PNG by libdeflate. It encodes a map tile in a fraction of the time of libpng.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PNG_H
#define CODEC_PNG_H

#include "core/base.h"

/* Encodes px [h][w][channels]: 1 grey, 3 RGB, 4 RGB with alpha that is not premultiplied. Appends
 * to `out`. ERR_ARG (size, channels), ERR_MEM. */
enum err_code png_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                         uint32_t channels, struct buf *out, struct err *e) ERR_USE;
/* Encodes 16-bit grey [h][w] with a text chunk: keyword (Latin-1, 1 to 79 bytes) and text. Appends
 * to `out`. ERR_ARG, ERR_MEM. */
enum err_code png_encode_grey16(const uint16_t *px, uint32_t width_px, uint32_t height_px,
                                const char *keyword, const char *text, struct buf *out,
                                struct err *e) ERR_USE;
#endif
