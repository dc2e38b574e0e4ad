/* WebP by libwebp: lossy, in a fraction of the time that OpenImageIO's plugin takes, which asks for
 * the slowest search, and lossless, for bytes that are no picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_WEBP_H
#define CODEC_WEBP_H

#include "core/base.h"

/* px [h][w][channels], 3 or 4 with alpha that is not premultiplied and is kept exactly; quality 1
 * to
 * 100. Appended to out. ERR_ARG (size, channels), ERR_MEM, ERR_INTERNAL. */
enum err_code webp_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                          uint32_t channels, int quality, struct buf *out, struct err *e) ERR_USE;
/* Every byte of px [h][w][4] as it is. Appended to out. ERR_ARG (size), ERR_MEM, ERR_INTERNAL. */
enum err_code webp_encode_exact(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                                struct buf *out, struct err *e) ERR_USE;
/* *px [h][w][4], lossless or lossy; mem_free it. Hostile bytes are safe. ERR_FORMAT, ERR_LIMIT
 * (more than most_px pixels), ERR_MEM. */
enum err_code webp_decode(const void *bytes, size_t n, size_t most_px, uint8_t **px,
                          uint32_t *width_px, uint32_t *height_px, struct err *e) ERR_USE;
#endif
