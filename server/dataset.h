/* One revision of one store: index, handles and documents.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DATASET_H
#define SERVER_DATASET_H

#include <pthread.h>
#include <stdatomic.h>

#include "lod/area.h"
#include "server/body.h"

struct clip;
struct search_index;

struct dataset { /* immutable but for what the comments say; counted */
    _Atomic uint32_t refs;
    char *path;          /* of this revision, when it was opened */
    char source[13];     /* revision of what is at the path; meta.revision unless it was clipped */
    struct hash128 clip; /* clip_hash of what it was clipped to */
    int fd;              /* its file, whatever that path names by now; of a clipped one its part */
    struct store_meta meta;
    const struct store_tile *tiles;
    size_t n_tiles;
    const struct store *index;           /* stores[0], for what threads may share of a store */
    const struct appearance *appearance; /* of the store; NULL: one appearance only */
    struct area area;                    /* what was surveyed; .in NULL: nothing is known */
    double bbox[6];                      /* west south hmin east north hmax, degrees and metres */
    struct hash128 salt;         /* of all that goes into an encoded tile beside its payload */
    char edition[9];             /* of its tiles (result_id.h); by catalog.c, as are these seven: */
    struct body *tileset;        /* URIs relative to d/NAME/r/REV/ */
    struct body *tileset_moving; /* URIs relative to d/NAME/ */
    struct body *tilejson;
    struct body *collection;
    struct body *appearances;
    struct body *model, *photographs; /* NULL without appearance, as is search */
    struct search_index *search;      /* of its photographs */
    _Atomic uint32_t n_failed;        /* results that its file did not give: it is damaged */
    pthread_mutex_t lock;             /* of free_store, n_free */
    struct store **stores, **free_store;
    size_t n_stores, n_free;
};

/* Open `path` with `readers` handles for workers. clip (may be NULL): the part of it that this
 * leaves, as a file in clip_dir that goes with the dataset. dataset_drop it. The errors of
 * store_open and clip_open_part, ERR_MEM. */
enum err_code dataset_open(const char *path, size_t readers, const struct clip *clip,
                           const char *clip_dir, struct dataset **out, struct err *e) ERR_USE;
struct dataset *dataset_ref(struct dataset *d);
void dataset_drop(struct dataset **d);
/* Is the caller's the only reference? Nobody can take another one then. */
bool dataset_is_last(const struct dataset *d);
/* A handle for this thread alone until dataset_return. NULL only if more threads borrow than
 * `readers`. */
struct store *dataset_borrow(struct dataset *d);
void dataset_return(struct dataset *d, struct store *s);

#endif
