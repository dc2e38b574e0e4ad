/* Tiles of a web map drawn from a store: what is seen from straight above, in the pixels of
 * WebMercatorQuad, the z/x/y of every slippy map.
 *
 * Neighbours fit without a seam: which Gaussians are taken depends on the size of a pixel alone,
 * and each is drawn into every tile that it reaches.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_RASTER_H
#define LOD_RASTER_H

#include "lod/nadir.h"

enum {
    RASTER_PX = 256,       /* edge of a tile */
    RASTER_SIDE_MAX = 640, /* of what is drawn at once, with its margin */
    RASTER_ZOOM_OVER = 2   /* zooms beyond raster_zoom_max that are still drawn */
};
#define RASTER_OFF_PX 0.1 /* how far pixels may be from where the map has them */

/* The zoom from which on a pixel is at most half of the usual median sigma: more would show nothing
 * new. */
uint8_t raster_zoom_max(const struct area *a);
/* The zoom from which on the survey is at least 32 px wide or high. */
uint8_t raster_zoom_min(const struct area *a);

struct raster_tile {
    struct key key;
    uint32_t size_px;   /* of the tile */
    uint32_t margin_px; /* drawn around it on every side */
};
/* Edge of what is drawn: size_px + 2 margin_px, up to RASTER_SIDE_MAX. */
static inline uint32_t raster_side(const struct raster_tile *t)
{
    return t->size_px + 2 * t->margin_px;
}
/* rgb [side][side][3], 0 to 1; height_m [side][side], ellipsoidal; NAN where there is no surface or
 * nothing was surveyed. Either may be NULL. in [side][side]: what was surveyed. Errors of
 * nadir_draw: ERR_ARG (size), ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code raster_draw(struct nadir *n, const struct raster_tile *t, float *rgb, float *height_m,
                          uint8_t *in, struct err *e) ERR_USE;

/* Fill the holes of heights [side][side]: each pixel without one gets the mean, weighted by the
 * distance, of the nearest ones along eight directions, up to reach_px away; where there is none,
 * base_m. So what a pixel becomes depends on its neighbourhood alone, and tiles drawn with a margin
 * of reach_px agree along their borders. filled [side][side] is the result. */
void raster_fill(const float *height_m, uint32_t side, uint32_t reach_px, float base_m,
                 float *filled);
/* The height that stands for ground that was not surveyed: the survey's floor. Ellipsoidal. */
float raster_base_m(const struct area *a);

#endif
