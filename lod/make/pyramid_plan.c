/* Everything that the pyramid decides from the codes alone, before it writes tiles.
 *
 * The tiles of a level at a zoom, and their counts, are found by stepping through its sorted runs:
 * one search a tile and run, for any number of rows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lod/make/pyramid_fit.h"
#include "lod/make/pyramid_plan.h"
#include "lod/store/key.h"

/* ---- tables ---- */

static int pyramid_count_compare(const void *a, const void *b)
{
    const struct pyramid_count *x = a, *y = b;
    return x->code < y->code ? -1 : x->code > y->code;
}

static enum err_code pyramid_table_add(struct pyramid_table *t, size_t *cap,
                                       struct pyramid_count cell, struct err *e)
{
    struct pyramid_count *p = mem_room(t->cell, t->n, cap, 256, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", t->n + 1);
    t->cell = p;
    t->cell[t->n++] = cell;
    return ERR_OK;
}

/* The tiles at zoom z with rows of level i. */
static enum err_code pyramid_tabulate(const struct pyramid *p, size_t i, uint8_t z,
                                      struct pyramid_table *out, struct err *e)
{
    size_t cap = 0, n = 0;
    unsigned shift = 2u * (unsigned)(KEY_ZOOM_MAX - z);
    enum err_code rc = ERR_OK;
    *out = (struct pyramid_table){0};
    for (size_t r = 0; !rc && r < p->runs[i].n; r++) {
        const struct spill_run *run = &p->runs[i].run[r];
        for (size_t from = 0, to; !rc && from < run->n; from = to) {
            uint64_t code = 0;
            rc = spill_tile(&p->spill, run, shift, from, &code, &to, e);
            if (!rc)
                rc = pyramid_table_add(out, &cap, (struct pyramid_count){code, to - from}, e);
        }
    }
    if (out->n)
        qsort(out->cell, out->n, sizeof *out->cell, pyramid_count_compare);
    for (size_t k = 0; k < out->n; k++) {
        if (n > 0 && out->cell[n - 1].code == out->cell[k].code)
            out->cell[n - 1].n += out->cell[k].n;
        else
            out->cell[n++] = out->cell[k];
    }
    out->n = n;
    return rc;
}

/* Fullest tile of level i at zoom z, and how full the tile of an average Gaussian is. */
static enum err_code pyramid_fill(const struct pyramid *p, size_t i, uint8_t z, size_t *most,
                                  double *typical, struct err *e)
{
    struct pyramid_table t;
    enum err_code rc = pyramid_tabulate(p, i, z, &t, e);
    double squares = 0.0, sum = 0.0;
    *most = 0;
    for (size_t k = 0; k < t.n; k++) {
        *most = t.cell[k].n > *most ? t.cell[k].n : *most;
        squares += (double)t.cell[k].n * (double)t.cell[k].n;
        sum += (double)t.cell[k].n;
    }
    *typical = sum > 0.0 ? squares / sum : 0.0;
    mem_free(t.cell);
    return rc;
}

/* ---- zoom ---- */

static enum err_code pyramid_wanted_zoom(const struct pyramid *p, uint8_t *out, struct err *e)
{
    double best_off = HUGE_VAL;
    size_t most;
    if (p->cfg->tile_edge_m > 0.0) {
        *out = key_zoom_for(p->locate.origin.lat_deg, p->cfg->tile_edge_m);
        return ERR_OK;
    }
    *out = 0;
    for (uint8_t z = 0; z <= KEY_ZOOM_MAX; z++) {
        double typical = 0.0;
        enum err_code rc = pyramid_fill(p, p->n_levels - 1, z, &most, &typical, e);
        if (rc)
            return rc;
        double off = fabs(log(typical / PYRAMID_PER_TILE));
        if (off > best_off) /* fuller tiles only towards the top */
            break;
        best_off = off; /* of equals the finest, which fits closest around the scene */
        *out = z;
    }
    return ERR_OK;
}

enum err_code pyramid_choose_zoom(struct pyramid *p, struct err *e)
{
    double lat = p->locate.origin.lat_deg, typical;
    uint8_t wanted;
    enum err_code rc = pyramid_wanted_zoom(p, &wanted, e);
    while (p->zoom_least < KEY_ZOOM_MAX - p->top_level &&
           key_edge_m(lat, p->zoom_least) > 2.0 * PYRAMID_REACH_M)
        p->zoom_least++;
    uint8_t least = (uint8_t)(p->zoom_least + p->top_level - 1);
    p->zoom_max = wanted < least ? least : wanted;
    while (!rc) {
        size_t most = 0;
        for (size_t i = 0; !rc && i < p->n_levels; i++) {
            size_t n;
            rc = pyramid_fill(p, i, pyramid_zoom_of(p, p->levels[i].level), &n, &typical, e);
            most = n > most ? n : most;
        }
        if (rc || most <= p->max_per_tile)
            break;
        if (p->zoom_max == KEY_ZOOM_MAX) {
            log_warn("tile",
                     "a tile of the finest zoom there is holds n=%zu Gaussians, more than max=%u",
                     most, p->max_per_tile);
            break;
        }
        p->zoom_max++;
    }
    if (!rc && p->zoom_max > wanted && p->cfg->tile_edge_m > 0.0)
        log_warn("tile",
                 "zoom=%u instead of %u, which is nearest to tile_edge_m=%g: tiles would hold more "
                 "than max=%u",
                 p->zoom_max, wanted, p->cfg->tile_edge_m, p->max_per_tile);
    return rc;
}

/* ---- nodes ---- */

static enum err_code pyramid_add_node(struct pyramid *p, uint8_t z, uint64_t code, bool content,
                                      struct err *e)
{
    struct pyramid_zoom *l = &p->zoom[z];
    struct pyramid_node *node = mem_room(l->node, l->n, &l->cap, 64, sizeof *node);
    if (!node)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", l->n + 1);
    l->node = node;
    l->node[l->n++] = (struct pyramid_node){.code = code, .content = content};
    return ERR_OK;
}

static int pyramid_node_compare(const void *a, const void *b)
{
    const struct pyramid_node *x = a, *y = b;
    if (x->code != y->code)
        return x->code < y->code ? -1 : 1;
    return x->content > y->content ? -1 : x->content < y->content;
}

/* Sort, and leave one node a code: the one with content if there is one. */
static void pyramid_sort_nodes(struct pyramid_zoom *l)
{
    size_t n = 0;
    if (l->n)
        qsort(l->node, l->n, sizeof *l->node, pyramid_node_compare);
    for (size_t i = 0; i < l->n; i++)
        if (n == 0 || l->node[n - 1].code != l->node[i].code)
            l->node[n++] = l->node[i];
    l->n = n;
}

/* NULL: there is none. */
static const struct pyramid_node *pyramid_find(const struct pyramid *p, uint8_t z, uint64_t code)
{
    const struct pyramid_zoom *l = &p->zoom[z];
    size_t lo = 0, hi = l->n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (l->node[mid].code < code)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo < l->n && l->node[lo].code == code ? &l->node[lo] : NULL;
}

static enum err_code pyramid_add_parents(struct pyramid *p, uint8_t z, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < p->zoom[z + 1].n; i++)
        rc = pyramid_add_node(p, z, p->zoom[z + 1].node[i].code >> 2, false, e);
    pyramid_sort_nodes(&p->zoom[z]);
    return rc;
}

