/* Appearances by place, time and colour: what a dataset knows of its photographs, in memory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SEARCH_H
#define SERVER_SEARCH_H

#include "core/base.h"
#include "server/target.h"

struct dataset;
struct kept_table;
struct search_index;

/* Of a dataset with appearance; search_index_close it. The colour of an appearance is
 * what its network makes of mid grey, averaged over Gaussians of the coarsest tile; unknown where
 * that cannot be read. ERR_FORMAT, ERR_IO: a blob of the store cannot be read; ERR_ARG (a place
 * that is none), ERR_MEM. */
enum err_code search_open(const struct dataset *d, struct search_index **out,
                          struct err *e) ERR_USE;
/* A page of the photographs that t asks for, and of names that are kept (NULL: none) as JSON,
 * appended to out. ERR_MEM. */
enum err_code search_write(const struct dataset *d, const struct search_index *s,
                           const struct target *t, const struct kept_table *kept, struct buf *out,
                           struct err *e) ERR_USE;
/* Bytes of the result, from above; of the list of all, where nothing is asked for. */
size_t search_room(const struct dataset *d, const struct target *t, const struct kept_table *kept);

#endif
