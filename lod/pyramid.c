/* Levels -> tiles. Each row of a level gets the Morton code of its tile at the finest zoom there
 * is; sorted by it, the tiles of every zoom are runs of rows and their quadrants are runs within
 * them. The codes of all levels (16 bytes a row) come first, because the zoom depends on how full
 * the fullest tile of any level would be. Then the levels are written, finest first, with one level
 * and one tile in memory, and what is coarser is made from the tiles below, which are read back
 * from the unfinished store.
 *
 * Which tile owns a row is decided by geo_from_enu and key_at for every single one: a cheaper local
 * approximation would have to be right to the last bit at the edges.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/pool.h"
#include "lod/lod.h"

enum {
    PYRAMID_PER_TILE = 50000, /* wanted on average: a megabyte as .drc, a second of a slow line */
    PYRAMID_PER_TILE_MAX = 200000,
    PYRAMID_LEVEL_MAX = 7,
    PYRAMID_CHUNK = 16384,
    PYRAMID_KEEP = 64,      /* tiles this small are not thinned */
    PYRAMID_LONE_ROOTS = 4, /* so few tiles may stand side by side at the top ... */
    PYRAMID_CLIMB_MAX = 3,  /* ... if one tile over them all is more zooms up than this */
};

/* Fixed-point formats (SPZ, .drc) hold means within 2048 m of the tile's centre: no tile is wider
 * than twice this, and rows farther up or down are left out. */
#define PYRAMID_REACH_M 2000.0

struct pyramid_row {
    uint64_t code; /* Morton code of the tile at KEY_ZOOM_MAX */
    uint32_t row;
};

