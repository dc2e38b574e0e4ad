/* The datasets that are served at one moment.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CATALOG_H
#define SERVER_CATALOG_H

#include "server/data/dataset.h"

struct geoid;

struct catalog { /* immutable, reference-counted; a reload makes a new one */
    _Atomic uint32_t refs;
    size_t n, n_current;
    struct dataset *
        *ds; /* [0, n_current) are current, sorted by name; then replaced revisions, latest first */
    double *replaced_s; /* [n] when it was replaced, by clock_s(); 0: current */
    struct body *collections;
};
struct catalog_options {
    size_t readers;          /* handles for each dataset */
    const struct clip *clip; /* this part of each store is served; NULL: all */
    /* folder for clipped stores, which are unnamed files; NULL: see clip_open_part */
    const char *clip_dir;
    const char *public_url; /* for collections; NULL, "": none */
    const char *base_path;  /* for collections; NULL, "": none */
    double keep_s;          /* replaced revisions are served for this time */
    size_t keep_revisions;  /* and at most this many of a dataset */
    const char *basemap;    /* for the viewer's inset map, see collection_list */
    const char *basemap_attribution;
    size_t city_gaussians;     /* for collections */
    unsigned preset;           /* of tiles whose address names none: enum quant_preset */
    const struct geoid *geoid; /* turns heights above the sea into ellipsoidal ones; NULL: none */
};
/* Opens all paths. `older` (may be NULL) gives unchanged datasets and older revisions; it is not
 * changed. Free *out with catalog_drop. ERR_ARG: two datasets have the same name. Else the errors
 * of dataset_open. */
enum err_code catalog_open(const char *const *paths, size_t n, const struct catalog_options *o,
                           const struct catalog *older, struct catalog **out,
                           struct err *e) ERR_USE;
/* Removes revisions whose time is over: *out is a copy of c without them, or NULL if there are
 * none. ERR_MEM. */
enum err_code catalog_expire(const struct catalog *c, const struct catalog_options *o, double now_s,
                             struct catalog **out, struct err *e) ERR_USE;
struct catalog *catalog_ref(struct catalog *c);
void catalog_drop(struct catalog **c);
/* Finds a dataset; borrowed from c. rev "": the current revision. NULL: there is none. */
struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev);

#endif
