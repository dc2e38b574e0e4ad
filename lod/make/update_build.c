/* Puts one retrained cell into an existing store.
 *
 * On the cell's own ground the rows of every trained level are replaced. Only tiles with such rows,
 * old or new, are written again, and copies of coarse rows under tiles without finer ones. An
 * overview is made of its four children, each thinned alone and to its inside (pyramid_fit.c). The
 * rows of a changed child can therefore be removed from it by their place and made again, while the
 * others stay. All other tiles keep their bytes and hash.
 *
 * The same cell twice gives the same bytes as once. This needs care in three places. Rows that are
 * read and written again must not change (payload.c keeps rounded values). An overview is made of
 * rows in their stored order. Rows that rounding moved across the cell's border are found again by
 * their place (update_border).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/math/sort.h"
#include "lod/make/pyramid_fit.h"
#include "lod/make/simplify.h"
#include "lod/make/update.h"
#include "lod/make/update_over.h"
#include "lod/make/update_tiles.h"
#include "lod/store/bake.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"

/* Stored means are float32 about a tile's centre: a row is within this of where it was. */
#define UPDATE_ROUNDING_M 2.5e-4

/* ---- whose rows ---- */

static void update_place(const struct gauss *g, size_t i, double at[3])
{
    for (size_t k = 0; k < 3; k++)
        at[k] = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k];
}

static bool update_owned(const struct update *u, const double at[3])
{
    return u->c->owns(u->c->user, at[0], at[1]);
}

/* Would rounding do to change hands? */
static bool update_at_border(const struct update *u, const double at[3], bool owned)
{
    const double r = UPDATE_ROUNDING_M;
    return u->c->owns(u->c->user, at[0] - r, at[1] - r) != owned ||
           u->c->owns(u->c->user, at[0] + r, at[1] - r) != owned ||
           u->c->owns(u->c->user, at[0] - r, at[1] + r) != owned ||
           u->c->owns(u->c->user, at[0] + r, at[1] + r) != owned;
}

static enum err_code update_border_add(struct update_border *b, const double at[3], struct err *e)
{
    double *p = mem_room(b->at, b->n, &b->cap, 64, 3 * sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for %zu rows at the border", b->n + 1);
    b->at = p;
    memcpy(b->at + 3 * b->n++, at, 3 * sizeof *at);
    return ERR_OK;
}

static bool update_border_has(const struct update_border *b, const double at[3])
{
    for (size_t i = 0; i < b->n; i++) {
        double far = 0.0;
        for (size_t k = 0; k < 3; k++)
            far = fmax(far, fabs(b->at[3 * i + k] - at[k]));
        if (far <= UPDATE_ROUNDING_M)
            return true;
    }
    return false;
}

/* Is a stored row one that the update replaces? */
static bool update_replaces(const struct update *u, uint8_t level, const struct gauss *g, size_t i)
{
    double at[3];
    update_place(g, i, at);
    bool owned = update_owned(u, at);
    if (owned || u->border[level].n == 0 || !update_at_border(u, at, owned))
        return owned;
    return update_border_has(&u->border[level], at);
}

/* Old tiles with rows of the cell's ground: what they keep becomes their edit. */
static enum err_code update_take_out(struct update *u, const struct store_tile *t, struct err *e)
{
    struct gauss g;
    struct edit_tile *x;
    const struct store_shape at = store_shape(u->old, t);
    if (!u->c->may_own(u->c->user, at.min_enu_m, at.max_enu_m))
        return ERR_OK;
    enum err_code rc = store_read_gauss(u->old, t->key, &g, e);
    uint32_t *keep = rc ? NULL : mem_array(g.n, sizeof *keep);
    size_t n = 0;
    if (!rc && !keep)
        rc = err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g.n);
    for (size_t i = 0; !rc && i < g.n; i++)
        if (!update_replaces(u, t->level, &g, i))
            keep[n++] = (uint32_t)i;
    if (!rc && n < g.n) {
        rc = edit_touch(&u->d, t->key, t->level, &x, e);
        if (!rc) {
            x->carried = update_is_carried(u, t);
            x->whole = true;
            rc = edit_keep(&u->d, x, &g, keep, x->carried ? 0 : n, e);
        }
    }
    mem_free(keep);
    gauss_free(&g);
    return rc;
}

/* ---- the cell's rows ---- */

