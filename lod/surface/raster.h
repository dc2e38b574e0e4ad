/* Tiles of a web map drawn from a store, as seen from straight above, in the pixels of
 * WebMercatorQuad (z/x/y).
 *
 * Neighbouring tiles have no seam. The Gaussians that are drawn depend only on the size of a pixel,
 * and each is drawn in every tile that it reaches.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_RASTER_H
#define LOD_RASTER_H

#include "lod/surface/nadir.h"

enum {
    RASTER_PX = 256,       /* edge of a tile */
    RASTER_SIDE_MAX = 640, /* largest edge of a drawing, with its margin */
    RASTER_ZOOM_OVER = 2,  /* zooms beyond raster_zoom_max that are drawn too */
    RASTER_GROUND_PX = 30  /* largest radius of raster_ground: its margin fits about 512 px */
};
#define RASTER_OFF_PX 0.1 /* largest error of a pixel's place in the map */

/* The zoom from which a pixel is at most half of the usual median sigma. Higher zooms show nothing
 * new. */
uint8_t raster_zoom_max(const struct area *a);
/* The zoom from which the survey is at least 32 px wide or high. */
uint8_t raster_zoom_min(const struct area *a);

struct raster_tile {
    struct key key;
    uint32_t size_px;   /* of the tile */
    uint32_t margin_px; /* margin drawn on every side */
};
/* Edge of the drawing: size_px + 2 margin_px, at most RASTER_SIDE_MAX. */
static inline uint32_t raster_side(const struct raster_tile *t)
{
    return t->size_px + 2 * t->margin_px;
}
/* Draws a tile. rgb [side][side][3] is 0 to 1, height_m [side][side] is ellipsoidal. Both are NAN
 * where there is no surface or nothing was surveyed. Either may be NULL. in [side][side]: 1 where
 * the ground was surveyed. ERR_ARG (size), ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM
 * as in nadir_draw. */
enum err_code raster_draw(struct nadir *n, const struct raster_tile *t, float *rgb, float *height_m,
                          uint8_t *in, struct err *e) ERR_USE;

/* Fills holes of heights [side][side]. A pixel without height gets the mean, weighted by distance,
 * of the nearest heights in eight directions, up to reach_px away. If there is none it gets base_m.
 * The result depends only on the neighbourhood, so tiles with a margin of reach_px agree along
 * their borders. The result is filled [side][side]. */
void raster_fill(const float *height_m, uint32_t side, uint32_t reach_px, float base_m,
                 float *filled);
/* Turns heights of the surface [side][side] (NAN: none) into heights of bare ground: an opening by
 * a square of 2 radius_px + 1, which takes away what is narrower, as buildings and trees, then a
 * mean over some pixels. Holes and the ground about the survey get the ground beside them; from
 * radius_px to twice that away it falls to base_m, so that the survey has no cliff. The result
 * depends only on what is within raster_ground_margin, so tiles with that margin agree along their
 * borders. The result is ground [side][side]. ERR_MEM. */
enum err_code raster_ground(const float *height_m, uint32_t side, uint32_t radius_px, float base_m,
                            float *ground, struct err *e) ERR_USE;
static inline uint32_t raster_ground_margin(uint32_t radius_px)
{
    return 2 * radius_px + 2;
}
/* Pixels of that radius for a tile of a zoom: half of the widest building. */
uint32_t raster_ground_radius(struct key k, uint32_t size_px);
/* The finest zoom whose tiles of RASTER_PX have a radius of at most RASTER_GROUND_PX. */
uint8_t raster_ground_zoom(const struct area *a);
/* The height for ground that was not surveyed: the survey's floor. Ellipsoidal. */
float raster_base_m(const struct area *a);

#endif
