/* Exposure and white balance; see exposure.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/exposure.h"

#include <math.h>

#define EXPOSURE_SLOPE_EV 0.1f /* clipped light of less than this is known well enough */

float exposure_to_linear(float srgb)
{
    return srgb <= 0.04045f ? srgb / 12.92f : powf((srgb + 0.055f) / 1.055f, 2.4f);
}

static float exposure_to_srgb(float linear)
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
