/* One retrained cell into a store that exists.
 *
 * On the cell's own ground the rows of every trained level are replaced; only tiles that hold such
 * rows, old or new, are written anew. An overview is made of its children thinned apart
 * (pyramid.c), and a thinned row stays inside the child it came from: so an overview is edited by
 * taking out what lies in the children that changed and putting their thinned rows in. Copies of
 * coarse rows under tiles without finer ones are found again where something changed. All other
 * tiles keep their bytes and hash.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lod/edit.h"

struct update {
    const struct update_config *c;
    struct store *old;
    const struct store_tile *tiles;
    size_t n_tiles;
    uint8_t top;        /* the finest level */
    uint8_t zoom_given; /* the coarsest zoom of a level that is given */
    struct edit d;
};

static uint8_t update_zoom(const struct update *u, uint8_t level)
{
    return (uint8_t)(store_info(u->old)->zoom_max - (u->top - level));
}

static bool update_is_carried(const struct update *u, const struct store_tile *t)
{
    return t->level > 0 && t->key.z != update_zoom(u, t->level);
}

static bool update_owned(const struct update *u, const struct gauss *g, size_t i)
{
    return u->c->owns(u->c->user, (double)g->mean_m[3 * i] + g->origin_enu_m[0],
                      (double)g->mean_m[3 * i + 1] + g->origin_enu_m[1]);
}

/* Old tiles with rows of the cell's ground: what they keep becomes their edit. */
static enum err_code update_take_out(struct update *u, const struct store_tile *t, struct err *e)
{
    struct gauss g;
    struct edit_tile *x;
    if (!u->c->may_own(u->c->user, t->min_enu_m, t->max_enu_m))
        return ERR_OK;
    enum err_code rc = store_read_gauss(u->old, t->key, &g, e);
    uint32_t *keep = rc ? NULL : mem_array(g.n, sizeof *keep);
    size_t n = 0;
    if (!rc && !keep)
        rc = err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g.n);
    for (size_t i = 0; !rc && i < g.n; i++)
        if (!update_owned(u, &g, i))
            keep[n++] = (uint32_t)i;
    if (!rc && n < g.n) {
        rc = edit_touch(&u->d, t->key, t->level, &x, e);
        if (!rc) {
            x->carried = update_is_carried(u, t);
            rc = edit_append(&u->d, x, &g, keep, x->carried ? 0 : n, e);
        }
    }
    mem_free(keep);
    gauss_free(&g);
    return rc;
}

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
        rc = edit_append(&u->d, *out, &g, NULL, g.n, e);
    gauss_free(&g);
    return rc;
}

static enum err_code update_put_in(struct update *u, uint8_t level, const struct gauss *g,
                                   struct err *e)
{
    enum err_code rc = ERR_OK;
    for (uint32_t i = 0; !rc && i < g->n; i++) {
        struct gauss one = *g; /* of one row, to ask whether it is usable */
        struct key k;
        struct edit_tile *x;
        if (!update_owned(u, g, i))
            continue;
        one.n = 1;
        one.mean_m += 3 * (size_t)i;
        one.scale_log += 3 * (size_t)i;
        one.quat_wxyz += 4 * (size_t)i;
        one.opacity_logit += i;
        one.sh += 3 * gauss_sh_count(g->sh_degree) * i;
        if (g->embed)
            one.embed += g->embed_len * (size_t)i;
        if (gauss_count_bad(&one, NULL))
            continue;
        rc = edit_key(&u->d, g, i, update_zoom(u, level), &k, e);
        if (!rc)
            rc = update_open_tile(u, k, level, &x, e);
        if (!rc && x->carried) { /* what was a copy is a tile of its own now */
            gauss_free(&x->g);
            x->carried = false;
            x->level = level;
        }
        if (!rc)
            rc = edit_append(&u->d, x, g, &i, 1, e);
    }
    return rc;
}

/* ---- what there will be ---- */

/* Will there be a tile of its own (not a copy) at k? */
static bool update_has(const struct update *u, struct key k)
{
    const struct edit_tile *x = edit_find(&u->d, k);
    if (x)
        return x->g.n > 0 && !x->carried;
    const struct store_tile *t = store_find(u->old, k);
    return t && !update_is_carried(u, t);
}

static bool update_under(struct key over, struct key k)
{
    return k.z > over.z && k.x >> (k.z - over.z) == over.x && k.y >> (k.z - over.z) == over.y;
}

