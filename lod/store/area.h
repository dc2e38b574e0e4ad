/* The surveyed ground of a store.
 *
 * A store that was tiled with its footprint (docs/scale.md) contains it: the ground that the
 * photographs support. In any other store it is the ground of the finest tiles, except tiles whose
 * Gaussians are much coarser than usual. Training leaves a few large Gaussians far outside a city,
 * for the background of photographs; their tiles were not surveyed.
 *
 * An area does not change once it is made, so threads may share it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_AREA_H
#define LOD_AREA_H

#include "codec/container/geojson.h"
#include "lod/store/store.h"

enum { AREA_LAYERS_MAX = 8 };
/* a tile is background if its median sigma is this many times the usual one */
#define AREA_COARSE 4.0

struct area {                  /* {0} is empty; free with area_free */
    const struct store *store; /* borrowed */
    bool *in;                  /* by index into store_tiles: was the tile surveyed? */
    size_t n_in;
    /* Outlines, in the Mercator square (key_place). Ground inside all outlines was surveyed. The
     * first is the store's footprint; if there is none (by_tiles), `in` decides instead. The others
     * are the polygons that the store was clipped to. */
    struct geojson_edge *edges; /* NULL: none */
    /* layer: first edge of each outline, then the end */
    size_t n_edges, n_layers, layer[AREA_LAYERS_MAX + 1];
    bool by_tiles;
    double west_deg, south_deg, east_deg, north_deg; /* box around the survey */
    /* ENU: nearly all Gaussians of the survey lie between these heights */
    double floor_m, ceiling_m;
    double gsd_m;   /* pixel of the nearest photographs, median over the ground; 0: not known */
    double sigma_m; /* usual median sigma: half of all Gaussians are in finer tiles */
};
/* Computes the area. Free *out with area_free. ERR_DATA: the store has no tiles. ERR_MEM. */
enum err_code area_make(const struct store *s, struct area *out, struct err *e) ERR_USE;
void area_free(struct area *a);
bool area_holds(const struct area *a, double lon_deg, double lat_deg);
/* Returns whether a tile of any zoom touches the box around the survey. */
bool area_touches(const struct area *a, struct key k);
/* As area_touches, for the tile widened on every side by `margin` times its edge. */
bool area_is_near(const struct area *a, struct key k, double margin);
/* Sets in [h][w] to 1 where the centre of a pixel was surveyed, else to 0. `corner` has u, v of the
 * picture's corners in the Mercator square: top left, top right, bottom left, bottom right. Pixels
 * are evenly spaced between the corners. Returns the number of ones. */
size_t area_mask(const struct area *a, const double corner[8], uint32_t w, uint32_t h, uint8_t *in);

#endif
