/* What a job does: from a dataset to bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORK_H
#define SERVER_WORK_H

#include "lod/key.h"
#include "lod/query.h"
#include "server/film.h"
#include "server/map_tile.h"
#include "server/services.h"

enum work_kind {
    WORK_TILE,
    WORK_SEED,
    WORK_TILESET,
    WORK_TILEJSON,
    WORK_VIEW,
    WORK_MAP,
    WORK_QUERY,
    WORK_THUMBNAIL,
    WORK_SEARCH,
    WORK_KEEP
};
/* A change of a named appearance. */
struct work_change {
    bool removes;
    struct kept_row row;      /* to remove a name: only ds and name are set */
    char *match, *none_match; /* owned; NULL: absent */
};
struct work { /* freed with work_drop */
    enum work_kind kind;
    struct dataset *ds; /* a reference */
    struct hash128 id;  /* name of the result: cache key and job id */
    struct key key;     /* WORK_TILE, WORK_MAP; WORK_TILESET with part */
    bool part;          /* WORK_TILESET: the document that begins at key */
    struct form form;   /* complete (encode_form) */
    struct appearance_choice appearance;
    struct target target;       /* for lists and thumbnails; for WORK_TILE its clip */
    struct draw_view view;      /* WORK_VIEW */
    struct film *film;          /* WORK_VIEW: a reference; NULL: it is a picture by itself */
    struct film_shot shot;      /* with film */
    struct map_tile map;        /* WORK_MAP */
    struct query *query;        /* WORK_QUERY, owned */
    char *public_url;           /* WORK_TILEJSON, owned; NULL: its addresses are relative */
    struct kept_table *kept;    /* WORK_SEARCH: a reference; NULL: there are no named appearances */
    struct work_change *change; /* WORK_KEEP, owned */
    bool keep;                  /* keep the result in the cache */
    struct body *made; /* body that is written to the disk after the waiters have it; NULL: none */
};
/* Upper limit of the result's bytes: its share of --inflight-mb while it is made. */
enum { WORK_ROOM_HEAD = 4096 }; /* part of work_room for head and end */
size_t work_room(const struct work *w);
/* Estimates the time of work by formulas, in ms, and gives the kind that learns from it:
 * job_config.cost. */
double work_cost(const void *work, unsigned *kind);
const char *work_noun(enum work_kind kind); /* "map tile": for messages */
/* Makes the bytes in a worker thread, from the store. The result is in the cache before the job
 * ends. ERR_MEM, and the errors of the kind of work. */
enum err_code work_run(void *services, const struct job *j, void *work, size_t worker,
                       struct body **out, struct err *e) ERR_USE;
void work_drop(void *services, void *work);
bool work_passing(const void *work); /* whether it is a picture, or is not kept: see job_config */

#endif