/* The edit of a tile that holds what the store has there. */
static enum err_code update_open_tile(struct update *u, struct key k, uint8_t level,
                                      struct edit_tile **out, struct err *e)
{
    *out = edit_find(&u->d, k);
    if (*out)
        return ERR_OK;
    const struct store_tile *t = store_find(u->old, k);
    enum err_code rc = edit_touch(&u->d, k, level, out, e);
    if (rc || !t || t->level != level) /* a copy of a coarser level gives way */
        return rc;
    struct gauss g;
    rc = store_read_gauss(u->old, k, &g, e);
    if (!rc)
        rc = edit_keep(&u->d, *out, &g, NULL, g.n, e);
    gauss_free(&g);
    return rc;
}

/* Fewer rows: all at the cell's border, which are known again by their place, and mergers of the
 * others, less those that a notch of the cell's ground leaves outside. */
static enum err_code update_thin(struct update *u, const struct edit_part *part, size_t target,
                                 struct gauss *out, struct err *e)
{
    struct gauss inner = {0}, less = {0};
    const struct gauss *g = part->g;
    double at[3];
    enum err_code rc = gauss_alloc(&inner, part->n, g->sh_degree, g->embed_len, e);
    if (!rc)
        rc = gauss_alloc(out, part->n, g->sh_degree, g->embed_len, e);
    memcpy(inner.origin_enu_m, g->origin_enu_m, sizeof inner.origin_enu_m);
    memcpy(out->origin_enu_m, g->origin_enu_m, sizeof out->origin_enu_m);
    for (size_t i = 0; !rc && i < part->n; i++) {
        update_place(g, part->index[i], at);
        rc = gauss_append(update_at_border(u, at, true) ? out : &inner, g, &part->index[i], 1, e);
    }
    if (!rc && inner.n)
        rc = simplify_gauss(&inner, target > out->n ? target - out->n : 1, &less, e);
    for (uint32_t i = 0; !rc && i < less.n; i++) {
        update_place(&less, i, at);
        if (update_owned(u, at) && !update_at_border(u, at, true))
            rc = gauss_append(out, &less, &i, 1, e);
    }
    gauss_free(&inner);
    gauss_free(&less);
    return rc;
}

/* New rows of one tile. Where the tile would be too full they are thinned, never what it keeps,
 * which would thin out more with every update; and not to less than a quarter. */
static enum err_code update_put_tile(struct update *u, struct key k, uint8_t level,
                                     struct edit_part part, struct err *e)
{
    struct edit_tile *x;
    struct gauss less = {0};
    enum err_code rc = update_open_tile(u, k, level, &x, e);
    if (rc)
        return rc;
    if (x->carried) { /* what was a copy is a tile of its own now */
        gauss_free(&x->g);
        x->carried = false;
        x->level = level;
    }
    x->whole = true;
    size_t max = u->d.max_per_tile, n = x->g.n + part.n;
    if (n > max) {
        size_t target = pyramid_thin_count(part.n);
        target = max > x->g.n && max - x->g.n > target ? max - x->g.n : target;
        log_warn("update",
                 "tile %u/%u/%u would hold n=%zu Gaussians, more than max=%zu: those of the cell "
                 "are thinned to %zu; tile the whole scene again for smaller tiles",
                 k.z, k.x, k.y, n, max, target);
        rc = update_thin(u, &part, target, &less, e);
        part = (struct edit_part){.g = &less, .n = less.n};
    }
    if (!rc)
        rc = edit_add(&u->d, x, &part, 1, e);
    gauss_free(&less);
    return rc;
}

/* The usable rows on the cell's ground, by tile: items [*n], sorted. */
static enum err_code update_sort_rows(struct update *u, uint8_t level, const struct gauss *g,
                                      struct sort_item *items, size_t *n, struct err *e)
{
    enum err_code rc = ERR_OK;
    bool all_good = gauss_count_unusable(g, NULL) == 0;
    uint8_t z = update_zoom(u, level);
    *n = 0;
    for (size_t i = 0; !rc && i < g->n; i++) {
        struct gauss one;
        struct key k;
        double at[3];
        update_place(g, i, at);
        if (!all_good && (one = pyramid_view(g, i, 1), gauss_count_unusable(&one, NULL)))
            continue;
        if (!update_owned(u, at))
            continue;
        rc = edit_key(&u->d, g, i, z, &k, e);
        items[(*n)++] = (struct sort_item){locate_code(k), (uint32_t)i};
    }
    if (!rc)
        sort_items(items, items + g->n, *n);
    return rc;
}

