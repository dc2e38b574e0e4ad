/* Levels -> tiles. It needs memory for one tile a thread, whatever the size of the city.
 *
 * First all cores read every part of every level once, in any order. Each row gets the Morton code
 * of its tile at the finest zoom. The rows of a part are sorted by it and written to disk as one
 * run (spill.c). The codes determine the tiles (pyramid_plan.c). Then each tile is put together
 * from its slices of the runs, sorted and encoded. Above the coarsest given level it is also
 * thinned to a quarter, which becomes part of the tile above. Each child is thinned alone, so the
 * tiles of one zoom wait only for the zoom below, and an update can make a tile again from its
 * changed children (lod/make/update_build.c). Threads give finished tiles to the store in order, so
 * the file does not depend on their number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/container/ckpt.h"
#include "core/math/simd.h"
#include "core/pool.h"
#include "lod/make/pyramid.h"
#include "lod/make/pyramid_fit.h"
#include "lod/make/pyramid_plan.h"
#include "lod/make/simplify.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"
#include "lod/store/tilewriter.h"

enum {
    PYRAMID_PART_ROWS = 131072, /* of a level in memory */
    PYRAMID_SOON = 8,           /* rows */
};

/* ---- rows to runs ---- */

struct pyramid_part {
    size_t level, part;
};

struct pyramid_reading {
    struct pyramid *p;
    struct pyramid_part *part;
    pthread_mutex_t lock; /* guards what is below and the report */
    size_t n_seen[PYRAMID_LEVEL_MAX];
    size_t n_parts[2]; /* with rows; trained without and with anti-aliasing */
    uint64_t n_done;
    struct progress progress;
};

static size_t pyramid_n_parts(const struct pyramid_level *l)
{
    return l->g ? (l->g->n + PYRAMID_PART_ROWS - 1) / PYRAMID_PART_ROWS : l->n_parts;
}

/* Codes of the usable rows; *n of them. */
static enum err_code pyramid_code_rows(const struct pyramid *p, const struct gauss *g,
                                       struct sort_item *items, size_t *n, struct err *e)
{
    bool all_good = gauss_count_unusable(g, NULL) == 0;
    *n = 0;
    for (size_t i = 0; i < g->n; i++) {
        struct gauss one = pyramid_view(g, i, 1);
        struct key k;
        double enu[3];
        if (!all_good && gauss_count_unusable(&one, NULL))
            continue;
        for (size_t a = 0; a < 3; a++)
            enu[a] = (double)g->mean_m[3 * i + a] + g->origin_enu_m[a];
        enum err_code rc = locate_key(&p->locate, enu, &k, e);
        if (rc)
            return rc;
        items[(*n)++] = (struct sort_item){locate_code(k), (uint32_t)i};
    }
    return ERR_OK;
}

static enum err_code pyramid_spill_part(struct pyramid *p, const struct gauss *g,
                                        struct spill_run *run, struct err *e)
{
    size_t n = 0;
    struct sort_item *items = mem_array(g->n, 2 * sizeof *items);
    if (!items)
        return err_set(e, ERR_MEM, "out of memory for the tile codes of %zu Gaussians", g->n);
    enum err_code rc = pyramid_code_rows(p, g, items, &n, e);
    if (!rc) {
        sort_items(items, items + g->n, n);
        rc = spill_index(run, items, n, e);
    }
    if (!rc)
        rc = spill_add(&p->spill, g, items, n, run, e);
    mem_free(items);
    return rc;
}

