/* The exposure of a photograph against a drawing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_EXPOSURE_FIT_H
#define LAB_EXPOSURE_FIT_H

#include <stdbool.h>
#include <stdint.h>

/* Measures the exposure of the columns [first, first + count) of a photograph px [h][w][3] against
 * a drawing of the same view at the mean exposure, rgb [h][w][3]. For each channel it takes the
 * median ratio of linear light over pixels that are well exposed in both. mask [h][w] (may be
 * NULL): 0 = ignore. Returns false and ev = 0 when fewer than 64 pixels count. */
bool exposure_fit(const float *rgb, const uint8_t *px, const uint8_t *mask, uint32_t width_px,
                  uint32_t height_px, uint32_t first, uint32_t count, float ev[3]);

#endif
