/* Fits rows into a tile, for pyramid_build.c and for changes of stores. Internal to lod/.
 *
 * Functions are pure; any thread may call them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PYRAMID_FIT_H
#define LOD_PYRAMID_FIT_H

#include "core/splat/gauss.h"
#include "lod/store/key.h"

struct locate;

enum {
    PYRAMID_PER_TILE = 50000, /* wanted on average: a megabyte as .drc, a second on a slow line */
    PYRAMID_PER_TILE_MAX = 200000,
    PYRAMID_KEEP = 16, /* tiles this small are not thinned: four of them have 64 rows */
};
/* Distance from a tile's centre along an axis. A tile of a trained level is at most twice this
 * wide, and rows farther above or below are left out. The fixed-point formats (SPZ, .drc) then hold
 * all means to 2^-12 m, as they reach 2048 m. */
#define PYRAMID_REACH_M 2000.0
#define PYRAMID_ALLOWANCE 1.02 /* factor of the reach */
/* Overviews may be wider. Their means then have fewer fraction bits, but enough for their sigmas,
 * because no sigma is below this share of the reach. */
#define PYRAMID_SIGMA_LEAST 0x1p-18

/* Rows [from, from + n) of g, borrowed. */
struct gauss pyramid_view(const struct gauss *g, size_t from, size_t n);
/* Largest distance of rows from the centre of a tile at this zoom, along each axis. */
double pyramid_reach_m(double lat_deg, uint8_t z);
/* Centre of rows along one axis, in whole metres. `at` [n] are ENU metres; their order changes. It
 * is the middle. If a stray Gaussian would put all others out of reach, it is the median. */
double pyramid_center_axis(bool lossless, double reach_m, double *at, size_t n);
/* Removes rows beyond reach_m * PYRAMID_ALLOWANCE and returns their number. Widens sigmas of
 * overviews to PYRAMID_SIGMA_LEAST. */
size_t pyramid_fit(struct gauss *g, double reach_m);
/* Number of rows that a tile with n rows gives to the tile above. */
size_t pyramid_thin_count(size_t n);
/* Merges a tile's rows into that many. All results lie inside the tile, with a margin for the
 * rounding of the tile above. Free *out with gauss_free. ERR_MEM, ERR_ARG, ERR_LIMIT as in
 * simplify_gauss. */
enum err_code pyramid_thin(const struct locate *l, const struct gauss *g, struct key k,
                           struct gauss *out, struct err *e) ERR_USE;

#endif
