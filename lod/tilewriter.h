/* Tiles that many workers encode, written in order by whoever holds the next one: internal to lod/.
 *
 * The bytes of a store depend on the order in which tiles are written; this makes it that of their
 * numbers, whatever the number of threads, and keeps at most TILEWRITER_AHEAD payloads in memory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TILEWRITER_H
#define LOD_TILEWRITER_H

#include <stddef.h>

#include "core/err.h"

struct gauss;
struct store;
struct store_tile;

enum { TILEWRITER_AHEAD = 16 };

struct tilewriter;
/* For tiles 0 .. n - 1 of a store that is being built (borrowed). ERR_MEM. */
enum err_code tilewriter_open(struct store *s, size_t n, struct tilewriter **out,
                              struct err *e) ERR_USE;
void tilewriter_close(struct tilewriter **w);
/* Encode tile i and write it when its turn comes; waits while it is too far ahead, so low numbers
 * must be begun first (as pool_for does). Each number once. Thread-safe. ERR_CANCEL when another
 * worker gave up; errors of store_put (ERR_DATA, ERR_LIMIT, ERR_IO, ERR_MEM). */
enum err_code tilewriter_put(struct tilewriter *w, size_t i, struct store_tile *t,
                             const struct gauss *g, struct err *e) ERR_USE;
/* A worker gave up: nobody waits for it. */
void tilewriter_fail(struct tilewriter *w);

#endif