static enum err_code update_put_in(struct update *u, uint8_t level, struct err *e)
{
    const struct gauss *g = u->c->level[level];
    struct sort_item *items = mem_array(g->n, 2 * sizeof *items);
    uint32_t *index = mem_array(g->n, sizeof *index);
    size_t n = 0;
    enum err_code rc = items && index
                           ? update_sort_rows(u, level, g, items, &n, e)
                           : err_set(e, ERR_MEM, "out of memory for %zu Gaussians", g->n);
    for (size_t i = 0; i < n; i++)
        index[i] = items[i].row;
    for (size_t from = 0, to; !rc && from < n; from = to) {
        for (to = from; to < n && items[to].key == items[from].key; to++)
            continue;
        const struct edit_part part = {g, index + from, to - from};
        rc = update_put_tile(u, locate_decode(items[from].key, update_zoom(u, level)), level, part,
                             e);
    }
    mem_free(items);
    mem_free(index);
    return rc;
}

static enum err_code update_find_border(struct update *u, uint8_t level, struct err *e)
{
    const struct gauss *g = u->c->level[level];
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < g->n; i++) {
        double at[3];
        update_place(g, i, at);
        if (isfinite(at[0] + at[1] + at[2]) && update_owned(u, at) && update_at_border(u, at, true))
            rc = update_border_add(&u->border[level], at, e);
    }
    return rc;
}

/* ---- copies of coarse rows ---- */

static enum err_code update_carry(struct update *u, const struct gauss *g, struct key k,
                                  uint8_t level, struct err *e);

/* Rows of g in one quadrant of a tile that has others below it. */
static enum err_code update_carry_quadrant(struct update *u, const struct gauss *g, struct key q,
                                           uint8_t level, struct err *e)
{
    struct gauss some = {0};
    struct edit_tile *x;
    uint32_t *index = mem_array(g->n, sizeof *index);
    size_t n = 0;
    enum err_code rc = index ? ERR_OK : err_set(e, ERR_MEM, "out of memory for a tile");
    for (uint32_t i = 0; !rc && i < g->n; i++) {
        struct key k;
        rc = edit_key(&u->d, g, i, q.z, &k, e);
        if (!rc && key_compare(k, q) == 0)
            index[n++] = i;
    }
    const struct store_tile *old = store_find(u->old, q);
    bool whole = old && update_is_carried(u, old) && old->level == level && !edit_find(&u->d, q);
    if (!rc && n > 0 && !update_has(u, q)) {
        rc = gauss_alloc(&some, n, u->d.meta.sh_degree, u->d.meta.embed_len, e);
        if (!rc) {
            memcpy(some.origin_enu_m, g->origin_enu_m, sizeof some.origin_enu_m);
            rc = gauss_append(&some, g, index, n, e);
        }
        if (!rc && !whole && !(rc = edit_touch(&u->d, q, level, &x, e))) {
            x->carried = true;
            x->whole = true;
            x->level = level;
            gauss_free(&x->g);
            rc = edit_add(&u->d, x, &(struct edit_part){.g = &some, .n = n}, 1, e);
        }
        if (!rc)
            rc = update_carry(u, &some, q, level, e);
    }
    mem_free(index);
    gauss_free(&some);
    return rc;
}

static enum err_code update_carry(struct update *u, const struct gauss *g, struct key k,
                                  uint8_t level, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (k.z >= store_info(u->old)->zoom_max || !update_has_below(u, k))
        return ERR_OK;
    for (uint32_t q = 0; !rc && q < 4; q++)
        rc = update_carry_quadrant(
            u, g, (struct key){(uint8_t)(k.z + 1), 2 * k.x + (q & 1), 2 * k.y + (q >> 1)}, level,
            e);
    return rc;
}

/* Every tile of a given level with a change at or below it. */
static enum err_code update_carry_level(struct update *u, uint8_t level, struct err *e)
{
    uint8_t z = update_zoom(u, level);
    enum err_code rc = ERR_OK;
    size_t n = 0, cap = u->d.n;
    struct key *over = mem_array(cap, sizeof *over);
    if (!over)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", cap);
    for (size_t i = 0; i < u->d.n; i++) {
        struct key k = u->d.tile[i].key;
        if (k.z < z)
            continue;
        k = (struct key){z, k.x >> (k.z - z), k.y >> (k.z - z)};
        bool known = false;
        for (size_t j = 0; j < n; j++)
            known = known || key_compare(over[j], k) == 0;
        if (!known && update_has(u, k))
            over[n++] = k;
    }
    for (size_t i = 0; !rc && i < n; i++) {
        struct gauss g = {0};
        rc = update_now(u, over[i], &g, e);
        if (!rc)
            rc = update_carry(u, &g, over[i], level, e);
        gauss_free(&g);
    }
    mem_free(over);
    return rc;
}

