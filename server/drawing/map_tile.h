/* Tiles of a web map as bytes: colours, or heights coded as colours.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MAP_TILE_H
#define SERVER_MAP_TILE_H

#include "lod/surface/raster.h"
#include "server/route/target.h"

enum { MAP_TILE_REACH_PX = 16 /* distance over which holes of terrain are filled */ };

struct map_tile {
    struct key key;
    uint32_t size_px;
    enum format format;     /* jpg, png, webp */
    enum encoding encoding; /* of heights; ENCODING_UNSAID: colours */
    bool ground;            /* heights of bare ground, not of the surface */
    int quality;            /* for jpg and webp */
};
/* Returns whether a terrain tile is level everywhere, so that all such tiles have the same bytes:
 * the survey touches neither it nor the margin used for filling. */
bool map_tile_is_flat(const struct area *a, const struct map_tile *t);
/* Appends the encoded picture. Ground that was not surveyed is transparent, in JPEG white; heights
 * are those of raster_fill, or of raster_ground, with raster_base_m. ERR_ARG, ERR_CANCEL,
 * ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM, ERR_INTERNAL as in raster_draw and image_encode. */
enum err_code map_tile_make(struct nadir *n, const struct map_tile *t, struct buf *out,
                            struct err *e) ERR_USE;

#endif
