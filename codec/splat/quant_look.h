/* Integers that look as another Gaussian's do and take fewer bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_QUANT_LOOK_H
#define CODEC_QUANT_LOOK_H

#include <stdint.h>

struct gauss;
struct quant;
struct quant_grid;

/* Names the axes of an ellipsoid anew, so that it is turned as little as possible: an ellipsoid has
 * 24 rotations, with its three sizes in other orders. Afterwards w is the largest component of the
 * quaternion. quat has any length but 0 and keeps it. */
void quant_look_turn(float quat_wxyz[4], uint8_t scale[3]);
/* Writes q->color and q->sh, in glTF axes (y up), on the steps of the grid. What one coefficient is
 * rounded by, and what bands that q lacks would have shown, goes into the coefficients before it,
 * as far as it shows from above: the squared error of the colour, over the directions that look
 * down, weighted by the cosine to nadir, is kept small. Small harmonics become 0. */
void quant_look_colors(const struct gauss *g, const struct quant_grid *grid, struct quant *q);

#endif
