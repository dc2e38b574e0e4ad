/* WebP by libwebp: lossy, in a fraction of the time that OpenImageIO's plugin takes, which asks for
 * the slowest search.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_WEBP_H
#define CODEC_WEBP_H

#include "core/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* px [h][w][channels], 3 or 4 with alpha that is not premultiplied and is kept exactly; quality 1 to
 * 100. Appended to out. ERR_ARG (size, channels), ERR_MEM, ERR_INTERNAL. */
enum err_code webp_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                          uint32_t channels, int quality, struct buf *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
