/* The map of a dataset as OGC API - Tiles: its list of tilesets, its tileset, and the tile matrix
 * set of all maps of this server.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_OGC_TILES_H
#define SERVER_OGC_TILES_H

#include "server/data/dataset.h"

/* The beginning of links: --public-url if there is one, else --base-path, so that links stay on the
 * requested host. GDAL does not resolve relative ones. Borrowed; either may be NULL. */
static inline const char *ogc_tiles_base(const char *public_url, const char *base_path)
{
    return public_url && *public_url ? public_url : base_path;
}
/* base: ogc_tiles_base, with or without '/' at its end; NULL is "". ERR_MEM. */
enum err_code ogc_tiles_list(const struct dataset *d, const char *base, struct body **out,
                             struct err *e) ERR_USE;
/* edition: of the tiles (result_id.h); "": not known yet. ERR_MEM. */
enum err_code ogc_tiles_tileset(const struct dataset *d, const char *edition, const char *base,
                                struct body **out, struct err *e) ERR_USE;
/* WebMercatorQuad, zooms 0 to 24, as both editions of the standard write it. ERR_MEM. */
enum err_code ogc_tiles_matrices(struct body **out, struct err *e) ERR_USE;
#endif
