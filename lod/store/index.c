/* The index of a store in memory: see index.h.
 *
 * The tiler's centres are whole metres, its cores are means in float from there, and its median
 * sigma is the exponential of a float. The geometric error is 16 times that, or what the level's
 * pixels say. Only boxes and the largest sigma need all bits of a double. Each shape is unpacked at
 * once and compared.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/index.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lod/store/key.h"

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

static double index_unpack_sigma(const struct index_shape *p)
{
    return exp((double)p->sigma_median_log);
}

double index_error_m(const double pixel_m[STORE_LEVEL_MAX], uint32_t level, double sigma_median_m)
{
    const double own_m = level > 0 && level <= STORE_LEVEL_MAX ? pixel_m[level - 1] : 0.0;
    return STORE_PX_PER_SIGMA *
           (own_m > 0.0 ? fmin(sigma_median_m, STORE_PIXEL_SHARE * own_m) : sigma_median_m);
}

static void index_unpack(const struct index *x, uint32_t level, const struct index_shape *p,
                         struct store_shape *s)
{
    index_unpack_bounds(p, s);
    s->sigma_median_m = index_unpack_sigma(p);
    s->geometric_error_m = index_error_m(x->pixel_m, level, s->sigma_median_m);
}

/* False: it would not come out as it is. */
static bool index_pack(const struct index *x, const struct store_entry *t, struct index_shape *p)
{
    const struct store_shape *s = &t->shape;
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
    index_unpack(x, t->tile.level, p, &again);
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

enum err_code index_reserve(struct index *x, size_t cap, struct err *e)
{
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
    enum { FIRST = 8 };
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

bool index_set(struct index *x, size_t i, const struct store_entry *t)
{
    x->tiles[i] = t->tile;
    return index_pack(x, t, &x->shapes[i]);
}

enum err_code index_add(struct index *x, const struct store_entry *t, size_t expected,
                        struct err *e)
{
    enum err_code rc = ERR_OK;
    if (x->n == x->cap)
        rc = index_reserve(x, x->cap ? 2 * x->cap : expected ? expected : 1, e);
    if (!rc && !index_set(x, x->n, t))
        rc = index_keep_whole(x, &t->shape, &x->shapes[x->n], e);
    if (!rc)
        x->n++;
    return rc;
}

struct index_bins { /* one for each row (or column) of each zoom, from its least to its largest */
    uint32_t first[UINT8_MAX + 1]; /* of a zoom: its first bin less its least row, modulo 2^32 */
    uint32_t *next;                /* where the next tile of the bin goes */
    size_t n;
};

static uint32_t index_line(struct key k, bool rows)
{
    return rows ? k.y : k.x;
}

/* False: the tiles are so far apart that there would be far more bins than tiles. */
static bool index_lay_bins(const struct index *x, bool rows, struct index_bins *b)
{
    uint32_t lo[UINT8_MAX + 1], hi[UINT8_MAX + 1];
    const size_t most = 4 * x->n + 1024;
    memset(lo, 0xff, sizeof lo);
    memset(hi, 0, sizeof hi);
    for (size_t i = 0; i < x->n; i++) {
        const struct key k = x->tiles[i].key;
        const uint32_t line = index_line(k, rows);
        lo[k.z] = line < lo[k.z] ? line : lo[k.z];
        hi[k.z] = line > hi[k.z] ? line : hi[k.z];
    }
    b->n = 0;
    for (size_t z = 0; z <= UINT8_MAX; z++) {
        b->first[z] = (uint32_t)b->n - lo[z];
        b->n += lo[z] <= hi[z] ? (size_t)(hi[z] - lo[z]) + 1 : 0;
        if (b->n > most)
            return false;
    }
    return true;
}

/* Sorts places by zoom and row (or column); tiles of equal ones stay in order. */
static void index_sort_lines(const struct index *x, bool rows, const struct index_bins *b,
                             const uint32_t *from, uint32_t *to)
{
    memset(b->next, 0, b->n * sizeof *b->next);
    for (size_t i = 0; i < x->n; i++) {
        const struct key k = x->tiles[i].key;
        b->next[b->first[k.z] + index_line(k, rows)]++;
    }
    uint32_t at = 0;
    for (size_t i = 0; i < b->n; i++) {
        const uint32_t count = b->next[i];
        b->next[i] = at;
        at += count;
    }
    for (size_t i = 0; i < x->n; i++) {
        const uint32_t tile = from ? from[i] : (uint32_t)i;
        const struct key k = x->tiles[tile].key;
        to[b->next[b->first[k.z] + index_line(k, rows)]++] = tile;
    }
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

/* By comparing. Places and not tiles, which are eight times as large. */
static enum err_code index_order_far(const struct index *x, uint32_t *order, struct err *e)
{
    struct index_place *place = mem_uninit(x->n, sizeof *place);
    if (!place)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", x->n);
    for (size_t i = 0; i < x->n; i++)
        place[i] = (struct index_place){x->tiles[i].key, (uint32_t)i};
    qsort(place, x->n, sizeof *place, index_place_compare);
    for (size_t i = 0; i < x->n; i++)
        order[i] = place[i].at;
    mem_free(place);
    return ERR_OK;
}

/* By counting, first the columns and then the rows of each zoom. */
static enum err_code index_order(const struct index *x, uint32_t *order, struct err *e)
{
    struct index_bins columns, rows;
    if (!index_lay_bins(x, false, &columns) || !index_lay_bins(x, true, &rows))
        return index_order_far(x, order, e);
    const size_t most = columns.n > rows.n ? columns.n : rows.n;
    uint32_t *by_column = mem_uninit(x->n, sizeof *by_column);
    columns.next = rows.next = mem_uninit(most, sizeof *rows.next);
    const bool room = by_column && rows.next;
    if (room) {
        index_sort_lines(x, false, &columns, NULL, by_column);
        index_sort_lines(x, true, &rows, by_column, order);
    }
    mem_free(by_column);
    mem_free(rows.next);
    return room ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu tiles", x->n);
}

/* Goes once through each circle of tiles that change places. */
static void index_move(struct index *x, uint32_t *order)
{
    for (size_t i = 0; i < x->n; i++) {
        if (order[i] == i)
            continue;
        const struct store_tile tile = x->tiles[i];
        const struct index_shape shape = x->shapes[i];
        size_t to = i;
        for (size_t from; (from = order[to]) != i; to = from) {
            x->tiles[to] = x->tiles[from];
            x->shapes[to] = x->shapes[from];
            order[to] = (uint32_t)to;
        }
        x->tiles[to] = tile;
        x->shapes[to] = shape;
        order[to] = (uint32_t)to;
    }
}

enum err_code index_sort(struct index *x, struct err *e)
{
    bool sorted = true;
    for (size_t i = 1; sorted && i < x->n; i++)
        sorted = key_compare(x->tiles[i - 1].key, x->tiles[i].key) <= 0;
    if (sorted)
        return ERR_OK;
    uint32_t *order = mem_uninit(x->n, sizeof *order);
    if (!order)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", x->n);
    enum err_code rc = index_order(x, order, e);
    if (!rc)
        index_move(x, order);
    mem_free(order);
    return rc;
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
    index_unpack(x, x->tiles[i].level, p, &s);
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

double index_sigma_median_m(const struct index *x, size_t i)
{
    const struct index_shape *p = &x->shapes[i];
    return index_is_whole(p) ? x->whole[p->center_enu_m[0]].sigma_median_m : index_unpack_sigma(p);
}
