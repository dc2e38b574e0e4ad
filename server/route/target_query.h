/* Writes the query of a target again, for documents and names of results.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_QUERY_H
#define SERVER_TARGET_QUERY_H

#include "server/route/target.h"

/* Writes "?preset=NAME&sh=N&clip=C&appearance=A" with the parts that were given, else "". */
void target_query_tiles(const struct target_tiles *t, char out[TARGET_QUERY_MAX]);
/* Writes the query of a prefetch list, "?...", for the page after so many lines. */
void target_query_seed(const struct seed_target *t, uint32_t after, struct buf *out);

#endif
