/* Which tiles a pyramid will have, and in which order they are made: internal to lod/.
 * pyramid_build.c fills and writes them.
 *
 * One thread plans; the plan is only read while tiles are written.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PYRAMID_PLAN_H
#define LOD_PYRAMID_PLAN_H

#include "lod/locate.h"
#include "lod/pyramid.h"
#include "lod/spill.h"
#include "lod/store.h"

enum {
    PYRAMID_LEVEL_MAX = STORE_LEVEL_MAX,
    PYRAMID_LONE_ROOTS = 4, /* so few tiles may stand side by side at the top ... */
    PYRAMID_CLIMB_MAX = 3,  /* ... if there are no fewer of them so many zooms up */
};
struct pyramid_count { /* a tile and how many rows of a level are in it */
    uint64_t code;     /* at its zoom */
    size_t n;
};
struct pyramid_table { /* sorted by code; {0} is empty */
    struct pyramid_count *cell;
    size_t n;
};

struct pyramid_node { /* a tile that exists, or one with tiles below */
    uint64_t code;    /* at its zoom */
    bool content;
};
struct pyramid_zoom { /* sorted by code */
    struct pyramid_node *node;
    size_t n, cap;
};

struct pyramid_job { /* one tile to write */
    uint64_t code;   /* at zoom z */
    uint8_t z, level;
    uint8_t source; /* index of the level whose rows it takes; runs of what was made otherwise */
    bool carried;
    bool feeds; /* a quarter of it goes into a tile above */
    bool made;
};

struct pyramid_runs { /* of one level, or of one generation of what was made */
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
    uint8_t top_level, zoom_max, zoom_least; /* least: tiles still fit the reach */
    uint8_t zoom_made;                       /* the coarsest zoom that levels were given for */
    struct pyramid_job *job;
    size_t n_jobs, cap_jobs;
    struct store_meta meta;
    struct spill spill;
};

static inline uint8_t pyramid_zoom_of(const struct pyramid *p, uint8_t level)
{
    return (uint8_t)(p->zoom_max - (p->top_level - level));
}

/* Codes of the finest zoom that lie in the tile: [*first, *last). */
static inline void pyramid_range(uint64_t code, uint8_t z, uint64_t *first, uint64_t *last)
{
    unsigned shift = 2u * (unsigned)(KEY_ZOOM_MAX - z);
    *first = code << shift;
    *last = (code + 1) << shift;
}

/* From the codes in p->runs: zoom_max, zoom_least. Warns where the wish cannot be had. ERR_MEM,
 * ERR_ARG. */
enum err_code pyramid_choose_zoom(struct pyramid *p, struct err *e) ERR_USE;
/* All tiles that take rows of a level, carried ones included, finest level first; p->zoom holds the
 * nodes. ERR_MEM. */
enum err_code pyramid_plan(struct pyramid *p, struct err *e) ERR_USE;
/* Tiles side by side, their codes at one zoom sorted: are there no fewer within PYRAMID_CLIMB_MAX
 * zooms above, and few enough to be the top? */
bool pyramid_is_top(const uint64_t *code, size_t n, uint8_t z);
/* The zoom above z that is to be made of what lies below, and its nodes; false: z is the top. */
bool pyramid_plan_up(struct pyramid *p, uint8_t z, enum err_code *rc, struct err *e);
/* NULL when there is none. */
const struct pyramid_node *pyramid_find(const struct pyramid *p, uint8_t z, uint64_t code);
/* Append a job. ERR_MEM. */
enum err_code pyramid_add_job(struct pyramid *p, struct pyramid_job job, struct err *e) ERR_USE;

#endif