struct pyramid_rows { /* one level, sorted by code */
    struct pyramid_row *row;
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

struct pyramid {
    const struct geo_origin *origin;
    const struct pyramid_level *levels;
    size_t n_levels;
    const struct pyramid_config *cfg;
    struct pyramid_report *report;
    uint32_t max_per_tile;
    struct pyramid_rows rows[PYRAMID_LEVEL_MAX];
    struct pyramid_zoom zoom[KEY_ZOOM_MAX + 1];
    uint8_t top_level, zoom_max, zoom_least; /* least: tiles still fit the reach */
    struct store_meta meta;
    struct store *store;
    struct progress progress;
    uint64_t done;
};

static uint64_t pyramid_code(struct key k)
{
    uint64_t code = 0;
    for (int b = 0; b < KEY_ZOOM_MAX; b++)
        code |= (uint64_t)(k.x >> b & 1) << (2 * b) | (uint64_t)(k.y >> b & 1) << (2 * b + 1);
    return code;
}

static struct key pyramid_key(uint64_t code, uint8_t z)
{
    struct key k = {.z = z};
    for (int b = 0; b < KEY_ZOOM_MAX; b++) {
        k.x |= (uint32_t)(code >> (2 * b) & 1) << b;
        k.y |= (uint32_t)(code >> (2 * b + 1) & 1) << b;
    }
    return k;
}

static uint8_t pyramid_zoom_of(const struct pyramid *p, uint8_t level)
{
    return (uint8_t)(p->zoom_max - (p->top_level - level));
}

/* ---- levels in and out of memory ---- */

static enum err_code pyramid_open_level(const struct pyramid_level *l, struct gauss *own,
                                        const struct gauss **g, struct err *e)
{
    *own = (struct gauss){0};
    *g = l->g;
    if (l->g)
        return ERR_OK;
    enum err_code rc = l->load(l->user, own, e);
    *g = own;
    return rc ? err_add(e, "level %u", l->level) : ERR_OK;
}

/* ---- codes ---- */

struct pyramid_coding {
    const struct gauss *g;
    const struct geo_origin *origin;
    struct pyramid_row *row;
};

static enum err_code pyramid_code_chunk(void *user, size_t chunk, struct err *e)
{
    struct pyramid_coding *c = user;
    size_t from = chunk * PYRAMID_CHUNK, to = from + PYRAMID_CHUNK;
    for (size_t i = from; i < to && i < c->g->n; i++) {
        double enu[3], lon, lat, h;
        for (size_t k = 0; k < 3; k++)
            enu[k] = (double)c->g->mean_m[3 * i + k] + c->g->origin_enu_m[k];
        c->row[i] = (struct pyramid_row){.code = UINT64_MAX, .row = (uint32_t)i};
        if (!isfinite(enu[0]) || !isfinite(enu[1]) || !isfinite(enu[2]))
            continue; /* counted as bad by the caller */
        enum err_code rc = geo_from_enu(c->origin, enu, &lon, &lat, &h, e);
        if (rc)
            return rc;
        c->row[i].code = pyramid_code(key_at(lon, lat, KEY_ZOOM_MAX));
    }
    return ERR_OK;
}

static int pyramid_row_compare(const void *a, const void *b)
{
    const struct pyramid_row *x = a, *y = b;
    if (x->code != y->code)
        return x->code < y->code ? -1 : 1;
    return x->row < y->row ? -1 : x->row > y->row;
}

/* Bad rows get the last code there is, so that they sort to the end and fall off. */
static void pyramid_drop_bad(struct pyramid *p, const struct gauss *g, struct pyramid_rows *r)
{
    size_t bad = gauss_count_bad(g, NULL);
    if (!bad)
        return;
    for (size_t i = 0; i < g->n; i++) {
        struct gauss one = *g;
        one.n = 1;
        one.mean_m += 3 * i;
        one.scale_log += 3 * i;
        one.quat_wxyz += 4 * i;
        one.opacity_logit += i;
        one.sh += 3 * gauss_sh_count(g->sh_degree) * i;
        if (g->embed)
            one.embed += g->embed_len * i;
        if (gauss_count_bad(&one, NULL))
            r->row[i].code = UINT64_MAX;
    }
    r->n -= bad;
    p->report->n_bad += bad;
}

static enum err_code pyramid_code_level(struct pyramid *p, size_t i, struct err *e)
{
    struct gauss own;
    const struct gauss *g;
    struct pyramid_rows *r = &p->rows[i];
    enum err_code rc = pyramid_open_level(&p->levels[i], &own, &g, e);
    if (!rc && (g->n == 0 || g->n >= UINT32_MAX))
        rc = err_set(e, ERR_DATA, "level %u has %zu Gaussians, 1 to 2^32 - 2 can be tiled",
                     p->levels[i].level, g->n);
    if (!rc && !(r->row = mem_array(g->n, sizeof *r->row)))
        rc = err_set(e, ERR_MEM, "out of memory for the tile codes of %zu Gaussians", g->n);
    if (!rc) {
        struct pyramid_coding c = {.g = g, .origin = p->origin, .row = r->row};
        r->n = g->n;
        rc = pool_for((g->n + PYRAMID_CHUNK - 1) / PYRAMID_CHUNK, 0, pyramid_code_chunk, &c, e);
    }
    if (!rc) {
        pyramid_drop_bad(p, g, r);
        qsort(r->row, g->n, sizeof *r->row, pyramid_row_compare);
        if (p->meta.sh_degree < g->sh_degree)
            p->meta.sh_degree = g->sh_degree;
        if (p->meta.embed_len < g->embed_len)
            p->meta.embed_len = g->embed_len;
        p->meta.antialiased = p->meta.antialiased || g->antialiased;
        if (r->n == 0)
            rc = err_set(e, ERR_DATA, "level %u: none of its %zu Gaussians is finite",
                         p->levels[i].level, g->n);
    }
    gauss_free(&own);
    return rc;
}

/* ---- zoom ---- */

/* End of the run of rows that share the tile of row `from` at zoom z. */
static size_t pyramid_run(const struct pyramid_rows *r, size_t from, uint8_t z)
{
    unsigned shift = 2u * (unsigned)(KEY_ZOOM_MAX - z);
    uint64_t code = r->row[from].code >> shift;
    size_t lo = from + 1, hi = r->n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (r->row[mid].code >> shift == code)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

/* Fullest tile at zoom z, and how full the tile of an average Gaussian is. */
static size_t pyramid_fill(const struct pyramid_rows *r, uint8_t z, double *typical)
{
    size_t most = 0;
    double squares = 0.0;
    for (size_t i = 0; i < r->n;) {
        size_t end = pyramid_run(r, i, z), n = end - i;
        most = n > most ? n : most;
        squares += (double)n * (double)n;
        i = end;
    }
    if (typical)
        *typical = squares / (double)r->n;
    return most;
}

static uint8_t pyramid_wanted_zoom(const struct pyramid *p)
{
    if (p->cfg->tile_edge_m > 0.0)
        return key_zoom_for(p->origin->lat_deg, p->cfg->tile_edge_m);
    uint8_t best = 0;
    double best_off = HUGE_VAL;
    for (uint8_t z = 0; z <= KEY_ZOOM_MAX; z++) {
        double typical = 0.0;
        pyramid_fill(&p->rows[p->n_levels - 1], z, &typical);
        double off = fabs(log(typical / PYRAMID_PER_TILE));
        if (off <= best_off) { /* of equals the finest, which fits closest around the scene */
            best_off = off;
            best = z;
        }
    }
    return best;
}

static void pyramid_choose_zoom(struct pyramid *p)
{
    while (p->zoom_least < KEY_ZOOM_MAX - p->top_level &&
           key_edge_m(p->origin->lat_deg, p->zoom_least) > 2.0 * PYRAMID_REACH_M)
        p->zoom_least++;
    uint8_t wanted = pyramid_wanted_zoom(p), least = (uint8_t)(p->zoom_least + p->top_level - 1);
    p->zoom_max = wanted < least ? least : wanted;
    for (;;) {
        size_t most = 0;
        for (size_t i = 0; i < p->n_levels; i++) {
            size_t n = pyramid_fill(&p->rows[i], pyramid_zoom_of(p, p->levels[i].level), NULL);
            most = n > most ? n : most;
        }
        if (most <= p->max_per_tile)
            break;
        if (p->zoom_max == KEY_ZOOM_MAX) {
            log_warn("tile",
                     "a tile of the finest zoom there is holds n=%zu Gaussians, more than max=%u",
                     most, p->max_per_tile);
            break;
        }
        p->zoom_max++;
    }
    if (p->zoom_max > wanted && p->cfg->tile_edge_m > 0.0)
        log_warn("tile",
                 "zoom=%u instead of %u, which is nearest to tile_edge_m=%g: tiles would hold more "
                 "than max=%u",
                 p->zoom_max, wanted, p->cfg->tile_edge_m, p->max_per_tile);
}

/* ---- tiles ---- */

static int pyramid_double_compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Centre of the rows along one axis: whole metres, the middle, but the median where a stray
 * Gaussian would push all others out of reach. A lossless store needs m - c to be exact in float32:
 * true for c = 0, and by Sterbenz's lemma for c / 2 <= m <= 2 c. */
static double pyramid_center_axis(const struct pyramid *p, double *at, size_t n)
{
    qsort(at, n, sizeof *at, pyramid_double_compare);
    double lo = at[0], hi = at[n - 1];
    double c = round(hi - lo < 2.0 * PYRAMID_REACH_M ? 0.5 * (lo + hi) : at[n / 2]) + 0.0;
    if (!p->cfg->lossless)
        return c;
    bool exact = (lo > 0.0 && c <= 2.0 * lo && hi <= 2.0 * c) ||
                 (hi < 0.0 && c >= 2.0 * hi && lo >= 2.0 * c);
    return exact || fmax(-lo, hi) > PYRAMID_REACH_M ? c : 0.0;
}

static enum err_code pyramid_center(const struct pyramid *p, const struct gauss *g,
                                    double center[3], struct err *e)
{
    double *at = mem_array(g->n, sizeof *at);
    if (!at)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g->n);
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = 0; i < g->n; i++)
            at[i] = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k];
        center[k] = pyramid_center_axis(p, at, g->n);
    }
    mem_free(at);
    return ERR_OK;
}