/* ---- all of it ---- */

static_assert(sizeof((struct update_config *)0)->level ==
                  (STORE_LEVEL_MAX + 1) * sizeof(struct gauss *),
              "a place for every level that a store may have");

static enum err_code update_check(struct update *u, struct err *e)
{
    const struct store_meta *m = store_info(u->old);
    uint8_t first = 0;
    for (size_t i = 0; i < u->n_tiles; i++)
        u->top = u->tiles[i].level > u->top ? u->tiles[i].level : u->top;
    for (uint8_t l = 1; l <= u->top; l++) {
        const struct gauss *g = u->c->level[l];
        if (!g && first)
            return err_set(e, ERR_ARG, "update: level %u is missing; the store has levels to %u", l,
                           u->top);
        if (!g)
            continue;
        first = first ? first : l;
        if (g->sh_degree > m->sh_degree || g->embed_len != m->embed_len ||
            (g->n > 0 && g->antialiased != m->antialiased))
            return err_set(e, ERR_DATA,
                           "level %u has SH of degree %u, embeddings of %u and anti-aliasing %d, "
                           "the store %u, %u and %d: tile the whole scene again",
                           l, g->sh_degree, g->embed_len, g->antialiased, m->sh_degree,
                           m->embed_len, m->antialiased);
    }
    if (!first)
        return err_set(e, ERR_ARG, "update: no level is given");
    for (uint8_t l = (uint8_t)(u->top + 1); l <= STORE_LEVEL_MAX; l++)
        if (u->c->level[l])
            return err_set(e, ERR_DATA,
                           "level %u is given, the store ends at level %u: tile the whole scene "
                           "again",
                           l, u->top);
    if (m->embed_len > 0 && bake_fits(u->old, u->c->appearance, e))
        return err_add(e, "the cell was trained with another appearance model than the store's "
                          "tiles: train it again with theirs (--appearance-shared), or tile the "
                          "whole scene again");
    u->zoom_given = update_zoom(u, first);
    return ERR_OK;
}

enum err_code update_build(const char *store_path, const struct update_config *c,
                           const char *out_path, struct update_report *report, struct err *e)
{
    struct update u = {.c = c};
    struct update_report none;
    report = report ? report : &none;
    *report = (struct update_report){0};
    enum err_code rc = store_open(store_path, &u.old, e);
    if (rc)
        return rc;
    u.tiles = store_tiles(u.old, &u.n_tiles);
    u.d.meta = *store_info(u.old);
    u.d.max_per_tile = c->max_per_tile ? c->max_per_tile : PYRAMID_PER_TILE_MAX;
    rc = update_check(&u, e);
    if (!rc && c->appearance)
        rc = bake_join(u.old, c->appearance, &u.d.appearance, e);
    if (!rc)
        rc = locate_open(&u.d.meta.origin, &u.d.locate, e);
    for (uint8_t l = 1; !rc && l <= u.top; l++)
        if (c->level[l])
            rc = update_find_border(&u, l, e);
    for (size_t i = 0; !rc && i < u.n_tiles; i++)
        if (u.tiles[i].level > 0 && c->level[u.tiles[i].level])
            rc = update_take_out(&u, &u.tiles[i], e);
    for (uint8_t l = u.top; !rc && l > 0; l--)
        if (c->level[l])
            rc = update_put_in(&u, l, e);
    for (uint8_t l = 1; !rc && l < u.top; l++)
        if (c->level[l])
            rc = update_carry_level(&u, l, e);
    if (!rc)
        rc = update_overviews(&u, e);
    if (!rc)
        rc = edit_write(&u.d, u.old, NULL, out_path, &report->n_copied, &report->n_written, e);
    for (size_t i = 0; !rc && i < u.d.n; i++)
        report->n_removed += u.d.tile[i].g.n == 0 && store_find(u.old, u.d.tile[i].key);
    for (size_t l = 0; l <= STORE_LEVEL_MAX; l++)
        mem_free(u.border[l].at);
    edit_free(&u.d);
    store_close(&u.old);
    if (!rc && !(rc = store_open(out_path, &u.old, e))) {
        memcpy(report->revision, store_info(u.old)->revision, sizeof report->revision);
        store_close(&u.old);
    }
    return rc;
}
