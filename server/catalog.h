/* The datasets that are served at one moment.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CATALOG_H
#define SERVER_CATALOG_H

#include "server/dataset.h"

struct catalog { /* immutable; counted: a reload makes a new one */
    _Atomic uint32_t refs;
    size_t n, n_current;
    struct dataset *
        *ds; /* [0, n_current) are current, by name; then revisions that were replaced, the
                            latest first */
    double *replaced_s; /* [n]: when, by clock_s(); 0: current */
    struct body *collections;
};
struct catalog_options {
    size_t readers;          /* handles of each dataset */
    const struct clip *clip; /* of every store this part is served; NULL: all */
    const char *clip_dir;    /* where the parts lie, unnamed; NULL: see clip_open_part */
    const char *public_url;  /* of TileJSON and of collections; NULL, "": none */
    const char *base_path;   /* of collections; NULL, "": none */
    double keep_s;           /* revisions that were replaced are served so long */
    size_t keep_revisions;   /* and at most so many of one dataset */
    const char *basemap;     /* of the viewer's inset map, see collection_list */
    const char *basemap_attribution;
    unsigned preset; /* of tiles that do not say one: enum quant_preset */
};
/* Open every path. `older` (may be NULL; not changed) gives unchanged datasets and the revisions
 * that it has. catalog_drop it. ERR_ARG: two datasets of one name; the errors of dataset_open. */
enum err_code catalog_open(const char *const *paths, size_t n, const struct catalog_options *o,
                           const struct catalog *older, struct catalog **out,
                           struct err *e) ERR_USE;
/* Revisions of c whose time is over: c without them in *out, or NULL where there are none.
 * ERR_MEM. */
enum err_code catalog_expire(const struct catalog *c, const struct catalog_options *o, double now_s,
                             struct catalog **out, struct err *e) ERR_USE;
struct catalog *catalog_ref(struct catalog *c);
void catalog_drop(struct catalog **c);
/* Borrowed while c lives. rev "" = the current one. NULL when there is none. */
struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev);

#endif