/* Drop rows out of reach from the order; at least one remains, since the centre is near one. */
static size_t pyramid_drop_far(struct pyramid *p, const struct gauss *g, const double center[3],
                               uint32_t *order)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        double far = 0.0;
        for (size_t k = 0; k < 3; k++)
            far = fmax(far,
                       fabs((double)g->mean_m[3 * order[i] + k] + g->origin_enu_m[k] - center[k]));
        if (far < PYRAMID_REACH_M + 40.0)
            order[n++] = order[i];
    }
    p->report->n_far += g->n - n;
    return n;
}

/* Centre, order along the Morton curve, write. */
static enum err_code pyramid_put(struct pyramid *p, struct key k, uint8_t level,
                                 const struct gauss *g, struct err *e)
{
    struct gauss sorted = {0};
    struct store_tile t = {.key = k, .level = level};
    double center[3];
    uint32_t *order = mem_array(g->n, sizeof *order);
    enum err_code rc =
        order ? pyramid_center(p, g, center, e) : err_set(e, ERR_MEM, "out of memory for a tile");
    if (!rc)
        rc = gauss_alloc(&sorted, g->n, p->meta.sh_degree, p->meta.embed_len, e);
    if (!rc)
        rc = gauss_morton_order(g, order, e);
    if (!rc) {
        memcpy(sorted.origin_enu_m, center, sizeof center);
        sorted.antialiased = p->meta.antialiased;
        rc = gauss_append(&sorted, g, order, pyramid_drop_far(p, g, center, order), e);
    }
    if (!rc)
        rc = store_put(p->store, &t, &sorted, e);
    if (!rc) {
        p->report->n_tiles++;
        if (p->report->max_in_tile < g->n)
            p->report->max_in_tile = g->n;
    }
    mem_free(order);
    gauss_free(&sorted);
    return rc;
}