static enum err_code pyramid_read_part(void *user, size_t i, struct err *e)
{
    struct pyramid_reading *r = user;
    struct pyramid *p = r->p;
    size_t at = r->part[i].level, part = r->part[i].part;
    const struct pyramid_level *l = &p->levels[at];
    struct gauss own = {0}, g;
    enum err_code rc = ERR_OK;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    if (l->g) {
        size_t from = part * PYRAMID_PART_ROWS, left = l->g->n - from;
        g = pyramid_view(l->g, from, left < PYRAMID_PART_ROWS ? left : PYRAMID_PART_ROWS);
    } else {
        rc = l->load(l->user, part, &own, e);
        if (rc)
            err_add(e, "level %u", l->level);
        g = own;
    }
    if (!rc)
        rc = pyramid_spill_part(p, &g, &p->runs[at].run[part], e);
    if (!rc) {
        pthread_mutex_lock(&r->lock);
        r->n_seen[at] += g.n;
        p->n_rows[at] += p->runs[at].run[part].n;
        p->report->n_bad += g.n - p->runs[at].run[part].n;
        if (p->meta.sh_degree < g.sh_degree)
            p->meta.sh_degree = g.sh_degree;
        if (p->meta.embed_len < g.embed_len)
            p->meta.embed_len = g.embed_len;
        p->meta.antialiased = p->meta.antialiased || g.antialiased;
        r->n_parts[g.antialiased] += g.n > 0;
        progress_step(&r->progress, ++r->n_done, NULL);
        pthread_mutex_unlock(&r->lock);
    }
    gauss_free(&own);
    return rc;
}

static enum err_code pyramid_check_rows(const struct pyramid *p, const struct pyramid_reading *r,
                                        struct err *e)
{
    const size_t *n_seen = r->n_seen;
    if (r->n_parts[0] && r->n_parts[1])
        return err_set(e, ERR_DATA,
                       "some of the Gaussians were trained with anti-aliasing and some "
                       "without; train all cells with the same options");
    for (size_t i = 0; i < p->n_levels; i++) {
        if (n_seen[i] == 0 || n_seen[i] >= UINT32_MAX)
            return err_set(e, ERR_DATA, "level %u has %zu Gaussians, 1 to 2^32 - 2 can be tiled",
                           p->levels[i].level, n_seen[i]);
        if (p->n_rows[i] == 0)
            return err_set(e, ERR_DATA, "level %u: none of its %zu Gaussians is finite",
                           p->levels[i].level, n_seen[i]);
    }
    return ERR_OK;
}

static enum err_code pyramid_read(struct pyramid *p, struct err *e)
{
    struct pyramid_reading r = {.p = p};
    size_t n = 0, at = 0;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < p->n_levels; i++)
        n += pyramid_n_parts(&p->levels[i]);
    r.part = mem_array(n, sizeof *r.part);
    pthread_mutex_init(&r.lock, NULL);
    for (size_t i = 0; !rc && i < p->n_levels; i++) {
        size_t parts = pyramid_n_parts(&p->levels[i]);
        p->runs[i].run = mem_array(parts, sizeof *p->runs[i].run);
        if (!r.part || !p->runs[i].run)
            rc = err_set(e, ERR_MEM, "out of memory for %zu parts", parts);
        for (size_t k = 0; !rc && k < parts; k++)
            r.part[at++] = (struct pyramid_part){i, k};
        p->runs[i].n = rc ? 0 : parts;
    }
    progress_start(&r.progress, "tile: reading", n);
    if (!rc)
        rc = pool_for(n, 0, pyramid_read_part, &r, e);
    progress_end(&r.progress, NULL);
    if (!rc)
        rc = pyramid_check_rows(p, &r, e);
    pthread_mutex_destroy(&r.lock);
    mem_free(r.part);
    return rc;
}

/* ---- a tile from its slices ---- */

struct pyramid_slices {
    uint8_t *rows;                /* all slices, one after the other */
    const uint8_t **row;          /* [n] */
    const struct spill_run **run; /* [n] that the row is of */
    size_t n;
};

static void pyramid_slices_free(struct pyramid_slices *s)
{
    mem_free(s->rows);
    mem_free(s->row);
    mem_free(s->run);
}

