/* The query of a target again, as documents and names of results hold it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_QUERY_H
#define SERVER_TARGET_QUERY_H

#include "server/target.h"

/* "?preset=NAME&sh=N&clip=C&appearance=A" as far as the target says them, else "". */
void target_query_tiles(const struct target *t, char out[TARGET_QUERY_MAX]);
/* The query of a prefetch list again, "?...", that goes on after so many lines. path: of the
 * course, for the borrowed one may be gone; NULL where there is none. */
void target_query_seed(const struct target *t, const char *path, uint32_t after, struct buf *out);
/* The query of a search again, "?...", that goes on after so many. */
void target_query_search(const struct target *t, uint32_t after, struct buf *out);

#endif
