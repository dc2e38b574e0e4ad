/* Exposure and white balance; see exposure.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/exposure.h"

#include <math.h>

/* Medians are taken from a histogram of log2 ratios: nothing to allocate, nothing to sort. */
enum { EXPOSURE_BINS = 4096, EXPOSURE_PIXELS_MIN = 64 };
#define EXPOSURE_SLOPE_EV 0.1f /* clipped light of less than this is known well enough */

float exposure_to_linear(float srgb)
{
    return srgb <= 0.04045f ? srgb / 12.92f : powf((srgb + 0.055f) / 1.055f, 2.4f);
}

float exposure_to_srgb(float linear)
{
    return linear <= 0.0031308f ? linear * 12.92f : 1.055f * powf(linear, 1.0f / 2.4f) - 0.055f;
}

bool exposure_is_mean(const float ev[3])
{
    return ev[0] == 0.0f && ev[1] == 0.0f && ev[2] == 0.0f;
}

void exposure_table(const float ev[3], uint8_t out[3][256])
{
    for (size_t k = 0; k < 3; k++)
        for (size_t i = 0; i < 256; i++) {
            float light = exposure_to_linear((float)i / 255.0f) * exp2f(-ev[k]);
            out[k][i] = (uint8_t)(255.0f * fminf(exposure_to_srgb(light), 1.0f) + 0.5f);
        }
}

bool exposure_clipped(const float ev[3], const uint8_t px[3])
{
    for (size_t k = 0; k < 3; k++)
        if (px[k] >= EXPOSURE_BYTE_MAX && ev[k] > EXPOSURE_SLOPE_EV)
            return true;
    return false;
}

void exposure_to_mean(const float ev[3], uint8_t *px, size_t n, uint8_t *mask)
{
    uint8_t table[3][256];
    exposure_table(ev, table);
    for (size_t i = 0; i < n; i++) {
        if (mask && exposure_clipped(ev, px + 3 * i))
            mask[i] = 0;
        for (size_t k = 0; k < 3; k++)
            px[3 * i + k] = table[k][px[3 * i + k]];
    }
}

void exposure_expose(const float ev[3], float *rgb, size_t n)
{
    float gain[3];
    if (exposure_is_mean(ev))
        return;
    for (size_t k = 0; k < 3; k++)
        gain[k] = exp2f(ev[k]);
    for (size_t i = 0; i < 3 * n; i++) {
        float light = gain[i % 3] * exposure_to_linear(fminf(fmaxf(rgb[i], 0.0f), 1.0f));
        rgb[i] = fminf(exposure_to_srgb(light), 1.0f);
    }
}

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