/* ---- jobs ---- */

enum err_code pyramid_add_job(struct pyramid *p, struct pyramid_job job, struct err *e)
{
    struct pyramid_job *more = mem_room(p->job, p->n_jobs, &p->cap_jobs, 256, sizeof *more);
    if (!more)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", p->n_jobs + 1);
    p->job = more;
    p->job[p->n_jobs++] = job;
    return ERR_OK;
}

/* Rows of level i in the tiles of zoom z - 1 with content and something below. It will be replaced
 * by that, so its rows in quadrants without a tile of their own go to a tile at zoom z, and on
 * where needed. Such copies are no nodes: the tile they come from stands for them in everything
 * that is made from below. */
static enum err_code pyramid_plan_carry(struct pyramid *p, size_t i, uint8_t z, struct err *e)
{
    struct pyramid_table t;
    uint8_t home = pyramid_zoom_of(p, p->levels[i].level);
    bool deeper = false;
    enum err_code rc = pyramid_tabulate(p, i, z, &t, e);
    for (size_t k = 0; !rc && k < t.n; k++) {
        uint64_t code = t.cell[k].code, first = code & ~UINT64_C(3);
        const struct pyramid_node *node = pyramid_find(p, z, code);
        const struct pyramid_node *up = pyramid_find(p, (uint8_t)(z - 1), code >> 2);
        /* Above: the level's own tile, or a node without content on the way down from it. */
        bool covered = !up || (z - 1 > home && up->content), any = false;
        for (uint8_t a = (uint8_t)(home + 1); a + 1 < z; a++) {
            const struct pyramid_node *way = pyramid_find(p, a, code >> 2 * (z - a));
            covered = covered || !way || way->content;
        }
        for (uint64_t q = 0; q < 4; q++)
            any = any || pyramid_find(p, z, first + q);
        if (covered || !any || (node && node->content))
            continue;
        deeper = deeper || node;
        rc = pyramid_add_job(p,
                             (struct pyramid_job){.code = code,
                                                  .z = z,
                                                  .level = p->levels[i].level,
                                                  .source = (uint8_t)i,
                                                  .carried = true},
                             e);
        p->report->n_carried_tiles++;
        p->report->n_carried += t.cell[k].n;
    }
    mem_free(t.cell);
    return !rc && deeper && z < p->zoom_max ? pyramid_plan_carry(p, i, (uint8_t)(z + 1), e) : rc;
}

