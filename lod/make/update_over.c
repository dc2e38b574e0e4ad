/* Overviews of tiles that an update changed.
 *
 * An overview consists of the rows that its four children give, each thinned alone. If one child
 * changed, the rows in its quarter are removed and made again from its settled rows. The other
 * three quarters stay.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/make/update_over.h"

#include <stdlib.h>
#include <string.h>

#include "lod/make/pyramid_fit.h"
#include "lod/make/update_tiles.h"
#include "lod/store/store.h"

/* Tiles that are thinned into the one above k: k itself if it is one of its own, else, at the
 * coarsest zoom that is given, the first ones below. */
struct update_feeds {
    struct key *key; /* [n] sorted */
    size_t n, cap;
};

static enum err_code update_feeds_add(struct update_feeds *f, struct key k, struct err *e)
{
    struct key *p = mem_room(f->key, f->n, &f->cap, 16, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", f->n + 1);
    f->key = p;
    f->key[f->n++] = k;
    return ERR_OK;
}

/* Is there a tile of its own at k, after the update or before it? */
static bool update_stands(const struct update *u, struct key k, bool before)
{
    if (!before)
        return update_has(u, k);
    const struct store_tile *t = store_find(u->old, k);
    return t && !update_is_carried(u, t);
}

/* Does nothing stand over k, up to `over`? */
static bool update_is_first(const struct update *u, struct key k, struct key over, bool before)
{
    while (k.z > over.z) {
        k = key_parent(k);
        if (update_stands(u, k, before))
            return false;
    }
    return true;
}

static int update_key_compare(const void *a, const void *b)
{
    return key_compare(*(const struct key *)a, *(const struct key *)b);
}

static enum err_code update_find_feeds(const struct update *u, struct key k, bool before,
                                       struct update_feeds *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    *out = (struct update_feeds){0};
    if (update_stands(u, k, before) || k.z < u->zoom_given)
        return update_stands(u, k, before) ? update_feeds_add(out, k, e) : ERR_OK;
    for (size_t i = 0; !rc && i < u->n_tiles; i++) {
        struct key at = u->tiles[i].key;
        if (update_under(k, at) && update_stands(u, at, before) &&
            update_is_first(u, at, k, before))
            rc = update_feeds_add(out, at, e);
    }
    for (size_t i = 0; !rc && !before && i < u->d.n; i++) {
        struct key at = u->d.tile[i].key;
        if (update_under(k, at) && !store_find(u->old, at) && update_has(u, at) &&
            update_is_first(u, at, k, false))
            rc = update_feeds_add(out, at, e);
    }
    if (out->n)
        qsort(out->key, out->n, sizeof *out->key, update_key_compare);
    return rc;
}

/* How many rows an overview has of the child k. */
static enum err_code update_count_fed(struct update *u, struct key k, bool before, size_t *n,
                                      struct err *e)
{
    struct update_feeds f;
    enum err_code rc = update_find_feeds(u, k, before, &f, e);
    for (size_t i = 0; !rc && i < f.n; i++) {
        struct edit_tile *x = before ? NULL : edit_find(&u->d, f.key[i]);
        if (x)
            rc = edit_settle(&u->d, x, e);
        *n += pyramid_thin_count(x ? x->g.n : store_find(u->old, f.key[i])->count);
    }
    mem_free(f.key);
    return rc;
}

static struct key update_child(struct key k, uint32_t q)
{
    return (struct key){(uint8_t)(k.z + 1), 2 * k.x + (q & 1), 2 * k.y + (q >> 1)};
}

/* Must all of an overview be made again? Not when it is just what its four children pass on, before
 * and after: then the rows of one are told by their place. Where they were or will be too many and
 * are thinned together, nothing says whose they are. */
static enum err_code update_is_mixed(struct update *u, struct key over, bool *mixed, struct err *e)
{
    const struct store_tile *t = store_find(u->old, over);
    size_t before = 0, after = 0;
    enum err_code rc = ERR_OK;
    for (uint32_t q = 0; !rc && q < 4; q++) {
        rc = update_count_fed(u, update_child(over, q), true, &before, e);
        if (!rc)
            rc = update_count_fed(u, update_child(over, q), false, &after, e);
    }
    *mixed = !t || t->count != before || after > u->d.max_per_tile;
    return rc;
}

/* Leave of an overview what its unchanged children gave. */
static enum err_code update_overview_keep(struct update *u, struct edit_tile *x, struct key over,
                                          const bool again[4], struct err *e)
{
    struct gauss g;
    size_t n = 0;
    enum err_code rc = store_read_gauss(u->old, over, &g, e);
    uint32_t *keep = rc ? NULL : mem_array(g.n, sizeof *keep);
    if (!rc && !keep)
        rc = err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g.n);
    for (size_t i = 0; !rc && i < g.n; i++) {
        struct key k;
        rc = edit_key(&u->d, &g, i, (uint8_t)(over.z + 1), &k, e);
        if (!rc && !again[(k.x & 1) + 2 * (k.y & 1)])
            keep[n++] = (uint32_t)i;
    }
    if (!rc)
        rc = edit_keep(&u->d, x, &g, keep, n, e);
    mem_free(keep);
    gauss_free(&g);
    return rc;
}