static enum err_code pyramid_gather(struct pyramid *p, const struct pyramid_runs *runs,
                                    uint64_t code, uint8_t z, struct pyramid_slices *out,
                                    struct err *e)
{
    uint64_t first, last;
    size_t from, to, bytes = 0;
    enum err_code rc = ERR_OK;
    pyramid_range(code, z, &first, &last);
    for (size_t r = 0; !rc && r < runs->n; r++) {
        rc = spill_slice(&p->spill, &runs->run[r], first, last, &from, &to, e);
        out->n += to - from;
        bytes += (to - from) * spill_row_bytes(&p->spill, &runs->run[r]);
    }
    if (rc)
        return rc;
    out->rows = mem_uninit(bytes, sizeof *out->rows);
    out->row = mem_uninit(out->n, sizeof *out->row);
    out->run = mem_uninit(out->n, sizeof *out->run);
    if (!out->rows || !out->row || !out->run)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", out->n);
    uint8_t *at = out->rows;
    size_t n = 0;
    for (size_t r = 0; !rc && r < runs->n; r++) {
        const struct spill_run *run = &runs->run[r];
        size_t width = spill_row_bytes(&p->spill, run);
        rc = spill_slice(&p->spill, run, first, last, &from, &to, e);
        if (rc || from == to)
            continue;
        rc = spill_read(&p->spill, run, from, to, at, e);
        for (size_t i = from; i < to; i++, at += width) {
            out->row[n] = at;
            out->run[n++] = run;
        }
    }
    return rc;
}

static inline float pyramid_mean(const uint8_t *row, size_t k)
{
    float m;
    memcpy(&m, row + k * sizeof m, sizeof m);
    return m;
}

static double pyramid_far_m(const struct pyramid_slices *s, size_t i, const double center[3])
{
    double far = 0.0;
    for (size_t k = 0; k < 3; k++)
        far = fmax(far, fabs((double)pyramid_mean(s->row[i], k) +
                             (s->run[i]->origin_enu_m[k] - center[k])));
    return far;
}

/* Each axis has a middle of its own, and rows far apart need not be near all three: then the
 * nearest row is the centre. */
static void pyramid_center_near(const struct pyramid_slices *s, double reach_m, double center[3])
{
    size_t best = 0;
    double best_m = HUGE_VAL;
    for (size_t i = 0; i < s->n && best_m >= reach_m; i++) {
        const double far = pyramid_far_m(s, i, center);
        if (far < best_m)
            best_m = far, best = i;
    }
    for (size_t k = 0; best_m >= reach_m && k < 3; k++)
        center[k] =
            round((double)pyramid_mean(s->row[best], k) + s->run[best]->origin_enu_m[k]) + 0.0;
}

static enum err_code pyramid_center(const struct pyramid *p, const struct pyramid_slices *s,
                                    double reach_m, double center[3], struct err *e)
{
    double *at = mem_uninit(s->n, sizeof *at);
    if (!at)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", s->n);
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = 0; i < s->n; i++)
            at[i] = (double)pyramid_mean(s->row[i], k) + s->run[i]->origin_enu_m[k];
        center[k] = pyramid_center_axis(p->cfg->lossless, reach_m, at, s->n);
    }
    mem_free(at);
    pyramid_center_near(s, PYRAMID_ALLOWANCE * reach_m, center);
    return ERR_OK;
}

/* Rows within reach of the centre, about it, in Hilbert order; *n_far are not. At least one
 * remains, since the centre is near one. */
static enum err_code pyramid_arrange(const struct pyramid *p, struct pyramid_slices *s,
                                     double reach_m, struct gauss *out, size_t *n_far,
                                     struct err *e)
{
    double center[3];
    float *mean = mem_uninit(s->n, 3 * sizeof *mean);
    uint32_t *order = mem_uninit(s->n, sizeof *order);
    size_t n = 0;
    enum err_code rc = mean && order ? pyramid_center(p, s, reach_m, center, e)
                                     : err_set(e, ERR_MEM, "out of memory for a tile");
    if (rc)
        goto out;
    for (size_t i = 0; i < s->n; i++) {
        double far = 0.0, at[3];
        for (size_t k = 0; k < 3; k++) {
            at[k] = (double)pyramid_mean(s->row[i], k) + (s->run[i]->origin_enu_m[k] - center[k]);
            far = fmax(far, fabs(at[k]));
        }
        if (!(far < PYRAMID_ALLOWANCE * reach_m))
            continue;
        for (size_t k = 0; k < 3; k++)
            mean[3 * n + k] = (float)at[k];
        s->row[n] = s->row[i];
        s->run[n++] = s->run[i];
    }
    *n_far = s->n - n;
    const struct gauss means = {.n = n, .mean_m = mean};
    rc = gauss_hilbert_order(&means, order, e);
    if (!rc)
        rc = gauss_uninit(out, n, p->meta.sh_degree, p->meta.embed_len, e);
    if (rc)
        goto out;
    memcpy(out->origin_enu_m, center, sizeof center);
    out->antialiased = p->meta.antialiased;
    out->n = n;
    for (size_t i = 0; i < n; i++) {
        if (i + PYRAMID_SOON < n) {
            SIMD_SOON(s->row[order[i + PYRAMID_SOON]]);
            SIMD_SOON(s->row[order[i + PYRAMID_SOON]] + 64);
        }
        memcpy(out->mean_m + 3 * i, mean + 3 * order[i], 3 * sizeof *mean);
        spill_unpack(&p->spill, s->run[order[i]], s->row[order[i]], out, i);
    }
    *n_far += pyramid_fit(out, reach_m);
out:
    mem_free(mean);
    mem_free(order);
    return rc;
}

