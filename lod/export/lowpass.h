/* The low-pass form of a tile, for clients without a low-pass filter of their own (lowpass.c).
 *
 * A renderer needs such a filter where Gaussians are smaller than a pixel. Ours widens each
 * Gaussian in the picture and makes it fainter. CesiumJS does not; it also drops the smallest. So
 * the tiles that a tileset names have the filter built in, for the smallest pixels at which a
 * client shows them (docs/decisions/021-low-pass.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_LOWPASS_H
#define LOD_LOWPASS_H

#include <stdint.h>

struct gauss;
struct tree;

/* Returns the metres of the pixels for which the low-pass form of a tile is made: those at which a
 * client that refines at 16 px leaves it for its children, or, at a leaf, for the tile as it is. */
double lowpass_pixel_m(const struct tree *t, uint32_t node);
/* Widens all Gaussians for such pixels and makes them fainter. Does nothing for 0 m, or if they
 * were trained without anti-aliasing, because those are drawn as they are. */
void lowpass_gauss(struct gauss *g, double pixel_m);

#endif
