/* What a client will ask for next, said in a Link field (RFC 8288): by the viewer's page before its
 * scripts are there, by tilesets and tiles for caches that fetch ahead.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HINT_H
#define SERVER_HINT_H

#include "server/catalog.h"
#include "server/target.h"

enum { HINT_SIZE = 768 };
/* The value of a Link field (RFC 8288; rel=preload of the HTML standard) for the page with this
 * query, [n] bytes as they were sent, without its '?': the catalogue, then tileset, network and
 * coarsest tile of the scene that the page opens. "" where the query sends the page to another
 * server. */
void hint_write(const struct catalog *c, const char *query, size_t n, char out[HINT_SIZE]);
/* Of a tileset's entry: the tile that every view begins with (rel=preload); "" where there are
 * several. */
void hint_tileset(const struct dataset *d, const struct target *t, char out[HINT_SIZE]);
/* Of a tile: those that take its place when a camera comes near (rel=prefetch), in its form. */
void hint_tile(const struct dataset *d, const struct store_tile *tile, const struct target *t,
               char out[HINT_SIZE]);

#endif