/* ---- writing tiles ---- */

struct pyramid_writing {
    struct pyramid *p;
    const struct pyramid_job *job;
    const struct pyramid_runs *below; /* what made tiles are made of, sorted by code_first */
    struct spill_run *fed;            /* [n] by job: what goes into the tile above */
    struct tilewriter *writer;
    pthread_mutex_t lock; /* guards the report */
};

/* The runs under a tile that is made: a slice of those below. */
static struct pyramid_runs pyramid_below(const struct pyramid_runs *all, uint64_t code, uint8_t z)
{
    uint64_t first, last;
    size_t lo = 0, hi = all->n, end;
    pyramid_range(code, z, &first, &last);
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (all->run[mid].code_first < first)
            lo = mid + 1;
        else
            hi = mid;
    }
    for (end = lo; end < all->n && all->run[end].code_first < last; end++)
        continue;
    return (struct pyramid_runs){.run = all->run + lo, .n = end - lo};
}

static enum err_code pyramid_feed(struct pyramid_writing *w, size_t i, const struct gauss *g,
                                  struct err *e)
{
    const struct pyramid_job *j = &w->job[i];
    struct gauss less = {0};
    uint64_t last;
    enum err_code rc = pyramid_thin(&w->p->locate, g, locate_decode(j->code, j->z), &less, e);
    pyramid_range(j->code, j->z, &w->fed[i].code_first, &last);
    if (!rc)
        rc = spill_add(&w->p->spill, &less, NULL, less.n, &w->fed[i], e);
    gauss_free(&less);
    return rc;
}

static enum err_code pyramid_fill_tile(struct pyramid_writing *w, const struct pyramid_job *j,
                                       struct gauss *out, struct err *e)
{
    struct pyramid_slices s = {0};
    struct pyramid_runs runs =
        j->made ? pyramid_below(w->below, j->code, j->z) : w->p->runs[j->source];
    size_t n_far = 0;
    enum err_code rc = pyramid_gather(w->p, &runs, j->code, j->z, &s, e);
    if (!rc)
        rc = pyramid_arrange(w->p, &s, pyramid_reach_m(w->p->locate.origin.lat_deg, j->z), out,
                             &n_far, e);
    pyramid_slices_free(&s);
    if (!rc && j->made && out->n > w->p->max_per_tile) {
        struct gauss less;
        rc = simplify_gauss(out, w->p->max_per_tile, &less, e);
        gauss_free(out);
        if (!rc)
            *out = less;
    }
    pthread_mutex_lock(&w->lock);
    struct pyramid_report *r = w->p->report;
    if (!rc && !j->made && !j->carried)
        r->n_far += n_far;
    if (!rc && j->made)
        r->n_gaussians[j->level] += out->n;
    if (!rc && r->max_in_tile < out->n)
        r->max_in_tile = out->n;
    r->n_tiles += !rc;
    pthread_mutex_unlock(&w->lock);
    return rc;
}

static enum err_code pyramid_write_tile(void *user, size_t i, struct err *e)
{
    struct pyramid_writing *w = user;
    const struct pyramid_job *j = &w->job[i];
    struct gauss g = {0};
    enum err_code rc =
        signals_stopping() ? err_set(e, ERR_CANCEL, "stopped") : pyramid_fill_tile(w, j, &g, e);
    if (!rc) {
        struct store_entry t = {.tile = {.key = locate_decode(j->code, j->z), .level = j->level}};
        rc = tilewriter_put(w->writer, i, &t, &g, e);
    }
    if (!rc && w->fed && j->feeds)
        rc = pyramid_feed(w, i, &g, e);
    if (rc)
        tilewriter_fail(w->writer);
    gauss_free(&g);
    return rc;
}

