/* Addresses that documents and answers hand out, made from the templates of the route table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LINK_H
#define SERVER_LINK_H

#include "core/base.h"
#include "lod/key.h"

struct dataset;

/* What an address is relative to: the service, a dataset, a revision of one. */
enum link_from { LINK_ROOT, LINK_DATASET, LINK_REVISION };
struct link { /* what is NULL stays in the address as {name} */
    enum link_from from;
    const char *up; /* leads there: "..", "https://host/below"; NULL: nothing goes in front */
    const char *ds, *rev, *edition; /* edition "" or NULL: without */
    const struct key *key;
    const char *const *key_names; /* [3], instead of {z} {x} {y}; NULL: these */
    const char *ext;              /* of {ext} and {fmt} */
    const uint32_t *row;
    const char *with; /* parameter of what may be left out that stays; NULL: all is left out */
};
/* {from, up} to a dataset, and where it matters to its revision and the edition. */
struct link link_to(enum link_from from, const char *up, const struct dataset *d,
                    const char *edition);

/* Append the address of a route: link_tile(), link_tileset() and so on, one a row. */
#define ROUTE(name, path, scope, cache, rate, query, on)                                           \
    void link_##name(const struct link *l, struct buf *out);
#include "server/routes.def"
#undef ROUTE
/* The folder of a revision: "r/REV-EDITION/". */
void link_revision(const struct link *l, struct buf *out);
/* The same as a text of out[room]; "" where it does not fit. */
const char *link_text(void (*to)(const struct link *l, struct buf *out), const struct link *l,
                      char *out, size_t room);
/* What stands behind the folder of a dataset in a target of this service. */
const char *link_below_dataset(const char *target);

#endif