static enum err_code pyramid_add_node(struct pyramid *p, uint8_t z, uint64_t code, bool content,
                                      struct err *e)
{
    struct pyramid_zoom *l = &p->zoom[z];
    if (l->n == l->cap) {
        size_t cap = l->cap ? 2 * l->cap : 64;
        struct pyramid_node *node = mem_resize(l->node, l->cap, cap, sizeof *node);
        if (!node)
            return err_set(e, ERR_MEM, "out of memory for %zu tiles", cap);
        l->node = node;
        l->cap = cap;
    }
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
    qsort(l->node, l->n, sizeof *l->node, pyramid_node_compare);
    for (size_t i = 0; i < l->n; i++)
        if (n == 0 || l->node[n - 1].code != l->node[i].code)
            l->node[n++] = l->node[i];
    l->n = n;
}

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

/* Write rows [from, to) of a level as one tile. */
static enum err_code pyramid_put_rows(struct pyramid *p, const struct gauss *g,
                                      const struct pyramid_rows *r, size_t from, size_t to,
                                      struct key k, uint8_t level, struct err *e)
{
    struct gauss tile = {0};
    uint32_t *index = mem_array(to - from, sizeof *index);
    enum err_code rc =
        index ? ERR_OK
              : err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", to - from);
    if (!rc)
        rc = gauss_alloc(&tile, to - from, g->sh_degree, g->embed_len, e);
    if (!rc) {
        for (size_t i = from; i < to; i++)
            index[i - from] = r->row[i].row;
        memcpy(tile.origin_enu_m, g->origin_enu_m, sizeof tile.origin_enu_m);
        rc = gauss_append(&tile, g, index, to - from, e);
    }
    if (!rc)
        rc = pyramid_put(p, k, level, &tile, e);
    mem_free(index);
    gauss_free(&tile);
    if (!rc && clock_stopping())
        rc = err_set(e, ERR_CANCEL, "stopped");
    return rc;
}

