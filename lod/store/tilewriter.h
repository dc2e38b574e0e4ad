/* Writes tiles in order while many threads encode them. Internal to lod/.
 *
 * The bytes of a store depend on the order of its tiles. Tiles are written in the order of their
 * numbers, for any number of threads. At most TILEWRITER_AHEAD payloads are in memory. The thread
 * that holds the next tile writes it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TILEWRITER_H
#define LOD_TILEWRITER_H

#include <stddef.h>

#include "core/err.h"

struct gauss;
struct store;
struct store_entry;

enum { TILEWRITER_AHEAD = 16 };

struct tilewriter;
/* Prepares to write tiles 0 .. n - 1 of a store that is being built (borrowed). ERR_MEM. */
enum err_code tilewriter_open(struct store *s, size_t n, struct tilewriter **out,
                              struct err *e) ERR_USE;
void tilewriter_close(struct tilewriter **w);
/* Encodes tile i, and writes it when all lower numbers are written. It waits if it is too far
 * ahead, so low numbers must begin first (as in pool_for). Each number is put once. Any thread may
 * call it. ERR_CANCEL: another thread failed. ERR_DATA, ERR_LIMIT, ERR_IO, ERR_MEM as in store_put.
 */
enum err_code tilewriter_put(struct tilewriter *w, size_t i, struct store_entry *t,
                             const struct gauss *g, struct err *e) ERR_USE;
/* Call it when a thread has failed: the others no longer wait for it. */
void tilewriter_fail(struct tilewriter *w);

#endif
