/* Which part of a store was surveyed: see area.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/area.h"

#include <math.h>
#include <stdlib.h>

#include "lod/tree.h"

struct area_weight {
    double sigma_m;
    uint64_t count;
};

static int area_compare(const void *a, const void *b)
{
    const struct area_weight *x = a, *y = b;
    return (x->sigma_m > y->sigma_m) - (x->sigma_m < y->sigma_m);
}

static bool area_leaf(const struct tree *t, size_t i)
{
    return t->nodes[i].child_count == 0;
}

/* The median over leaves, each counted by its Gaussians. */
static enum err_code area_sigma(const struct store *s, double *out, struct err *e)
{
    size_t n, used = 0;
    uint64_t total = 0, sum = 0;
    const struct store_tile *tiles = store_tiles(s, &n);
    struct area_weight *w = mem_array(n, sizeof *w);
    if (!w)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    for (size_t i = 0; i < n; i++)
        if (area_leaf(store_tree(s), i) && tiles[i].count > 0) {
            w[used++] = (struct area_weight){tiles[i].sigma_median_m, tiles[i].count};
            total += tiles[i].count;
        }
    qsort(w, used, sizeof *w, area_compare);
    *out = 0.0;
    for (size_t i = 0; i < used && 2 * sum < total; i++) {
        sum += w[i].count;
        *out = w[i].sigma_m;
    }
    mem_free(w);
    return used ? ERR_OK : err_set(e, ERR_DATA, "the store has no Gaussians: nothing to survey");
}

static void area_add(struct area *a, const struct store_tile *t)
{
    double west, south, east, north;
    bool first = a->n_in++ == 0;
    /* A core of zeros is not known: the box then. */
    bool core = t->core_max_enu_m[2] > t->core_min_enu_m[2];
    double lo = core ? t->core_min_enu_m[2] : t->min_enu_m[2],
           hi = core ? t->core_max_enu_m[2] : t->max_enu_m[2];
    key_bounds(t->key, &west, &south, &east, &north);
    a->west_deg = first ? west : fmin(a->west_deg, west);
    a->south_deg = first ? south : fmin(a->south_deg, south);
    a->east_deg = first ? east : fmax(a->east_deg, east);
    a->north_deg = first ? north : fmax(a->north_deg, north);
    a->floor_m = first ? lo : fmin(a->floor_m, lo);
    a->ceiling_m = first ? hi : fmax(a->ceiling_m, hi);
}

enum err_code area_make(const struct store *s, struct area *out, struct err *e)
{
    struct area a = {.store = s};
    size_t n;
    const struct store_tile *tiles = store_tiles(s, &n);
    enum err_code rc = area_sigma(s, &a.sigma_m, e);
    if (!rc && !(a.in = mem_array(n, sizeof *a.in)))
        rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    for (size_t i = 0; !rc && i < n; i++) {
        a.in[i] = area_leaf(store_tree(s), i) && tiles[i].count > 0 &&
                  tiles[i].sigma_median_m <= AREA_COARSE * a.sigma_m;
        if (a.in[i])
            area_add(&a, &tiles[i]);
    }
    *out = a;
    return rc;
}

void area_free(struct area *a)
{
    mem_free(a->in);
    *a = (struct area){0};
}

bool area_holds(const struct area *a, struct key k)
{
    size_t n;
    const struct store_tile *tiles = store_tiles(a->store, &n);
    uint8_t least = store_info(a->store)->zoom_min;
    for (;; k = key_parent(k)) {
        const struct store_tile *t = store_find(a->store, k);
        if (t)
            return a->in[t - tiles];
        if (k.z <= least)
            return false;
    }
}
