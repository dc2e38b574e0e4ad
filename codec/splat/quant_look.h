/* Integers that look as another Gaussian's do and take fewer bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_QUANT_LOOK_H
#define CODEC_QUANT_LOOK_H

#include <stdint.h>

struct gauss;

/* Names the axes of an ellipsoid anew, so that it is turned as little as possible: an ellipsoid has
 * 24 rotations, with its three sizes in other orders. Afterwards w is the largest component of the
 * quaternion. quat has any length but 0 and keeps it. */
void quant_look_turn(float quat_wxyz[4], uint8_t scale[3]);
/* Writes color [n][3] and sh [n][K-1][3] of sh_degree as the integers of quant.h, in glTF axes (y
 * up), with so many low bits left out of DC and of each band. What one coefficient is rounded by,
 * and what bands of g that are not written would have shown, goes into the coefficients before it,
 * as far as it shows from above: the squared error of the colour, over the directions that look
 * down, weighted by the cosine to nadir, is kept small. Small harmonics become 0. */
void quant_look_colors(const struct gauss *g, uint32_t sh_degree, unsigned color_bits,
                       const uint8_t sh_bits[3], uint8_t *color, uint8_t *sh);

#endif