static enum err_code pyramid_plan_level(struct pyramid *p, size_t i, struct err *e)
{
    struct pyramid_table t;
    uint8_t level = p->levels[i].level, z = pyramid_zoom_of(p, level);
    enum err_code rc = pyramid_tabulate(p, i, z, &t, e);
    for (size_t k = 0; !rc && k < t.n; k++) {
        rc = pyramid_add_job(
            p,
            (struct pyramid_job){
                .code = t.cell[k].code, .z = z, .level = level, .source = (uint8_t)i},
            e);
        if (!rc)
            rc = pyramid_add_node(p, z, t.cell[k].code, true, e);
        p->report->n_gaussians[level] += t.cell[k].n;
    }
    mem_free(t.cell);
    if (!rc && z < p->zoom_max)
        rc = pyramid_add_parents(p, z, e);
    if (!rc && z < p->zoom_max)
        rc = pyramid_plan_carry(p, i, (uint8_t)(z + 1), e);
    return rc;
}

/* What is made above the given levels is made from the nearest tiles below: those without a tile of
 * another level over them. */
static void pyramid_plan_feeds(struct pyramid *p)
{
    for (size_t i = 0; i < p->n_jobs; i++) {
        struct pyramid_job *j = &p->job[i];
        j->feeds = !j->carried;
        for (uint8_t z = p->zoom_made; j->feeds && z < j->z; z++) {
            const struct pyramid_node *over = pyramid_find(p, z, j->code >> 2 * (j->z - z));
            j->feeds = !over || !over->content;
        }
    }
}

enum err_code pyramid_plan(struct pyramid *p, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = p->n_levels; !rc && i-- > 0;)
        rc = pyramid_plan_level(p, i, e);
    p->zoom_made = pyramid_zoom_of(p, p->levels[0].level);
    pyramid_plan_feeds(p);
    return rc;
}

bool pyramid_is_top(const uint64_t *code, size_t n, uint8_t z)
{
    size_t n_up = 1;
    unsigned up = z < PYRAMID_CLIMB_MAX ? z : PYRAMID_CLIMB_MAX;
    for (size_t i = 1; i < n; i++)
        n_up += code[i] >> 2 * up != code[i - 1] >> 2 * up;
    return n <= 1 || z == 0 || (n <= PYRAMID_LONE_ROOTS && n_up == n);
}

static bool pyramid_zoom_is_top(const struct pyramid_zoom *l, uint8_t z)
{
    uint64_t code[PYRAMID_LONE_ROOTS];
    if (l->n > PYRAMID_LONE_ROOTS)
        return z == 0;
    for (size_t i = 0; i < l->n; i++)
        code[i] = l->node[i].code;
    return pyramid_is_top(code, l->n, z);
}

bool pyramid_plan_up(struct pyramid *p, uint8_t z, enum err_code *rc, struct err *e)
{
    int level = (int)p->top_level - (p->zoom_max - z) - 1;
    if (z == 0 || (level < 1 && pyramid_zoom_is_top(&p->zoom[z], z)))
        return false;
    if (p->zoom[z - 1].n == 0)
        *rc = pyramid_add_parents(p, (uint8_t)(z - 1), e);
    for (size_t i = 0; i < p->zoom[z - 1].n; i++)
        p->zoom[z - 1].node[i].content = true;
    return true;
}
