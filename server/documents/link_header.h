/* Link fields (RFC 8288) for the next requests of a client: on the viewer's page, before its
 * scripts are loaded, and on tilesets and tiles, for caches that prefetch.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LINK_HEADER_H
#define SERVER_LINK_HEADER_H

#include "server/documents/catalog.h"
#include "server/route/target.h"

enum { LINK_HEADER_SIZE = 768 };
/* Writes the value of a Link field (rel=preload of the HTML standard) for the page with this query,
 * [n] bytes as sent, without '?'. It names the catalogue, then tileset, network and coarsest tile
 * of the scene that the page opens. "": the query points to another server. */
void link_header_write(const struct catalog *c, const char *query, size_t n,
                       char out[LINK_HEADER_SIZE]);
/* The dataset that the page with this query opens; NULL: of another server, or there is none. It is
 * borrowed from the catalogue. */
const struct dataset *link_header_scene(const struct catalog *c, const char *query, size_t n);
/* For a tileset's entry, moving or of a revision: the tile that every view begins with
 * (rel=preload). "": there are several. */
void link_header_tileset(const struct dataset *d, bool moving, const struct target_tiles *t,
                         char out[LINK_HEADER_SIZE]);
/* For a tile: the tiles that replace it when a camera comes near (rel=prefetch), in the same form.
 */
void link_header_tile(const struct dataset *d, const struct store_tile *tile,
                      const struct target_tiles *t, char out[LINK_HEADER_SIZE]);

#endif
