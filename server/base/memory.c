/* The shares of --memory. What must be there is taken first: the program, its threads, what workers
 * need for the largest tile, the process that draws. The rest goes to caches, bodies under way and
 * drawing, by weights. An option that names a size takes that size out of the rest.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/memory.h"

#include <math.h>
#include <string.h>

enum { MEMORY_MB = 1 << 20, MEMORY_SLOTS = 4, MEMORY_CONNECTIONS_MIN = 64 };
/* Measured (lab/SERVING.md, docs/scale.md). */
#define MEMORY_THREADS ((size_t)8 * MEMORY_MB)   /* stacks, buffers of sockets, log */
#define MEMORY_DRAWING ((size_t)110 * MEMORY_MB) /* OpenCL by PoCL, kernels, libraries */
#define MEMORY_CONNECTION ((size_t)20 << 10)     /* an idle one */
#define MEMORY_ENCODING 5                        /* a worker, of a tile's decoded bytes */
#define MEMORY_GAUSSIAN ((size_t)240)            /* drawn */
#define MEMORY_PIXEL ((size_t)16)                /* drawn */
#define MEMORY_PIXELS_A_PICTURE 4                /* supersampled */
/* The least that works. */
#define MEMORY_CACHE_MIN ((size_t)4 * MEMORY_MB)
#define MEMORY_INFLIGHT_MIN ((size_t)8 * MEMORY_MB)
#define MEMORY_VIEW_CACHE_MIN ((size_t)4 * MEMORY_MB)
#define MEMORY_GAUSSIANS_MIN 50000
#define MEMORY_MPX_MIN 1.0
/* One of 16 parts is what the allocator holds without use; connections have half a part, workers
 * two. */
#define MEMORY_PARTS 16
/* Of what drawing left, encoders of streams have a quarter. Without one a stream is JPEG. */
#define MEMORY_VIDEO_PART 4

/* ---- shares ---- */

static size_t memory_min(size_t a, size_t b)
{
    return a < b ? a : b;
}

static size_t memory_max(size_t a, size_t b)
{
    return a > b ? a : b;
}

struct memory_parts { /* bytes */
    size_t fixed;     /* of this process */
    size_t cache, inflight, video;
    unsigned drawers;
    size_t drawing, view_cache, gaussians, others, pixels; /* of each */
    unsigned slots;
};

/* Of one process that draws. */
static size_t memory_drawer(const struct memory_parts *p)
{
    return p->drawing + p->view_cache + p->gaussians + p->others + p->pixels;
}

static size_t memory_sum(const struct memory_parts *p)
{
    return p->fixed + p->cache + p->inflight + p->drawers * memory_drawer(p);
}

static uint64_t memory_drawn_gaussians(const struct memory_needs *n)
{
    return n->view_gaussians && n->view_gaussians < n->gaussians ? n->view_gaussians : n->gaussians;
}

/* The least that works, with as many workers and connections as a budget allows. */
static void memory_least_parts(const struct memory_needs *n, unsigned drawers,
                               struct memory_plan *plan, struct memory_parts *p)
{
    const size_t part = n->budget / MEMORY_PARTS, each = n->largest_tile * MEMORY_ENCODING;
    memset(p, 0, sizeof *p);
    plan->workers = memory_max(1, memory_min(n->workers, each ? 2 * part / each : n->workers));
    plan->connections = memory_min(
        n->connections, memory_max(MEMORY_CONNECTIONS_MIN, part / 2 / MEMORY_CONNECTION));
    p->fixed = n->base + MEMORY_THREADS + part + plan->workers * each +
               plan->connections * MEMORY_CONNECTION;
    p->cache = n->cache ? n->cache : MEMORY_CACHE_MIN;
    p->inflight = n->inflight ? n->inflight : memory_max(MEMORY_INFLIGHT_MIN, n->largest_tile);
    p->drawers = drawers;
    if (!drawers)
        return;
    p->drawing = MEMORY_DRAWING;
    p->view_cache = n->view_cache ? n->view_cache : MEMORY_VIEW_CACHE_MIN;
    p->gaussians =
        (size_t)memory_min(memory_drawn_gaussians(n), MEMORY_GAUSSIANS_MIN) * MEMORY_GAUSSIAN;
    p->pixels = (size_t)(fmin(n->view_mpx, MEMORY_MPX_MIN) * 1e6) * MEMORY_PIXEL;
}

