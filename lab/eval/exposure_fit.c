/* See exposure_fit.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/exposure_fit.h"

#include <math.h>
#include <stddef.h>

#include "core/splat/exposure.h"

/* Medians are taken from a histogram of log2 ratios: nothing to allocate, nothing to sort. */
enum { EXPOSURE_BINS = 4096, EXPOSURE_PIXELS_MIN = 64 };

/* log2 ratio at half of the counts, 0 where there are too few. */
static float exposure_median(const uint32_t *bins, uint32_t total)
{
    uint32_t below = 0, i = 0;
    while (i + 1 < EXPOSURE_BINS && below + bins[i] < (total + 1) / 2)
        below += bins[i++];
    return EXPOSURE_EV_MAX * (2.0f * ((float)i + 0.5f) / EXPOSURE_BINS - 1.0f);
}

bool exposure_fit(const float *rgb, const uint8_t *px, const uint8_t *mask, uint32_t width_px,
                  uint32_t height_px, uint32_t first, uint32_t count, float ev[3])
{
    float least = EXPOSURE_BYTE_MIN / 255.0f, most = EXPOSURE_BYTE_MAX / 255.0f;
    ev[0] = ev[1] = ev[2] = 0.0f;
    for (size_t k = 0; k < 3; k++) {
        uint32_t bins[EXPOSURE_BINS] = {0}, total = 0;
        for (size_t y = 0; y < height_px; y++)
            for (size_t x = first; x < first + count; x++) {
                size_t at = y * width_px + x;
                uint8_t byte = px[3 * at + k];
                float drawn = rgb[3 * at + k];
                if ((mask && !mask[at]) || byte < EXPOSURE_BYTE_MIN || byte > EXPOSURE_BYTE_MAX ||
                    !(drawn >= least && drawn <= most))
                    continue;
                float ratio =
                    log2f(exposure_to_linear((float)byte / 255.0f) / exposure_to_linear(drawn));
                float bin = (ratio / EXPOSURE_EV_MAX + 1.0f) * (EXPOSURE_BINS / 2);
                bins[(size_t)fminf(fmaxf(bin, 0.0f), EXPOSURE_BINS - 1)]++;
                total++;
            }
        if (total < EXPOSURE_PIXELS_MIN) {
            ev[0] = ev[1] = ev[2] = 0.0f;
            return false;
        }
        ev[k] = exposure_median(bins, total);
    }
    return true;
}
