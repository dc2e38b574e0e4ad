/* Documents about a store: tileset.json of 3D Tiles 1.1, and TileJSON. tileset.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TILESET_H
#define LOD_TILESET_H

#include "core/err.h"
#include "lod/store/key.h"

struct buf;
struct crop_node;
struct store;

/* templates with {z}/{x}/{y}, relative to the document; no printf formats */
struct tileset_links {
    const char *tile; /* "t/{z}/{x}/{y}.glb" */
    /* "t/{z}/{x}/{y}.lowpass.glb", for stores with anti-aliasing; NULL: only tiles as they are */
    const char *lowpass;
    const char *part; /* "tileset/{z}/{x}/{y}.json": the document that begins at this tile */
};
/* Links in a folder with tileset.json, t/ and tileset/: for the entry document, and for parts. */
extern const struct tileset_links tileset_of_entry, tileset_of_part;
/* Writes a tileset document; the caller frees `out`. It is the entry (part NULL) or the document
 * that begins at the tile `part`. `left` says what a polygon leaves of the tiles
 * (lod/export/crop.h); NULL: all. A store of less than about a thousand tiles has only the entry.
 * The store is only read, so threads may share it. ERR_DATA (no tiles), ERR_NOENT (no document
 * begins there), ERR_MEM, ERR_ARG (origin). */
enum err_code tileset_write(const struct store *s, const struct tileset_links *links,
                            const struct key *part, const struct crop_node *left, struct buf *out,
                            struct err *e) ERR_USE;
/* Returns whether a document begins at this tile. */
bool tileset_has_part(const struct store *s, struct key k);
/* Writes TileJSON 3.0.0 with the member "splats". tiles_template may be relative. ERR_DATA,
 * ERR_MEM, ERR_ARG. */
enum err_code tileset_tilejson(const struct store *s, const char *tiles_template, struct buf *out,
                               struct err *e) ERR_USE;

#endif