/* Rows [from, to) are those of a tile at zoom z with content. If anything lies below it, it will be
 * replaced by that, so its rows in quadrants without a tile of their own go one zoom down, and on
 * where needed. Such copies are no nodes: the tile they come from stands for them in everything
 * that is made from below. */
static enum err_code pyramid_carry(struct pyramid *p, const struct gauss *g,
                                   const struct pyramid_rows *r, size_t from, size_t to, uint8_t z,
                                   uint8_t level, struct err *e)
{
    uint8_t down = (uint8_t)(z + 1);
    unsigned shift = 2u * (unsigned)(KEY_ZOOM_MAX - down);
    uint64_t first = r->row[from].code >> shift & ~UINT64_C(3);
    bool any = false;
    for (uint64_t q = 0; q < 4; q++)
        any = any || pyramid_find(p, down, first + q);
    enum err_code rc = ERR_OK;
    for (size_t i = from; any && !rc && i < to;) {
        size_t end = pyramid_run(r, i, down);
        uint64_t code = r->row[i].code >> shift;
        const struct pyramid_node *node = pyramid_find(p, down, code);
        if (!node || !node->content) {
            rc = pyramid_put_rows(p, g, r, i, end, pyramid_key(code, down), level, e);
            p->report->n_carried_tiles++;
            p->report->n_carried += end - i;
        }
        if (!rc && node && !node->content)
            rc = pyramid_carry(p, g, r, i, end, down, level, e);
        i = end;
    }
    return rc;
}

static enum err_code pyramid_carry_level(struct pyramid *p, const struct gauss *g,
                                         const struct pyramid_rows *r, uint8_t z, uint8_t level,
                                         struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < r->n;) {
        size_t end = pyramid_run(r, i, z);
        rc = pyramid_carry(p, g, r, i, end, z, level, e);
        i = end;
    }
    return rc;
}

static enum err_code pyramid_write_level(struct pyramid *p, size_t i, struct err *e)
{
    struct gauss own;
    const struct gauss *g;
    const struct pyramid_rows *r = &p->rows[i];
    uint8_t level = p->levels[i].level, z = pyramid_zoom_of(p, level);
    enum err_code rc = pyramid_open_level(&p->levels[i], &own, &g, e);
    for (size_t from = 0; !rc && from < r->n;) {
        size_t to = pyramid_run(r, from, z);
        uint64_t code = r->row[from].code >> 2u * (unsigned)(KEY_ZOOM_MAX - z);
        rc = pyramid_put_rows(p, g, r, from, to, pyramid_key(code, z), level, e);
        if (!rc)
            rc = pyramid_add_node(p, z, code, true, e);
        p->report->n_gaussians[level] += to - from;
        p->done += to - from;
        progress_step(&p->progress, p->done, NULL);
        from = to;
    }
    if (!rc && z < p->zoom_max)
        rc = pyramid_add_parents(p, z, e);
    if (!rc && z < p->zoom_max)
        rc = pyramid_carry_level(p, g, r, z, level, e);
    gauss_free(&own);
    return rc;
}

/* ---- what no level gave: made from below ---- */

/* Append the nearest tiles with content under (z, code), itself included. */
static enum err_code pyramid_gather(struct pyramid *p, uint8_t z, uint64_t code, struct gauss *into,
                                    struct err *e)
{
    const struct pyramid_node *node = pyramid_find(p, z, code);
    if (!node)
        return ERR_OK;
    enum err_code rc = ERR_OK;
    if (!node->content) {
        for (uint64_t q = 0; !rc && q < 4 && z < KEY_ZOOM_MAX; q++)
            rc = pyramid_gather(p, (uint8_t)(z + 1), 4 * code + q, into, e);
        return rc;
    }
    struct gauss tile;
    rc = store_read_gauss(p->store, pyramid_key(code, z), &tile, e);
    if (!rc && into->n == 0)
        memcpy(into->origin_enu_m, tile.origin_enu_m, sizeof into->origin_enu_m);
    if (!rc)
        rc = gauss_append(into, &tile, NULL, tile.n, e);
    gauss_free(&tile);
    return rc;
}

