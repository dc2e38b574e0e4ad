/* Exposure and white balance of photographs: three numbers each.
 *
 * `ev` counts stops, for red, green and blue separately. The linear light of a photograph is 2^ev
 * times that of the same scene at the survey's mean exposure. A positive ev means a brighter
 * photograph. Linear light is computed with the sRGB curve (IEC 61966-2-1), because the camera's
 * own tone curve is not known. Exposure is a property of the camera, as its pose is. Other changes
 * of light are appearance (core/splat/appearance.h). All functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_EXPOSURE_H
#define CORE_EXPOSURE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define EXPOSURE_EV_MAX 6.0f /* stops; a larger value is an error of the measurement */
/* A byte outside this range says nothing about the light: it is clipped or lost in noise. */
enum { EXPOSURE_BYTE_MIN = 4, EXPOSURE_BYTE_MAX = 250 };

/* Converts an sRGB value 0..1 to linear light. */
float exposure_to_linear(float srgb);
/* Returns whether all three are 0. */
bool exposure_is_mean(const float ev[3]);
/* out[channel][byte]: the value that a byte of the photograph would have at the mean exposure. A
 * clipped byte of a photograph brighter than the mean has no true value: see exposure_clipped. */
void exposure_table(const float ev[3], uint8_t out[3][256]);
/* Returns whether a pixel [3] is clipped and would be darker at the mean exposure. Its true value
 * is then not known. */
bool exposure_clipped(const float ev[3], const uint8_t px[3]);
/* Changes a photograph px [n][3] to the mean exposure, in place. mask [n] (may be NULL) becomes 0 =
 * ignore at clipped pixels. */
void exposure_to_mean(const float ev[3], uint8_t *px, size_t n, uint8_t *mask);
/* Changes a drawing at the mean exposure, rgb [n][3] in 0..1, to the exposure of the photograph, in
 * place. */
void exposure_expose(const float ev[3], float *rgb, size_t n);

#endif
