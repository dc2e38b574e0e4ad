/* Tiles of a web map as bytes: colour, or heights written as colours.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MAP_TILE_H
#define SERVER_MAP_TILE_H

#include "lod/raster.h"
#include "server/target.h"

enum { MAP_TILE_REACH_PX = 16 /* how far holes of terrain are filled from their rims */ };

struct map_tile {
    struct key key;
    uint32_t size_px;
    enum format format;     /* jpg, png, webp */
    enum encoding encoding; /* of heights; ENCODING_UNSAID: colours */
    int quality;            /* of jpg and webp */
};
/* Terrain that is level everywhere, the same bytes for every such tile: neither it nor the margin
 * that its holes are filled from touches the survey. */
bool map_tile_is_flat(const struct area *a, const struct map_tile *t);
/* Append the encoded picture. Where nothing was surveyed colours are transparent, in JPEG white,
 * and heights are those of raster_fill with raster_base_m. Errors of raster_draw and image_encode:
 * ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM, ERR_INTERNAL. */
enum err_code map_tile_make(struct nadir *n, const struct map_tile *t, struct buf *out,
                            struct err *e) ERR_USE;

#endif
