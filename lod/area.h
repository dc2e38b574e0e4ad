/* Which ground of a store was surveyed.
 *
 * A store that was tiled with its footprint (docs/footprint.md) says so itself: the ground that the
 * photographs support. Of any other, it is the finest tiles whose Gaussians are about as fine as
 * those of most. Training also leaves a few large Gaussians far around a city, for what photographs
 * see behind it: tiles of these are no survey.
 *
 * Immutable once made: threads may share it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_AREA_H
#define LOD_AREA_H

#include "lod/store.h"

enum { AREA_LAYERS_MAX = 8 };
#define AREA_COARSE 4.0 /* a tile with this many times the usual median sigma is background */

struct area_edge { /* of an outline, in the Mercator square (key_place) */
    double from[2], to[2];
};
struct area {                  /* {0} is empty */
    const struct store *store; /* borrowed */
    bool *in;                  /* by index into store_tiles */
    size_t n_in;
    /* Outlines, each by the even-odd rule: what lies in all of them was surveyed. The first is the
     * store's footprint; without one (by_tiles), tiles decide. The others are what it was clipped
     * to. */
    struct area_edge *edges;                              /* NULL: none */
    size_t n_edges, n_layers, layer[AREA_LAYERS_MAX + 1]; /* first edge of each, and the end */
    bool by_tiles;
    double west_deg, south_deg, east_deg, north_deg; /* around what was surveyed */
    double floor_m, ceiling_m; /* ENU: nearly all of the surveyed lies between */
    double sigma_m;            /* usual median sigma: half of the Gaussians are in finer tiles */
};
/* area_free it. ERR_DATA when the store has no tiles, ERR_MEM. */
enum err_code area_make(const struct store *s, struct area *out, struct err *e) ERR_USE;
void area_free(struct area *a);
bool area_holds(const struct area *a, double lon_deg, double lat_deg);
/* Does a tile of any zoom touch the box around the survey? */
bool area_touches(const struct area *a, struct key k);
/* The same of the tile widened on every side by `margin`, in edges of the tile. */
bool area_is_near(const struct area *a, struct key k, double margin);
/* in [h][w]: 1 where the centre of a pixel was surveyed, else 0. corner: of the picture in the
 * Mercator square: u, v of top left, top right, bottom left, bottom right; pixels lie evenly
 * between.
 * Returns how many are 1. */
size_t area_mask(const struct area *a, const double corner[8], uint32_t w, uint32_t h, uint8_t *in);

#endif