static int pyramid_run_compare(const void *a, const void *b)
{
    const struct spill_run *x = a, *y = b;
    return x->code_first < y->code_first ? -1 : x->code_first > y->code_first;
}

/* Write tiles; with `fed`, leave there what the tiles above are made of, sorted. */
static enum err_code pyramid_write_jobs(struct pyramid *p, struct store *store,
                                        const struct pyramid_job *job, size_t n,
                                        const struct pyramid_runs *below, struct pyramid_runs *fed,
                                        struct err *e)
{
    struct pyramid_writing w = {.p = p, .job = job, .below = below};
    enum err_code rc = tilewriter_open(store, n, &w.writer, e);
    if (fed)
        *fed = (struct pyramid_runs){0};
    if (!rc && fed && !(w.fed = mem_array(n, sizeof *w.fed)))
        rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    pthread_mutex_init(&w.lock, NULL);
    if (!rc)
        rc = pool_for(n, 0, pyramid_write_tile, &w, e);
    pthread_mutex_destroy(&w.lock);
    tilewriter_close(&w.writer);
    if (rc) {
        mem_free(w.fed);
        return rc;
    }
    for (size_t i = 0; fed && i < n; i++)
        if (w.fed[i].n > 0)
            w.fed[fed->n++] = w.fed[i];
    if (fed) {
        fed->run = w.fed;
        qsort(fed->run, fed->n, sizeof *fed->run, pyramid_run_compare);
    }
    return rc;
}

/* The tiles of zoom z, one generation above those that were written last. */
static enum err_code pyramid_make_jobs(struct pyramid *p, uint8_t z, struct err *e)
{
    int level = (int)p->top_level - (p->zoom_max - z);
    enum err_code rc = ERR_OK;
    p->n_jobs = 0;
    for (size_t i = 0; !rc && i < p->zoom[z].n; i++)
        rc = pyramid_add_job(p,
                             (struct pyramid_job){.code = p->zoom[z].node[i].code,
                                                  .z = z,
                                                  .level = (uint8_t)(level > 0 ? level : 0),
                                                  .made = true,
                                                  .feeds = true},
                             e);
    return rc;
}

static enum err_code pyramid_write_tiles(struct pyramid *p, struct store *store, struct err *e)
{
    struct pyramid_runs below = {0}, fed = {0};
    uint8_t z = p->zoom_made;
    enum err_code rc = ERR_OK;
    bool up = pyramid_plan_up(p, z, &rc, e);
    if (!rc)
        rc = pyramid_write_jobs(p, store, p->job, p->n_jobs, NULL, up ? &fed : NULL, e);
    while (!rc && up) {
        mem_free(below.run);
        below = fed;
        fed = (struct pyramid_runs){0};
        rc = pyramid_make_jobs(p, --z, e);
        up = !rc && pyramid_plan_up(p, z, &rc, e);
        if (!rc)
            rc = pyramid_write_jobs(p, store, p->job, p->n_jobs, &below, up ? &fed : NULL, e);
    }
    mem_free(below.run);
    mem_free(fed.run);
    p->report->zoom_min = z;
    return rc;
}

/* ---- all of it ---- */

static enum err_code pyramid_check(const struct pyramid_level *levels, size_t n, struct err *e)
{
    if (n == 0 || n > PYRAMID_LEVEL_MAX)
        return err_set(e, ERR_ARG, "pyramid: %zu levels, 1 to %d are possible", n,
                       PYRAMID_LEVEL_MAX);
    for (size_t i = 0; i < n; i++) {
        if (levels[i].level < 1 || levels[i].level > PYRAMID_LEVEL_MAX ||
            (i > 0 && levels[i].level != levels[i - 1].level + 1))
            return err_set(e, ERR_ARG,
                           "pyramid: levels must be consecutive, coarsest first, within 1 to %d",
                           PYRAMID_LEVEL_MAX);
        if (!levels[i].g && !levels[i].load)
            return err_set(e, ERR_ARG, "pyramid: level %u has no Gaussians", levels[i].level);
    }
    return ERR_OK;
}

