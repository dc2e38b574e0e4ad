/* The index of a store in memory: see index.h.
 *
 * The tiler's centres are whole metres, its cores are means in float from there, its median sigma
 * is the exponential of a float, and the geometric error 16 times that. Only boxes and the largest
 * sigma need all bits of a double. Each shape is unpacked at once and compared.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/index.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lod/key.h"

static_assert(sizeof(struct store_tile) == 40 && sizeof(struct index_shape) == 96,
              "a million tiles take 136 MB");

static bool index_is_whole(const struct index_shape *p)
{
    return isnan(p->sigma_median_log);
}

static void index_unpack_bounds(const struct index_shape *p, struct store_shape *s)
{
    memcpy(s->min_enu_m, p->min_enu_m, sizeof s->min_enu_m);
    memcpy(s->max_enu_m, p->max_enu_m, sizeof s->max_enu_m);
    for (size_t k = 0; k < 3; k++) {
        s->center_enu_m[k] = p->center_enu_m[k];
        s->core_min_enu_m[k] = s->center_enu_m[k] + (double)p->core_min_m[k];
        s->core_max_enu_m[k] = s->center_enu_m[k] + (double)p->core_max_m[k];
    }
    s->sigma_max_m = p->sigma_max_m;
}

static void index_unpack(const struct index_shape *p, struct store_shape *s)
{
    index_unpack_bounds(p, s);
    s->sigma_median_m = exp((double)p->sigma_median_log);
    s->geometric_error_m = STORE_PX_PER_SIGMA * s->sigma_median_m;
}

/* False: it would not come out as it is. */
static bool index_pack(const struct store_shape *s, struct index_shape *p)
{
    memcpy(p->min_enu_m, s->min_enu_m, sizeof p->min_enu_m);
    memcpy(p->max_enu_m, s->max_enu_m, sizeof p->max_enu_m);
    for (size_t k = 0; k < 3; k++) {
        const double c = s->center_enu_m[k], lo = s->core_min_enu_m[k] - c,
                     hi = s->core_max_enu_m[k] - c;
        if (!(fabs(c) < INT32_MAX && fabs(lo) < (double)FLT_MAX && fabs(hi) < (double)FLT_MAX))
            return false;
        p->center_enu_m[k] = (int32_t)c;
        p->core_min_m[k] = (float)lo;
        p->core_max_m[k] = (float)hi;
    }
    p->sigma_max_m = s->sigma_max_m;
    if (!(s->sigma_median_m > 0.0))
        return false;
    p->sigma_median_log = (float)log(s->sigma_median_m);
    struct store_shape again;
    index_unpack(p, &again);
    return !memcmp(&again, s, sizeof again);
}

/* Grown by copying: mem_resize would write the new room twice. */
static void *index_room(void *p, size_t n, size_t cap, size_t size)
{
    void *q = mem_uninit(cap, size);
    if (q && p)
        memcpy(q, p, n * size);
    if (q)
        mem_free(p);
    return q;
}

static enum err_code index_grow(struct index *x, size_t expected, struct err *e)
{
    const size_t cap = x->cap ? 2 * x->cap : expected ? expected : 1;
    struct store_tile *tiles = index_room(x->tiles, x->n, cap, sizeof *tiles);
    x->tiles = tiles ? tiles : x->tiles;
    struct index_shape *shapes = tiles ? index_room(x->shapes, x->n, cap, sizeof *shapes) : NULL;
    x->shapes = shapes ? shapes : x->shapes;
    if (!shapes)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", x->n + 1);
    x->cap = cap;
    return ERR_OK;
}

static enum err_code index_keep_whole(struct index *x, const struct store_shape *s,
                                      struct index_shape *p, struct err *e)
{
    enum { FIRST = 64 };
    struct store_shape *whole =
        x->n_whole < INT32_MAX ? mem_room(x->whole, x->n_whole, &x->cap_whole, FIRST, sizeof *whole)
                               : NULL;
    if (!whole)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", x->n + 1);
    x->whole = whole;
    *p = (struct index_shape){.center_enu_m[0] = (int32_t)x->n_whole, .sigma_median_log = NAN};
    x->whole[x->n_whole++] = *s;
    return ERR_OK;
}

enum err_code index_add(struct index *x, const struct store_entry *t, size_t expected,
                        struct err *e)
{
    enum err_code rc = x->n < x->cap ? ERR_OK : index_grow(x, expected, e);
    if (!rc && !index_pack(&t->shape, &x->shapes[x->n]))
        rc = index_keep_whole(x, &t->shape, &x->shapes[x->n], e);
    if (!rc)
        x->tiles[x->n++] = t->tile;
    return rc;
}

struct index_place {
    struct key key;
    uint32_t at;
};

static int index_place_compare(const void *a, const void *b)
{
    const struct index_place *x = a, *y = b;
    return key_compare(x->key, y->key);
}

/* Sorts places, not tiles, which are eight times as large. Then each circle of tiles that change
 * places is gone through once. */
enum err_code index_sort(struct index *x, struct err *e)
{
    bool sorted = true;
    for (size_t i = 1; sorted && i < x->n; i++)
        sorted = key_compare(x->tiles[i - 1].key, x->tiles[i].key) <= 0;
    if (sorted)
        return ERR_OK;
    struct index_place *place = mem_uninit(x->n, sizeof *place);
    if (!place)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", x->n);
    for (size_t i = 0; i < x->n; i++)
        place[i] = (struct index_place){x->tiles[i].key, (uint32_t)i};
    qsort(place, x->n, sizeof *place, index_place_compare);
    for (size_t i = 0; i < x->n; i++) {
        if (place[i].at == i)
            continue;
        const struct store_tile tile = x->tiles[i];
        const struct index_shape shape = x->shapes[i];
        size_t to = i;
        for (size_t from; (from = place[to].at) != i; to = from) {
            x->tiles[to] = x->tiles[from];
            x->shapes[to] = x->shapes[from];
            place[to].at = (uint32_t)to;
        }
        x->tiles[to] = tile;
        x->shapes[to] = shape;
        place[to].at = (uint32_t)to;
    }
    mem_free(place);
    return ERR_OK;
}

void index_free(struct index *x)
{
    mem_free(x->tiles);
    mem_free(x->shapes);
    mem_free(x->whole);
    *x = (struct index){0};
}

uint32_t index_find(const struct index *x, struct key k)
{
    size_t lo = 0, hi = x->n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        int c = key_compare(x->tiles[mid].key, k);
        if (c == 0)
            return (uint32_t)mid;
        if (c < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return INDEX_NONE;
}

struct store_shape index_shape(const struct index *x, size_t i)
{
    const struct index_shape *p = &x->shapes[i];
    struct store_shape s;
    if (index_is_whole(p))
        return x->whole[p->center_enu_m[0]];
    index_unpack(p, &s);
    return s;
}

struct store_shape index_bounds(const struct index *x, size_t i)
{
    const struct index_shape *p = &x->shapes[i];
    struct store_shape s = {0};
    if (index_is_whole(p))
        return x->whole[p->center_enu_m[0]];
    index_unpack_bounds(p, &s);
    return s;
}
