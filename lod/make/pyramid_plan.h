/* Plans the tiles of a pyramid and the order in which they are made. Internal to lod/.
 * pyramid_build.c fills and writes them.
 *
 * One thread makes the plan. It is only read while tiles are written.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PYRAMID_PLAN_H
#define LOD_PYRAMID_PLAN_H

#include "lod/make/pyramid.h"
#include "lod/make/spill.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"

enum {
    PYRAMID_LEVEL_MAX = STORE_LEVEL_MAX,
    PYRAMID_LONE_ROOTS = 4, /* this many tiles may be side by side at the top */
    PYRAMID_CLIMB_MAX = 3,  /* if they do not become fewer within this many zooms above */
};
struct pyramid_count { /* a tile, and the number of rows of a level in it */
    uint64_t code;     /* Morton code at its zoom */
    size_t n;
};
struct pyramid_table { /* sorted by code; {0} is empty */
    struct pyramid_count *cell;
    size_t n;
};

struct pyramid_node { /* a tile that exists, or a place with tiles below it */
    uint64_t code;    /* Morton code at its zoom */
    bool content;
};
struct pyramid_zoom { /* sorted by code */
    struct pyramid_node *node;
    size_t n, cap;
};

struct pyramid_job { /* one tile to write */
    uint64_t code;   /* Morton code at zoom z */
    uint8_t z, level;
    /* index of the level whose rows it takes; also of the runs with rows from simplification */
    uint8_t source;
    bool carried;
    bool feeds; /* a quarter of its rows goes into a tile above */
    bool made;
};

struct pyramid_runs { /* runs of one level, or of one zoom of simplified rows */
    struct spill_run *run;
    size_t n;
};

struct pyramid {
    struct locate locate;
    const struct pyramid_level *levels;
    size_t n_levels;
    const struct pyramid_config *cfg;
    struct pyramid_report *report;
    uint32_t max_per_tile;
    struct pyramid_runs runs[PYRAMID_LEVEL_MAX];
    size_t n_rows[PYRAMID_LEVEL_MAX];
    struct pyramid_zoom zoom[KEY_ZOOM_MAX + 1];
    /* zoom_least: coarsest zoom whose tiles are within reach */
    uint8_t top_level, zoom_max, zoom_least;
    uint8_t zoom_made; /* coarsest zoom of the levels that were given */
    struct pyramid_job *job;
    size_t n_jobs, cap_jobs;
    struct store_meta meta;
    struct spill spill;
};

static inline uint8_t pyramid_zoom_of(const struct pyramid *p, uint8_t level)
{
    return (uint8_t)(p->zoom_max - (p->top_level - level));
}

/* Codes of the finest zoom in the tile: [*first, *last). */
static inline void pyramid_range(uint64_t code, uint8_t z, uint64_t *first, uint64_t *last)
{
    unsigned shift = 2u * (unsigned)(KEY_ZOOM_MAX - z);
    *first = code << shift;
    *last = (code + 1) << shift;
}

/* Chooses zoom_max and zoom_least from the codes in p->runs. Warns if the wanted edge is not
 * possible. ERR_MEM, ERR_ARG. */
enum err_code pyramid_choose_zoom(struct pyramid *p, struct err *e) ERR_USE;
/* Plans all tiles with rows of a level, copies of coarser rows included, finest level first.
 * p->zoom gets the nodes. ERR_MEM. */
enum err_code pyramid_plan(struct pyramid *p, struct err *e) ERR_USE;
/* Returns whether tiles side by side at zoom z can be the top. `code` [n] is sorted. They can if
 * there are at most PYRAMID_LONE_ROOTS of them, and no fewer within PYRAMID_CLIMB_MAX zooms above.
 */
bool pyramid_is_top(const uint64_t *code, size_t n, uint8_t z);
/* Plans the zoom above z, whose tiles are simplified from those below. Returns false if z is the
 * top. */
bool pyramid_plan_up(struct pyramid *p, uint8_t z, enum err_code *rc, struct err *e);
/* Appends a job. ERR_MEM. */
enum err_code pyramid_add_job(struct pyramid *p, struct pyramid_job job, struct err *e) ERR_USE;

#endif