/* The least of a budget depends on the budget: its slack is a part of it. */
static size_t memory_enough(const struct memory_needs *n, bool draws)
{
    struct memory_needs more = *n;
    struct memory_plan plan;
    struct memory_parts p;
    for (more.budget = MEMORY_MB; more.budget < SIZE_MAX / 4; more.budget += 4 * MEMORY_MB) {
        memory_least_parts(&more, draws, &plan, &p); /* one that draws, or none */
        if (memory_sum(&p) <= more.budget)
            break;
    }
    return more.budget;
}

static enum err_code memory_too_little(const struct memory_needs *n, struct err *e)
{
    const size_t with = memory_enough(n, true), without = memory_enough(n, false);
    const unsigned long long budget = n->budget / MEMORY_MB;
    if (n->draws && without < n->budget)
        return err_set(e, ERR_LIMIT,
                       "%lluM of memory are too little for these stores and pictures: give "
                       "--memory %zuM or more, or serve tiles alone: --device none",
                       budget, with / MEMORY_MB);
    return err_set(e, ERR_LIMIT,
                   "%lluM of memory are too little for these stores: give --memory %zuM or more%s",
                   budget, (n->draws ? with : without) / MEMORY_MB,
                   n->draws ? ", with --device none less" : "");
}

/* Adds up to `most` of `rest` to a part. */
static void memory_grow(size_t *part, size_t most, size_t share, size_t *rest)
{
    const size_t room = most > *part ? most - *part : 0,
                 more = memory_min(memory_min(share, room), *rest);
    *part += more;
    *rest -= more;
}

/* Drawing has two fifths of the rest, as far as these stores can use it. Gaussians and pixels of a
 * picture come before tiles kept for the next. */
static void memory_share_drawing(const struct memory_needs *n, struct memory_parts *p, size_t *rest)
{
    const size_t share = *rest / 5 * 2 / p->drawers;
    size_t own = share;
    const uint64_t drawn = memory_drawn_gaussians(n);
    memory_grow(&p->gaussians, (size_t)drawn * MEMORY_GAUSSIAN, own / 2, &own);
    memory_grow(&p->pixels, (size_t)(n->view_mpx * 1e6) * MEMORY_PIXEL * MEMORY_PIXELS_A_PICTURE,
                own / 2, &own);
    memory_grow(&p->gaussians, (size_t)drawn * MEMORY_GAUSSIAN, own, &own);
    /* Pages of other stores lie beside those of the one that is drawn. */
    for (p->slots = 1; p->slots < MEMORY_SLOTS && own / 2 > p->gaussians; p->slots++) {
        p->others += p->gaussians;
        own -= p->gaussians;
    }
    if (!n->view_cache)
        memory_grow(&p->view_cache, (size_t)n->gaussians * MEMORY_GAUSSIAN, own, &own);
    *rest -= (share - own) * p->drawers;
}

static enum err_code memory_plan_with(const struct memory_needs *n, unsigned drawers,
                                      struct memory_plan *out, struct err *e)
{
    struct memory_parts p;
    memset(out, 0, sizeof *out);
    memory_least_parts(n, drawers, out, &p);
    const size_t least = memory_sum(&p);
    if (least > n->budget)
        return memory_too_little(n, e);
    size_t rest = n->budget - least;
    out->budget = n->budget;
    if (drawers)
        memory_share_drawing(n, &p, &rest);
    if (drawers)
        memory_grow(&p.video, n->video, rest / MEMORY_VIDEO_PART, &rest);
    if (!n->inflight)
        memory_grow(&p.inflight, SIZE_MAX, rest / 3, &rest);
    if (!n->cache)
        memory_grow(&p.cache, SIZE_MAX, rest, &rest);
    out->cache = p.cache;
    out->inflight = p.inflight;
    if (!drawers)
        return ERR_OK;
    out->view_cache = p.view_cache;
    out->video = p.video;
    const uint64_t drawn = memory_drawn_gaussians(n), fits = p.gaussians / MEMORY_GAUSSIAN;
    out->view_gaussians = fits < drawn ? fits : n->view_gaussians;
    out->drawn_px = p.pixels / MEMORY_PIXEL;
    out->view_mpx = fmin(n->view_mpx, (double)out->drawn_px * 1e-6);
    out->lowered = fits < drawn || out->view_mpx < n->view_mpx;
    out->slots = p.slots;
    out->drawers = drawers;
    out->drawing = drawers * memory_drawer(&p);
    return ERR_OK;
}

enum err_code memory_plan(const struct memory_needs *n, struct memory_plan *out, struct err *e)
{
    struct err none;
    for (unsigned drawers = n->draws ? n->drawers : 0; drawers > 1; drawers--)
        if (!memory_plan_with(n, drawers, out, &none) && !out->lowered)
            return ERR_OK;
    return memory_plan_with(n, n->draws, out, e);
}
