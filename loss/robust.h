/* Robust weighting of pixels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_ROBUST_H
#define LOSS_ROBUST_H

#include <stdint.h>

/* Robust weighting: ignore (0) the pixels whose residual is more than 3 * 1.4826 MAD above the
 * median residual, where most of their 5 x 5 neighbours are such pixels too, so that thin detail is
 * not taken for a moving thing (RobustNeRF, Sabour 2023, trims the same way). color: planar
 * [3][h][w]; px: [h][w][3]; out: [h][w], pixels that are 0 in it stay 0; scratch: [h][w]. */
void robust_mask(const float *color, const uint8_t *px, uint32_t width_px, uint32_t height_px,
                 float *scratch, uint8_t *out);
#endif
