/* Robust weighting of pixels: moving things do not fit and are ignored.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "loss/robust.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

enum { ROBUST_PATCH = 2 };
#define ROBUST_OUTLIER (3.0f * 1.4826f) /* robust standard deviations from the MAD */

enum { ROBUST_BINS = 4096 };

/* The value below which half of the counts lie, by a histogram over 0..1: 1/4096 is far below what
 * matters, and the cost does not depend on the data. */
static float robust_median(const uint32_t bin[ROBUST_BINS], size_t n)
{
    size_t below = 0;
    uint32_t k = 0;
    while (k + 1 < ROBUST_BINS && (below += bin[k]) * 2 < n)
        k++;
    return ((float)k + 0.5f) / ROBUST_BINS;
}

static uint32_t robust_bin(float v)
{
    return v >= 1.0f ? ROBUST_BINS - 1 : v > 0.0f ? (uint32_t)(v * ROBUST_BINS) : 0;
}

void robust_mask(const float *color, const uint8_t *px, uint32_t width_px, uint32_t height_px,
                 float *scratch, uint8_t *out)
{
    uint32_t bin[ROBUST_BINS] = {0};
    size_t n = (size_t)width_px * height_px, used = 0;
    for (size_t i = 0; i < n; i++) {
        scratch[i] = 0.0f;
        for (size_t c = 0; c < 3; c++)
            scratch[i] += fabsf(color[c * n + i] - (float)px[3 * i + c] / 255.0f) / 3.0f;
        bin[robust_bin(scratch[i])] += out[i] != 0;
        used += out[i] != 0;
    }
    float median = robust_median(bin, used);
    memset(bin, 0, sizeof bin);
    for (size_t i = 0; i < n; i++)
        bin[robust_bin(fabsf(scratch[i] - median))] += out[i] != 0;
    float limit = median + ROBUST_OUTLIER * robust_median(bin, used);
    for (int64_t y = 0; y < height_px; y++)
        for (int64_t x = 0; x < width_px; x++) {
            int over = 0, all = 0;
            for (int64_t v = y - ROBUST_PATCH; v <= y + ROBUST_PATCH; v++)
                for (int64_t u = x - ROBUST_PATCH; u <= x + ROBUST_PATCH; u++)
                    if (u >= 0 && v >= 0 && u < width_px && v < height_px) {
                        all++;
                        over += scratch[v * width_px + u] > limit;
                    }
            if (2 * over > all)
                out[y * width_px + x] = 0;
        }
}
