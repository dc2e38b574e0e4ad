/* The datasets that are served at one moment.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CATALOG_H
#define SERVER_CATALOG_H

#include "server/dataset.h"

struct catalog { /* immutable; counted: a reload makes a new one */
    _Atomic uint32_t refs;
    size_t n;
    struct dataset **ds; /* sorted by name; the current revision of a name first */
    struct body *collections;
};
/* Open every path, with `readers` handles each. `older` (may be NULL) gives unchanged datasets and
 * revisions that stay a day more. catalog_drop it. ERR_ARG: two datasets of one name; the errors of
 * dataset_open. */
enum err_code catalog_open(const char *const *paths, size_t n, size_t readers,
                           const char *public_url, struct catalog *older, struct catalog **out,
                           struct err *e) ERR_USE;
struct catalog *catalog_ref(struct catalog *c);
void catalog_drop(struct catalog **c);
/* Borrowed while c lives. rev "" = the current one. NULL when there is none. */
struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev);

#endif
