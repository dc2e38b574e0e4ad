/* Exposure and white balance of photographs: three numbers each.
 *
 * A photograph's linear light is 2^ev times that of the same scene at the survey's mean exposure,
 * for red, green and blue on their own: `ev` counts stops, positive = this photograph is brighter.
 * Linear light is that of the sRGB curve (IEC 61966-2-1); the camera's own tone curve is not known.
 * Exposure belongs to the camera, as its pose does, and not to the city: appearance
 * (core/appearance.h) is what is left. Any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_EXPOSURE_H
#define CORE_EXPOSURE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define EXPOSURE_EV_MAX 6.0f /* stops; more is an error of whoever measured */
/* Bytes whose light is not known: clipped, or lost in the noise. */
enum { EXPOSURE_BYTE_MIN = 4, EXPOSURE_BYTE_MAX = 250 };

/* sRGB value 0..1 to linear light and back. */
float exposure_to_linear(float srgb);
float exposure_to_srgb(float linear);
/* All three are 0. */
bool exposure_is_mean(const float ev[3]);
/* out[channel][byte]: what a photograph's byte would have been at the mean exposure. Clipped bytes
 * of a photograph that is brighter than the mean stand for unknown light: see exposure_clipped. */
void exposure_table(const float ev[3], uint8_t out[3][256]);
/* Is a pixel [3] clipped, so that at the mean exposure it would be darker than it can say? */
bool exposure_clipped(const float ev[3], const uint8_t px[3]);
/* A photograph px [n][3] to the mean exposure, in place. mask [n], may be NULL: pixels that are
 * clipped become 0 = ignore. */
void exposure_to_mean(const float ev[3], uint8_t *px, size_t n, uint8_t *mask);
/* A drawing at the mean exposure, rgb [n][3] in 0..1, as the photograph would have taken it; in
 * place. */
void exposure_expose(const float ev[3], float *rgb, size_t n);
/* The exposure of columns [first, first + count) of a photograph, px [h][w][3], against a drawing
 * of the same view at the mean exposure, rgb [h][w][3]: for each channel the median of the ratio of
 * light over the pixels that are exposed well in both. mask [h][w], 0 = ignore, may be NULL.
 * Returns false, and ev of 0, where fewer than 64 pixels count. */
bool exposure_fit(const float *rgb, const uint8_t *px, const uint8_t *mask, uint32_t width_px,
                  uint32_t height_px, uint32_t first, uint32_t count, float ev[3]);

#endif