static enum err_code pyramid_write(struct pyramid *p, const struct store_blob *blobs,
                                   size_t n_blobs, const char *out_path, struct err *e)
{
    struct store *store = NULL;
    enum err_code rc = store_create(out_path, &p->meta, &store, e);
    if (!rc)
        rc = pyramid_write_tiles(p, store, e);
    for (size_t i = 0; !rc && i < n_blobs; i++)
        rc = store_put_blob(store, blobs[i].name, blobs[i].data, blobs[i].size_bytes, e);
    if (!rc)
        rc = store_commit(&store, e);
    store_close(&store);
    if (!rc && !(rc = store_open(out_path, &store, e))) { /* what was written can be read */
        memcpy(p->report->revision, store_info(store)->revision, sizeof p->report->revision);
        store_close(&store);
    }
    return rc;
}

static void pyramid_tell(const struct pyramid_report *r)
{
    if (r->n_bad)
        log_warn("tile", "left out n=%zu Gaussians with values that are not finite", r->n_bad);
    if (r->n_far)
        log_warn("tile",
                 "left out n=%zu Gaussians farther than max_m=%g from the centre of their tile",
                 r->n_far, PYRAMID_ALLOWANCE * PYRAMID_REACH_M);
    if (r->n_carried)
        log_info("tile", "carried n=%zu Gaussians into tiles=%zu where a finer level has none",
                 r->n_carried, r->n_carried_tiles);
}

enum err_code pyramid_build(const struct geo_origin *origin, const struct pyramid_level *levels,
                            size_t n_levels, const struct pyramid_config *cfg,
                            const struct store_blob *blobs, size_t n_blobs, const char *out_path,
                            struct pyramid_report *report, struct err *e)
{
    struct pyramid_report none;
    double start = clock_s();
    struct pyramid p = {
        .levels = levels, .n_levels = n_levels, .cfg = cfg, .report = report ? report : &none};
    *p.report = (struct pyramid_report){0};
    p.max_per_tile = cfg->max_per_tile ? cfg->max_per_tile : PYRAMID_PER_TILE_MAX;
    enum err_code rc = pyramid_check(levels, n_levels, e);
    if (!rc)
        rc = locate_open(origin, &p.locate, e);
    if (!rc)
        rc = spill_open(out_path, cfg->lossless, &p.spill, e);
    p.spill.locate = &p.locate;
    if (!rc)
        rc = pyramid_read(&p, e);
    p.report->read_s = clock_s() - start;
    if (!rc) {
        p.top_level = levels[n_levels - 1].level;
        rc = pyramid_choose_zoom(&p, e);
    }
    if (!rc)
        rc = pyramid_plan(&p, e);
    p.report->plan_s = clock_s() - start - p.report->read_s;
    if (!rc) {
        p.meta.origin = *origin;
        p.meta.lossless = cfg->lossless;
        memcpy(p.meta.name, cfg->name, sizeof p.meta.name);
        memcpy(p.meta.attribution, cfg->attribution, sizeof p.meta.attribution);
        memcpy(p.meta.heights, cfg->heights, sizeof p.meta.heights);
        for (size_t i = 0; i < n_levels; i++)
            p.meta.pixel_m[levels[i].level - 1] = levels[i].pixel_m;
        rc = pyramid_write(&p, blobs, n_blobs, out_path, e);
    }
    if (!rc)
        pyramid_tell(p.report);
    p.report->zoom_max = p.zoom_max;
    p.report->seconds = clock_s() - start;
    spill_close(&p.spill);
    for (size_t i = 0; i < PYRAMID_LEVEL_MAX; i++) {
        for (size_t r = 0; r < p.runs[i].n; r++)
            spill_run_free(&p.runs[i].run[r]);
        mem_free(p.runs[i].run);
    }
    for (size_t z = 0; z <= KEY_ZOOM_MAX; z++)
        mem_free(p.zoom[z].node);
    mem_free(p.job);
    return rc;
}
