/* One revision of one store: index, handles and documents.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DATASET_H
#define SERVER_DATASET_H

#include <pthread.h>
#include <stdatomic.h>

#include "lod/store/area.h"
#include "lod/store/store.h"
#include "server/base/body.h"

struct appearance_rows;
struct geoid;

enum dataset_document {
    DATASET_TILESET,        /* with URIs relative to d/NAME/r/REV/ */
    DATASET_TILESET_MOVING, /* with URIs relative to d/NAME/ */
    DATASET_COLLECTION,
    DATASET_APPEARANCES,
    DATASET_DOCUMENTS
};

struct dataset { /* immutable except where a comment says otherwise; reference-counted */
    _Atomic uint32_t refs;
    char *path; /* path of this revision when it was opened */
    /* revision of the store at that path; meta.revision unless it was raised */
    char source[13];
    double lift_m; /* by which the geoid raised the store's heights to ellipsoidal ones; else 0 */
    int fd;        /* its open file, even if the path names another one by now */
    struct store_meta meta;
    const struct store_tile *tiles;
    size_t n_tiles;
    const struct store *index; /* stores[0], for parts of a store that threads may share */
    const struct appearance *appearance; /* of the store; NULL: only one appearance */
    /* days of its first and last photograph, 2024-06-01; "": not known; set with `photographs` */
    char taken[2][11];
    struct area area;    /* surveyed area; .in NULL: not known */
    double bbox[6];      /* west south hmin east north hmax, in degrees and metres */
    struct hash128 salt; /* hash of all that determines an encoded tile except its payload */
    char edition[9];     /* of its tiles (result_id.h); catalog.c sets this and the next five: */
    int64_t opened_s;    /* seconds since 1970 */
    struct body *_Atomic document[DATASET_DOCUMENTS]; /* catalog_document; NULL: not made yet */
    struct body *model, *photographs;                 /* NULL without appearance; so is rows */
    struct appearance_rows *rows;                     /* what is known of its photographs */
    /* number of results that could not be read from its file: the file is damaged */
    _Atomic uint32_t n_failed;
    pthread_mutex_t lock; /* for what follows */
    /* Handles: [n_stores] that are open, [n_free] that no thread borrows; n_begun: with those that
     * are being opened, of n_most. A handle is opened when it is needed, or all by
     * dataset_open_all. */
    struct store **stores, **free_store;
    size_t n_stores, n_free, n_begun, n_most;
};

/* Opens the store at `path` with at most `readers` handles for worker threads. geoid (may be NULL):
 * a store whose heights count from the sea becomes a revision of its own, with ellipsoidal heights.
 * Free *out with dataset_drop. ERR_MEM, and the errors of store_open. */
enum err_code dataset_open(const char *path, size_t readers, const struct geoid *geoid,
                           struct dataset **out, struct err *e) ERR_USE;
/* Opens all handles, before threads share d. Handles that are open read what is left of a file that
 * is cut off in its place; but they take memory, and of a thousand stores few are asked for. Errors
 * of store_open_more: ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code dataset_open_all(struct dataset *d, struct err *e) ERR_USE;
struct dataset *dataset_ref(struct dataset *d);
void dataset_drop(struct dataset **d);
/* Returns whether the caller has all references, `held`. No other thread can then take one. */
bool dataset_is_last(const struct dataset *d, unsigned held);
/* Borrows a handle for this thread until dataset_return. ERR_INTERNAL: more threads borrow than
 * `readers`. Else the errors of store_open_more. */
enum err_code dataset_borrow(struct dataset *d, struct store **out, struct err *e) ERR_USE;
void dataset_return(struct dataset *d, struct store *s);

#endif