/* A merged mean lies among the means it came from; on the curved edge of a tile that can be some
 * micrometres outside. Draw it towards the middle until the tile owns it. */
static enum err_code pyramid_pull_inside(const struct pyramid *p, struct key k, struct gauss *g,
                                         struct err *e)
{
    double lon, lat, h, mid[3];
    key_center(k, &lon, &lat);
    enum err_code rc = geo_to_enu(p->origin, lon, lat, p->origin->h_m, mid, e);
    for (size_t i = 0; !rc && i < g->n; i++) {
        for (double pull = 0.0; !rc && pull<1.0; pull = pull> 0.0 ? 4.0 * pull : 1e-7) {
            double enu[3];
            for (size_t a = 0; a < 3; a++) {
                float *m = &g->mean_m[3 * i + a];
                enu[a] = (double)*m + g->origin_enu_m[a];
                if (a < 2 && pull > 0.0) {
                    enu[a] += pull * (mid[a] - enu[a]);
                    *m = (float)(enu[a] - g->origin_enu_m[a]);
                    enu[a] = (double)*m + g->origin_enu_m[a];
                }
            }
            rc = geo_from_enu(p->origin, enu, &lon, &lat, &h, e);
            if (!rc && key_compare(key_at(lon, lat, k.z), k) == 0)
                break;
        }
    }
    return rc;
}

static enum err_code pyramid_make_tile(struct pyramid *p, uint8_t z, uint64_t code, uint8_t level,
                                       struct err *e)
{
    struct gauss below = {0}, less = {0};
    struct key k = pyramid_key(code, z);
    enum err_code rc = gauss_alloc(&below, 0, p->meta.sh_degree, p->meta.embed_len, e);
    for (uint64_t q = 0; !rc && q < 4; q++)
        rc = pyramid_gather(p, (uint8_t)(z + 1), 4 * code + q, &below, e);
    size_t target = (below.n + 3) / 4;
    if (target < PYRAMID_KEEP)
        target = below.n < PYRAMID_KEEP ? below.n : PYRAMID_KEEP;
    if (target > p->max_per_tile)
        target = p->max_per_tile;
    if (!rc)
        rc = simplify_gauss(&below, target, &less, e);
    gauss_free(&below);
    if (!rc)
        rc = pyramid_pull_inside(p, k, &less, e);
    if (!rc)
        rc = pyramid_put(p, k, level, &less, e);
    if (!rc)
        p->report->n_gaussians[level] += less.n;
    gauss_free(&less);
    if (!rc && clock_stopping())
        rc = err_set(e, ERR_CANCEL, "stopped");
    return rc;
}

/* Zooms between z and the tile over all tiles of zoom z. */
static uint8_t pyramid_climb(const struct pyramid_zoom *l)
{
    uint64_t differ = l->node[0].code ^ l->node[l->n - 1].code;
    uint8_t up = 0;
    for (; differ; differ >>= 2)
        up++;
    return up;
}

