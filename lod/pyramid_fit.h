/* Rows into a tile, for pyramid_build.c and for those who change stores: internal to lod/.
 *
 * Pure: no state, any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PYRAMID_FIT_H
#define LOD_PYRAMID_FIT_H

#include "core/gauss.h"
#include "lod/key.h"

struct locate;

enum {
    PYRAMID_PER_TILE = 50000, /* wanted on average: a megabyte as .drc, a second of a slow line */
    PYRAMID_PER_TILE_MAX = 200000,
    PYRAMID_KEEP = 16, /* tiles this small are not thinned: four of them are 64 */
};
/* Tiles of trained levels are no wider than twice this, so that fixed-point formats (SPZ, .drc)
 * hold their means within 2048 m of the centre to 2^-12 m, and rows farther up or down are left
 * out. */
#define PYRAMID_REACH_M 2000.0
#define PYRAMID_ALLOWANCE 1.02 /* of the reach */
/* Overviews may be wider: their formats take fewer bits behind the point, as many as the sigmas
 * need. So that there are enough, no sigma is below this part of the reach. */
#define PYRAMID_SIGMA_LEAST 0x1p-18

/* Rows [from, from + n) of g, borrowed. */
struct gauss pyramid_view(const struct gauss *g, size_t from, size_t n);
/* How far from the centre of a tile at this zoom rows may be, along each axis. */
double pyramid_reach_m(double lat_deg, uint8_t z);
/* Centre of rows along one axis, at [n] ENU metres (left in another order): whole metres, the
 * middle, but the median where a stray Gaussian would push all others out of reach. */
double pyramid_center_axis(bool lossless, double reach_m, double *at, size_t n);
/* Leave out rows beyond reach, with PYRAMID_ALLOWANCE; returns how many. Widen sigmas of overviews
 * to PYRAMID_SIGMA_LEAST. */
size_t pyramid_fit(struct gauss *g, double reach_m);
/* How many of n rows a tile passes on to the one above. */
size_t pyramid_thin_count(size_t n);
/* So many of a tile's rows by merging, all of them inside the tile, by more than what the next tile
 * above may round. out: gauss_free it. ERR_MEM, ERR_ARG, ERR_LIMIT as simplify_gauss. */
enum err_code pyramid_thin(const struct locate *l, const struct gauss *g, struct key k,
                           struct gauss *out, struct err *e) ERR_USE;

#endif
