/* Documents about a store: the tileset of 3D Tiles 1.1, and TileJSON. tileset.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TILESET_H
#define LOD_TILESET_H

#include "core/err.h"

struct buf;
struct store;

/* The explicit tileset JSON, one document, into `out` (caller frees). content_template: addresses
 * of the tiles with {z}/{x}/{y}, "t/{z}/{x}/{y}.glb"; no printf format. The store is only read, so
 * threads may share it. ERR_DATA (no tiles), ERR_MEM; ERR_ARG of an origin that is no place. */
enum err_code tileset_write(const struct store *s, const char *content_template, struct buf *out,
                            struct err *e) ERR_USE;
/* TileJSON 3.0.0 with the "splats" member. tiles_template as above, may be relative. ERR_DATA,
 * ERR_MEM, ERR_ARG. */
enum err_code tileset_tilejson(const struct store *s, const char *tiles_template, struct buf *out,
                               struct err *e) ERR_USE;

#endif
