/* Documents about a store: the tileset of 3D Tiles 1.1, and TileJSON. tileset.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TILESET_H
#define LOD_TILESET_H

#include "core/err.h"
#include "lod/key.h"

struct buf;
struct crop_node;
struct store;

struct tileset_links { /* templates with {z}/{x}/{y}, relative to the document; no printf format */
    const char *tile;  /* "t/{z}/{x}/{y}.glb" */
    const char *part;  /* "tileset/{z}/{x}/{y}.json": the document that begins at a tile */
};
/* Those of a folder with tileset.json, t/ and tileset/: of its entry, and of the parts in it. */
extern const struct tileset_links tileset_of_entry, tileset_of_part;
/* The explicit tileset JSON into `out` (caller frees): the entry (part NULL), or the document that
 * begins at the tile `part`. left: of what a polygon leaves of the tiles (lod/crop.h); NULL: all.
 * Below about a thousand tiles the entry is all of it. The store is only
 * read, so threads may share it. ERR_DATA (no tiles), ERR_NOENT (no document begins there),
 * ERR_MEM; ERR_ARG of an origin that is no place. */
enum err_code tileset_write(const struct store *s, const struct tileset_links *links,
                            const struct key *part, const struct crop_node *left, struct buf *out,
                            struct err *e) ERR_USE;
/* Does a document begin at this tile? */
bool tileset_has_part(const struct store *s, struct key k);
/* TileJSON 3.0.0 with the "splats" member. tiles_template as above, may be relative. ERR_DATA,
 * ERR_MEM, ERR_ARG. */
enum err_code tileset_tilejson(const struct store *s, const char *tiles_template, struct buf *out,
                               struct err *e) ERR_USE;

#endif
