/* The datasets that are served at one moment, and the stores that are not.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CATALOG_H
#define SERVER_CATALOG_H

#include "server/data/dataset.h"

struct collection_options;
struct geoid;

struct catalog_absent { /* a store that is asked for, and is not served as it is now */
    char *path;         /* log and documents show it without secrets (range_show) */
    char why[256];      /* begins with the path */
    enum err_code code;
    double again_s, pause_s; /* by clock_s(): when it is tried again; the pause before that */
};
struct catalog { /* immutable, reference-counted; a reload makes a new one */
    _Atomic uint32_t refs;
    size_t n, n_current, n_absent;
    struct dataset *
        *ds; /* [0, n_current) are current, sorted by name; then replaced revisions, latest first */
    double *replaced_s;            /* [n] when it was replaced, by clock_s(); 0: current */
    struct catalog_absent *absent; /* [n_absent] in the order in which they were asked for */
    struct body *collections;
};
struct catalog_options {
    size_t readers; /* handles for each dataset */
    bool lazy; /* there are many datasets: handles and documents are made when they are needed */
    const char *public_url;    /* for collections; NULL, "": none */
    double keep_s;             /* replaced revisions are served for this time */
    size_t keep_revisions;     /* and at most this many of a dataset */
    size_t city_gaussians;     /* for collections */
    unsigned preset;           /* of tiles whose address names none: enum quant_preset */
    const struct geoid *geoid; /* turns heights above the sea into ellipsoidal ones; NULL: none */
    double again_s; /* the first pause of a store that is not there; it doubles up to 60 times */
};

/* Where a store is asked for, and what was found there. */
struct catalog_place {
    const char *path;   /* borrowed */
    bool far;           /* an address */
    bool looked;        /* false: what the older catalog has of it stays */
    struct dataset *ds; /* the store there, a reference; NULL: none, and `why` says why not */
    struct err why;
};
/* Lists the places of stores: the arguments [n] in their order, each once, and in place of a folder
 * its files NAME.tiles, sorted. Invalid entries stay in the list, and catalog_look says what is
 * wrong. Of a folder that cannot be read, the places stay that `older` (may be NULL) has of it.
 * Paths live in the arena. *folders: how many folders are among the arguments. ERR_FORMAT: a folder
 * is a scene. ERR_MEM. */
enum err_code catalog_list(const char *const *args, size_t n, const struct catalog *older,
                           struct arena *a, struct catalog_place **out, size_t *n_out,
                           size_t *folders, struct err *e) ERR_USE;
/* Lists the places that a catalog has, whatever is there by now. ERR_MEM. */
enum err_code catalog_list_same(const struct catalog *c, struct arena *a,
                                struct catalog_place **out, size_t *n_out, struct err *e) ERR_USE;
/* Opens the store of a place, or takes it from `older` (may be NULL), where it is still the same.
 * Threads may look at places of one list. */
void catalog_look(struct catalog_place *p, const struct catalog_options *o,
                  const struct catalog *older);
/* A document of a dataset, as a reference; it is made now if nobody asked for it before. The
 * options must be those of every other call for this dataset. NULL: out of memory. Any thread. */
struct body *catalog_document(struct dataset *d, enum dataset_document which,
                              const struct collection_options *o);
/* Gives back the datasets of places that no catalog took. */
void catalog_forget(struct catalog_place *p, size_t n);
/* Makes a catalog of what was found at places [n], whose datasets it takes over, and of `older`
 * (may be NULL), which is not changed: datasets of places where nothing was found now stay, and so
 * do replaced revisions. Of two stores with one name, the one that is served stays, else the
 * first. Free *out with catalog_drop. ERR_MEM. */
enum err_code catalog_make(struct catalog_place *p, size_t n, const struct catalog_options *o,
                           const struct catalog *older, struct catalog **out,
                           struct err *e) ERR_USE;
/* What `newer` has otherwise than `older` (NULL: nothing was served), as JSON: {"added": [NAME],
 * "removed": [NAME], "replaced": [{"name", "from", "to"}], "failed": [{"store", "why"}]}. NULL: out
 * of memory. */
struct json_t *catalog_changes(const struct catalog *older, const struct catalog *newer);
/* Writes the same to the log, a line each; of stores that failed those whose reason is new. */
void catalog_log(const struct catalog *older, const struct catalog *newer);
/* Removes revisions whose time is over: *out is a copy of c without them, or NULL if there are
 * none. ERR_MEM. */
enum err_code catalog_expire(const struct catalog *c, const struct catalog_options *o, double now_s,
                             struct catalog **out, struct err *e) ERR_USE;
struct catalog *catalog_ref(struct catalog *c);
void catalog_drop(struct catalog **c);
/* Finds a dataset; borrowed from c. rev "": the current revision. NULL: there is none. */
struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev);

#endif