static enum err_code pyramid_make_coarser(struct pyramid *p, struct err *e)
{
    uint8_t z = pyramid_zoom_of(p, p->levels[0].level);
    enum err_code rc = ERR_OK;
    while (!rc && z > 0) {
        const struct pyramid_zoom *l = &p->zoom[z];
        int level = (int)p->top_level - (p->zoom_max - z) - 1;
        bool lone =
            l->n == 1 || (l->n <= PYRAMID_LONE_ROOTS && pyramid_climb(l) > PYRAMID_CLIMB_MAX);
        if ((lone || z <= p->zoom_least) && level < 1)
            break;
        z--;
        rc = pyramid_add_parents(p, z, e);
        for (size_t i = 0; !rc && i < p->zoom[z].n; i++) {
            rc = pyramid_make_tile(p, z, p->zoom[z].node[i].code, (uint8_t)(level > 0 ? level : 0),
                                   e);
            p->zoom[z].node[i].content = true;
        }
    }
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

static enum err_code pyramid_write(struct pyramid *p, const struct ckpt_blob *blobs, size_t n_blobs,
                                   const char *out_path, struct err *e)
{
    uint64_t total = 0;
    for (size_t i = 0; i < p->n_levels; i++)
        total += p->rows[i].n;
    enum err_code rc = store_create(out_path, &p->meta, &p->store, e);
    progress_start(&p->progress, "tile", total);
    for (size_t i = p->n_levels; !rc && i-- > 0;)
        rc = pyramid_write_level(p, i, e);
    if (!rc)
        rc = pyramid_make_coarser(p, e);
    progress_end(&p->progress, NULL);
    for (size_t i = 0; !rc && i < n_blobs; i++)
        rc = store_put_blob(p->store, blobs[i].name, blobs[i].data, blobs[i].size_bytes, e);
    if (!rc)
        rc = store_commit(&p->store, e);
    store_close(&p->store);
    if (!rc && !(rc = store_open(out_path, &p->store, e))) { /* what was written can be read */
        memcpy(p->report->revision, store_info(p->store)->revision, sizeof p->report->revision);
        store_close(&p->store);
    }
    return rc;
}

enum err_code pyramid_build(const struct geo_origin *origin, const struct pyramid_level *levels,
                            size_t n_levels, const struct pyramid_config *cfg,
                            const struct ckpt_blob *blobs, size_t n_blobs, const char *out_path,
                            struct pyramid_report *report, struct err *e)
{
    struct pyramid_report none;
    double start = clock_s();
    struct pyramid p = {.origin = origin,
                        .levels = levels,
                        .n_levels = n_levels,
                        .cfg = cfg,
                        .report = report ? report : &none};
    *p.report = (struct pyramid_report){0};
    p.max_per_tile = cfg->max_per_tile ? cfg->max_per_tile : PYRAMID_PER_TILE_MAX;
    enum err_code rc = pyramid_check(levels, n_levels, e);
    for (size_t i = 0; !rc && i < n_levels; i++)
        rc = pyramid_code_level(&p, i, e);
    if (!rc) {
        p.top_level = levels[n_levels - 1].level;
        pyramid_choose_zoom(&p);
        p.meta.origin = *origin;
        p.meta.lossless = cfg->lossless;
        memcpy(p.meta.name, cfg->name, sizeof p.meta.name);
        memcpy(p.meta.attribution, cfg->attribution, sizeof p.meta.attribution);
        rc = pyramid_write(&p, blobs, n_blobs, out_path, e);
    }
    if (!rc && p.report->n_bad)
        log_warn("tile", "left out n=%zu Gaussians with values that are not finite",
                 p.report->n_bad);
    if (!rc && p.report->n_far)
        log_warn("tile",
                 "left out n=%zu Gaussians farther than max_m=%g from the centre of their tile",
                 p.report->n_far, PYRAMID_REACH_M + 40.0);
    if (!rc && p.report->n_carried)
        log_info("tile", "carried n=%zu Gaussians into tiles=%zu where a finer level has none",
                 p.report->n_carried, p.report->n_carried_tiles);
    p.report->zoom_max = p.zoom_max;
    p.report->seconds = clock_s() - start;
    for (size_t i = 0; i < PYRAMID_LEVEL_MAX; i++)
        mem_free(p.rows[i].row);
    for (size_t z = 0; z <= KEY_ZOOM_MAX; z++)
        mem_free(p.zoom[z].node);
    return rc;
}
