/* Search for appearances by place, time and colour, in memory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SEARCH_H
#define SERVER_SEARCH_H

#include "core/base.h"
#include "server/route/target.h"

struct body;
struct dataset;
struct named_appearance_table;
struct search_index;

/* Builds the index of a dataset with appearance. Free *out with search_index_close. The colour of
 * an appearance is the colour to which its network changes mid grey, averaged over Gaussians of the
 * coarsest tile. It is unknown if that tile cannot be read. ERR_FORMAT, ERR_IO: a blob of the store
 * cannot be read. ERR_ARG (an invalid place), ERR_MEM. */
enum err_code search_open(const struct dataset *d, struct search_index **out,
                          struct err *e) ERR_USE;
/* Appends a page of JSON with the photographs that match t, and with named appearances (kept NULL:
 * none). Without a search (t->search.asked) it has all of them, and the default appearance. A
 * dataset without appearance has none. ERR_MEM. */
enum err_code search_write(const struct dataset *d, const struct appearances_target *t,
                           const struct named_appearance_table *kept, struct buf *out,
                           struct err *e) ERR_USE;
/* Makes the document of all appearances, without named ones. ERR_MEM. */
enum err_code search_all(const struct dataset *d, struct body **out, struct err *e) ERR_USE;
/* Upper limit of the result's bytes. Without a search it is that of the list of all. */
size_t search_room(const struct dataset *d, const struct appearances_target *t,
                   const struct named_appearance_table *kept);

#endif