/* The thinned rows of a child; part[*n] are of gauss[*n]. */
static enum err_code update_thin_child(struct update *u, struct key child, struct gauss **less,
                                       size_t *n, struct err *e)
{
    struct update_feeds f;
    enum err_code rc = update_find_feeds(u, child, false, &f, e);
    if (!rc && f.n) {
        struct gauss *p = mem_resize(*less, *n, *n + f.n, sizeof *p);
        if (!p)
            rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", f.n);
        else
            *less = p;
    }
    for (size_t i = 0; !rc && i < f.n; i++) {
        struct gauss g;
        rc = update_now(u, f.key[i], &g, e);
        if (!rc && g.n > 0)
            rc = pyramid_thin(&u->d.locate, &g, f.key[i], &(*less)[*n], e);
        *n += !rc && g.n > 0;
        gauss_free(&g);
    }
    mem_free(f.key);
    return rc;
}

/* Edit `over` for the change of its children again[0..3]. */
static enum err_code update_overview(struct update *u, struct key over, bool again[4],
                                     struct err *e)
{
    struct edit_tile *x;
    struct gauss *less = NULL;
    size_t n = 0;
    bool mixed;
    int level = (int)u->top - (store_info(u->old)->zoom_max - over.z);
    enum err_code rc = update_is_mixed(u, over, &mixed, e);
    for (uint32_t q = 0; !rc && q < 4; q++) {
        again[q] = again[q] || mixed;
        if (again[q])
            rc = update_thin_child(u, update_child(over, q), &less, &n, e);
    }
    if (!rc)
        rc = edit_touch(&u->d, over, (uint8_t)(level > 0 ? level : 0), &x, e);
    if (!rc && !mixed)
        rc = update_overview_keep(u, x, over, again, e);
    struct edit_part *part = rc ? NULL : mem_array(n, sizeof *part);
    if (!rc && !part)
        rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    for (size_t i = 0; !rc && i < n; i++)
        part[i] = (struct edit_part){.g = &less[i], .n = less[i].n};
    if (!rc)
        rc = edit_add(&u->d, x, part, n, e);
    if (!rc)
        rc = edit_settle(&u->d, x, e);
    for (size_t i = 0; i < n; i++)
        gauss_free(&less[i]);
    mem_free(less);
    mem_free(part);
    return rc;
}

/* Children of one tile side by side. */
static int update_over_compare(const void *a, const void *b)
{
    return key_compare(key_parent(*(const struct key *)a), key_parent(*(const struct key *)b));
}

enum err_code update_overviews(struct update *u, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (uint8_t z = u->zoom_given; !rc && z > store_info(u->old)->zoom_min; z--) {
        size_t n = 0;
        struct key *child = mem_array(u->d.n, sizeof *child);
        if (!child)
            return err_set(e, ERR_MEM, "out of memory for %zu tiles", u->d.n);
        for (size_t i = 0; i < u->d.n; i++) {
            struct key k = u->d.tile[i].key;
            if (k.z == z || (k.z > z && z == u->zoom_given))
                child[n++] = (struct key){z, k.x >> (k.z - z), k.y >> (k.z - z)};
        }
        if (n)
            qsort(child, n, sizeof *child, update_over_compare);
        for (size_t from = 0, to; !rc && from < n; from = to) {
            struct key over = key_parent(child[from]);
            bool again[4] = {false};
            for (to = from; to < n && key_compare(key_parent(child[to]), over) == 0; to++)
                again[(child[to].x & 1) + 2 * (child[to].y & 1)] = true;
            rc = update_overview(u, over, again, e);
        }
        mem_free(child);
    }
    return rc;
}
