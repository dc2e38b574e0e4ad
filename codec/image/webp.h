/* WebP by libwebp: lossy for pictures, lossless for other bytes. OpenImageIO's plugin is many times
 * slower, because it asks for the slowest search.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_WEBP_H
#define CODEC_WEBP_H

#include "core/base.h"

/* Encodes px [h][w][channels] with loss. 4 channels: alpha is not premultiplied and is kept
 * exactly. quality is 1 to 100. Appends to `out`. ERR_ARG (size, channels), ERR_MEM, ERR_INTERNAL.
 */
enum err_code webp_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                          uint32_t channels, int quality, struct buf *out, struct err *e) ERR_USE;
/* Encodes px [h][w][4] without loss. Appends to `out`. ERR_ARG (size), ERR_MEM, ERR_INTERNAL. */
enum err_code webp_encode_exact(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                                struct buf *out, struct err *e) ERR_USE;
/* Decodes *px [h][w][4], lossless or lossy. Hostile bytes are safe. Free it with mem_free.
 * ERR_FORMAT, ERR_LIMIT (more than most_px pixels), ERR_MEM. */
enum err_code webp_decode(const void *bytes, size_t n, size_t most_px, uint8_t **px,
                          uint32_t *width_px, uint32_t *height_px, struct err *e) ERR_USE;
#endif