/* Will there be one below k? */
static bool update_has_below(const struct update *u, struct key k)
{
    for (size_t i = 0; i < u->d.n; i++)
        if (update_under(k, u->d.tile[i].key) && update_has(u, u->d.tile[i].key))
            return true;
    for (size_t i = 0; i < u->n_tiles; i++)
        if (update_under(k, u->tiles[i].key) && update_has(u, u->tiles[i].key))
            return true;
    return false;
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
            x->level = level;
            gauss_free(&x->g);
            rc = edit_append(&u->d, x, &some, NULL, n, e);
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
        const struct edit_tile *x = edit_find(&u->d, over[i]);
        struct gauss g = {0};
        if (x) {
            rc = gauss_alloc(&g, x->g.n, x->g.sh_degree, x->g.embed_len, e);
            memcpy(g.origin_enu_m, x->g.origin_enu_m, sizeof g.origin_enu_m);
            if (!rc)
                rc = gauss_append(&g, &x->g, NULL, x->g.n, e);
        } else {
            rc = store_read_gauss(u->old, over[i], &g, e);
        }
        if (!rc)
            rc = update_carry(u, &g, over[i], level, e);
        gauss_free(&g);
    }
    mem_free(over);
    return rc;
}

/* ---- overviews ---- */

/* Does k feed what is made above: no tile of another given level over it? */
static bool update_feeds(const struct update *u, const struct edit_tile *x)
{
    struct key k = x->key;
    if (x->carried || k.z < u->zoom_given)
        return false;
    while (k.z > u->zoom_given) {
        k = key_parent(k);
        if (update_has(u, k))
            return false;
    }
    return true;
}

/* Edit `over` for the change of what is below it at `from`. */
static enum err_code update_overview(struct update *u, struct key over, struct key from,
                                     struct err *e)
{
    struct edit_tile *x;
    struct gauss less = {0};
    int level = (int)u->top - (store_info(u->old)->zoom_max - over.z);
    enum err_code rc = update_open_tile(u, over, (uint8_t)(level > 0 ? level : 0), &x, e);
    size_t n = 0;
    for (size_t i = 0; !rc && i < x->g.n; i++) {
        struct key k;
        rc = edit_key(&u->d, &x->g, i, from.z, &k, e);
        if (rc || key_compare(k, from) == 0)
            continue;
        if (n != i)
            gauss_copy_row(&x->g, n, &x->g, i);
        n++;
    }
    if (rc)
        return rc;
    x->g.n = n;
    const struct gauss *g = &edit_find(&u->d, from)->g;
    if (g->n > 0)
        rc = pyramid_thin(&u->d.locate, g, from, &less, e);
    if (!rc)
        rc = edit_append(&u->d, x, &less, NULL, less.n, e);
    gauss_free(&less);
    return rc;
}

/* One zoom above the given levels after the other, up to the store's top. */
static enum err_code update_overviews(struct update *u, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (uint8_t z = u->zoom_given; !rc && z > store_info(u->old)->zoom_min; z--) {
        size_t n = 0;
        struct key *from = mem_array(u->d.n, sizeof *from);
        if (!from)
            return err_set(e, ERR_MEM, "out of memory for %zu tiles", u->d.n);
        for (size_t i = 0; i < u->d.n; i++) {
            const struct edit_tile *x = &u->d.tile[i];
            if (z == u->zoom_given ? update_feeds(u, x) : x->key.z == z)
                from[n++] = x->key;
        }
        for (size_t i = 0; !rc && i < n; i++) {
            struct key k = from[i];
            while (k.z >= z)
                k = key_parent(k);
            rc = update_overview(u, k, from[i], e);
        }
        mem_free(from);
    }
    return rc;
}

/* ---- all of it ---- */

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
    for (uint8_t l = (uint8_t)(u->top + 1); l < 8; l++)
        if (u->c->level[l])
            return err_set(e, ERR_DATA,
                           "level %u is given, the store ends at level %u: tile the whole scene "
                           "again",
                           l, u->top);
    if (m->embed_len > 0 && bake_fits(u->old, u->c->look, e))
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
    if (!rc)
        rc = locate_open(&u.d.meta.origin, &u.d.locate, e);
    for (size_t i = 0; !rc && i < u.n_tiles; i++)
        if (u.tiles[i].level > 0 && c->level[u.tiles[i].level])
            rc = update_take_out(&u, &u.tiles[i], e);
    for (uint8_t l = u.top; !rc && l > 0; l--)
        if (c->level[l])
            rc = update_put_in(&u, l, c->level[l], e);
    for (uint8_t l = 1; !rc && l < u.top; l++)
        if (c->level[l])
            rc = update_carry_level(&u, l, e);
    if (!rc)
        rc = update_overviews(&u, e);
    if (!rc)
        rc = edit_write(&u.d, u.old, NULL, out_path, &report->n_copied, &report->n_written, e);
    for (size_t i = 0; !rc && i < u.d.n; i++)
        report->n_removed += u.d.tile[i].g.n == 0 && store_find(u.old, u.d.tile[i].key);
    edit_free(&u.d);
    store_close(&u.old);
    if (!rc && !(rc = store_open(out_path, &u.old, e))) {
        memcpy(report->revision, store_info(u.old)->revision, sizeof report->revision);
        store_close(&u.old);
    }
    return rc;
}
