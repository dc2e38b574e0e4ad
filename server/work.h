/* What a job does: from a dataset to bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORK_H
#define SERVER_WORK_H

#include "lod/key.h"
#include "lod/query.h"
#include "server/course.h"
#include "server/map_tile.h"
#include "server/services.h"

enum work_kind {
    WORK_TILE,
    WORK_SEED,
    WORK_TILESET,
    WORK_VIEW,
    WORK_MAP,
    WORK_QUERY,
    WORK_THUMBNAIL,
    WORK_SEARCH,
    WORK_KEEP
};
/* A name to keep or to forget. */
struct work_change {
    bool removes;
    struct kept_row row;      /* to remove: ds and name alone */
    char *match, *none_match; /* owned; NULL: absent */
};
struct work { /* freed with work_drop */
    enum work_kind kind;
    struct dataset *ds; /* a reference */
    struct hash128 id;  /* names the result: cache key and job id */
    struct key key;     /* WORK_TILE, WORK_MAP; WORK_TILESET with part */
    bool part;          /* WORK_TILESET: the document that begins at key */
    struct form form;   /* nothing left unsaid */
    struct appearance_choice appearance;
    struct target target;       /* of lists and thumbnails; of WORK_TILE its clip */
    struct draw_view view;      /* WORK_VIEW */
    struct map_tile map;        /* WORK_MAP */
    struct query *query;        /* WORK_QUERY, owned */
    struct course *course;      /* WORK_SEED, owned; NULL: none */
    struct kept_table *kept;    /* WORK_SEARCH: a reference; NULL: no names are kept */
    struct work_change *change; /* WORK_KEEP, owned */
    bool keep;                  /* put the result into the cache */
    struct body *made;          /* goes to the disk when everybody has it; NULL: nothing does */
};
/* About the bytes of the result, from above: what it takes of --inflight-mb while it is made. */
enum { WORK_ROOM_HEAD = 4096 }; /* of it for heads and ends */
size_t work_room(const struct work *w);
const char *work_noun(enum work_kind kind); /* "map tile": for messages */
/* Run on a worker: from the store to bytes. The result goes to the cache before the job ends. The
 * errors of what is made; ERR_MEM. */
enum err_code work_run(void *services, const struct job *j, void *work, size_t worker,
                       struct body **out, struct err *e) ERR_USE;
void work_drop(void *services, void *work);
bool work_passing(const void *work); /* a picture, or what is not kept: see job_config */

#endif
