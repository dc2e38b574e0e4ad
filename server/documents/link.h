/* Addresses in documents and answers, made from the templates of the route table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LINK_H
#define SERVER_LINK_H

#include "core/base.h"
#include "lod/store/key.h"

struct dataset;

/* What an address is relative to: the service, a dataset, or a revision of one. */
enum link_from { LINK_ROOT, LINK_DATASET, LINK_REVISION };
struct link { /* a member that is NULL stays in the address as {name} */
    enum link_from from;
    const char *up;                 /* path to `from`: "..", "https://host/below"; NULL: none */
    const char *ds, *rev, *edition; /* edition "" or NULL: leave it out */
    const struct key *key;
    const char *const *key_names; /* [3], instead of {z} {x} {y}; NULL: these */
    const char *ext;              /* for {ext} and {fmt} */
    const uint32_t *row;
    const char *seal; /* of link_signed(), which then ends with '/' */
    const char *with; /* optional parameter that stays in the address; NULL: all are left out */
};
/* Makes {from, up} for a dataset, with its revision and the edition where `from` needs them. */
struct link link_to(enum link_from from, const char *up, const struct dataset *d,
                    const char *edition);

/* Append the address of a route: link_tile(), link_tileset() and so on, one for each row. */
#define ROUTE(name, path, scope, cache, rate, query, on)                                           \
    void link_##name(const struct link *l, struct buf *out);
#include "server/route/routes.def"
#undef ROUTE
/* Appends the folder of a revision: "r/REV-EDITION/". */
void link_revision(const struct link *l, struct buf *out);
/* Writes an address as text to out [room]; "" if it does not fit. */
const char *link_text(void (*to)(const struct link *l, struct buf *out), const struct link *l,
                      char *out, size_t room);
/* Copies an address for a log, with '-' in place of what gives access: a seal, or the signature of
 * a query. It is cut where there is no room. */
const char *link_mask(const char *address, char *out, size_t room);
/* Returns the part of a target after the folder of a dataset. */
const char *link_below_dataset(const char *target);

#endif
