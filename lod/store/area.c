/* Which part of a store was surveyed: see area.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/area.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lod/store/tree.h"

enum { AREA_EDGES_MAX = 100000 };

struct area_weight {
    double sigma_m;
    uint64_t count;
};

static int area_compare(const void *a, const void *b)
{
    const struct area_weight *x = a, *y = b;
    return (x->sigma_m > y->sigma_m) - (x->sigma_m < y->sigma_m);
}

/* Sorts sigmas into bins by their sign, exponent and four bits more; or all into one. */
enum { AREA_BINS = 1 << 16 };
static size_t area_bin(double sigma_m, size_t bins)
{
    uint64_t bits;
    memcpy(&bits, &sigma_m, sizeof bits);
    if (bins == 1)
        return 0;
    return (size_t)(bits >> 63 ? ~bits >> 48 : bits >> 48 | AREA_BINS / 2);
}

/* The tiles that count, one after the other from *i on; false: no more. */
static bool area_next(const struct store *s, size_t *i, struct area_weight *w)
{
    size_t n;
    const struct store_tile *tiles = store_tiles(s, &n);
    for (; *i < n; ++*i)
        if (tree_leaf(store_tree(s), *i) && tiles[*i].count > 0) {
            *w = (struct area_weight){index_sigma_median_m(store_tree(s)->index, *i),
                                      tiles[*i].count};
            ++*i;
            return true;
        }
    return false;
}

/* The median over leaves, each counted by its Gaussians. A million tiles are not sorted for it:
 * only those in the bin where it is. Of few tiles, sorting costs less than a megabyte of bins. */
static enum err_code area_sigma(const struct store *s, double *out, struct err *e)
{
    enum { FEW = 4096 };
    size_t n;
    (void)store_tiles(s, &n);
    const size_t bins = n > FEW ? AREA_BINS : 1;
    struct area_bin {
        uint64_t count;
        size_t tiles;
    } *bin = mem_array(bins, sizeof *bin);
    struct area_weight *w = NULL, one;
    uint64_t total = 0, sum = 0;
    size_t at = 0, used = 0;
    *out = 0.0;
    for (size_t i = 0; bin && area_next(s, &i, &one); total += one.count) {
        bin[area_bin(one.sigma_m, bins)].count += one.count;
        bin[area_bin(one.sigma_m, bins)].tiles++;
    }
    if (bin && total) {
        while (2 * (sum + bin[at].count) < total)
            sum += bin[at++].count;
        w = mem_uninit(bin[at].tiles, sizeof *w);
    }
    mem_free(bin);
    if (!bin || (total && !w))
        return err_set(e, ERR_MEM, "out of memory for the tiles' sizes");
    if (!total)
        return err_set(e, ERR_DATA, "the store has no Gaussians: nothing to survey");
    for (size_t i = 0; area_next(s, &i, &one);)
        if (area_bin(one.sigma_m, bins) == at)
            w[used++] = one;
    qsort(w, used, sizeof *w, area_compare);
    for (size_t i = 0; i < used && 2 * sum < total; i++) {
        sum += w[i].count;
        *out = w[i].sigma_m;
    }
    mem_free(w);
    return *out > 0.0 && isfinite(*out)
               ? ERR_OK
               : err_set(e, ERR_DATA,
                         "the store's Gaussians have a median size of %g m: nothing to survey",
                         *out);
}

static void area_add(struct area *a, const struct store_shape *t)
{
    bool first = a->n_in++ == 0;
    /* A core of zeros is not known: the box then. */
    bool core = t->core_max_enu_m[2] > t->core_min_enu_m[2];
    double lo = core ? t->core_min_enu_m[2] : t->min_enu_m[2],
           hi = core ? t->core_max_enu_m[2] : t->max_enu_m[2];
    a->floor_m = first ? lo : fmin(a->floor_m, lo);
    a->ceiling_m = first ? hi : fmax(a->ceiling_m, hi);
}

struct area_span { /* the tiles of a zoom */
    uint32_t west, north, east, south;
    bool any;
};

static void area_widen(struct area_span *s, struct key k)
{
    s->west = s->any && s->west < k.x ? s->west : k.x;
    s->north = s->any && s->north < k.y ? s->north : k.y;
    s->east = s->any && s->east > k.x ? s->east : k.x;
    s->south = s->any && s->south > k.y ? s->south : k.y;
    s->any = true;
}

/* Degrees of the corners only: the sines of a million tiles take a tenth of a second. */
static void area_bound(struct area *a, const struct area_span span[KEY_ZOOM_MAX + 1])
{
    bool first = true;
    for (size_t z = 0; z <= KEY_ZOOM_MAX; z++) {
        double west, south, east, north, at[2];
        if (!span[z].any)
            continue;
        const struct key nw = {(uint8_t)z, span[z].west, span[z].north},
                         se = {(uint8_t)z, span[z].east, span[z].south};
        key_bounds(nw, &west, &at[0], &at[1], &north);
        key_bounds(se, &at[0], &south, &east, &at[1]);
        a->west_deg = first ? west : fmin(a->west_deg, west);
        a->south_deg = first ? south : fmin(a->south_deg, south);
        a->east_deg = first ? east : fmax(a->east_deg, east);
        a->north_deg = first ? north : fmax(a->north_deg, north);
        first = false;
    }
}

/* ---- outlines ---- */

struct area_box { /* degrees */
    double west, south, east, north;
};

/* One ring of GeoJSON positions; false: it is none. */
static bool area_add_ring(struct area *a, const json_t *ring, size_t polygon, size_t *room,
                          struct area_box *box)
{
    size_t n = json_array_size(ring);
    if (n < 4 || n > *room)
        return false;
    for (size_t i = 0; i + 1 < n; i++) {
        struct geojson_edge *edge = &a->edges[a->n_edges++];
        edge->polygon = polygon;
        for (size_t k = 0; k < 2; k++) {
            const json_t *at = json_array_get(ring, i + k);
            double lon = json_number_value(json_array_get(at, 0)),
                   lat = json_number_value(json_array_get(at, 1));
            if (!json_is_number(json_array_get(at, 1)) || !(fabs(lon) <= 180) || !(fabs(lat) <= 85))
                return false;
            key_place(lon, lat, k ? edge->to : edge->from);
            box->west = fmin(box->west, lon);
            box->east = fmax(box->east, lon);
            box->south = fmin(box->south, lat);
            box->north = fmax(box->north, lat);
        }
    }
    *room -= n;
    return true;
}

static size_t area_corners(const json_t *polygons)
{
    size_t n = 0;
    for (size_t i = 0; i < json_array_size(polygons); i++)
        for (size_t r = 0; r < json_array_size(json_array_get(polygons, i)); r++)
            n += json_array_size(json_array_get(json_array_get(polygons, i), r));
    return n;
}

static void area_narrow(struct area *a, const struct area_box *box, bool footprint)
{
    a->west_deg = footprint ? box->west : fmax(a->west_deg, box->west);
    a->south_deg = footprint ? box->south : fmax(a->south_deg, box->south);
    a->east_deg = footprint ? box->east : fmin(a->east_deg, box->east);
    a->north_deg = footprint ? box->north : fmin(a->north_deg, box->north);
}

/* A Feature with a MultiPolygon as one more outline. *ok false: it is none, and nothing has
 * changed. */
static enum err_code area_add_layer(struct area *a, const json_t *feature, bool footprint, bool *ok,
                                    struct err *e)
{
    const json_t *shape = json_object_get(feature, "geometry"),
                 *polygons = json_object_get(shape, "coordinates");
    const char *type = json_string_value(json_object_get(shape, "type"));
    struct area_box box = {180, 90, -180, -90};
    size_t n = type && !strcmp(type, "MultiPolygon") ? area_corners(polygons) : 0, room = n,
           before = a->n_edges;
    *ok = n >= 4 && n + before <= AREA_EDGES_MAX && a->n_layers < AREA_LAYERS_MAX;
    if (!*ok)
        return ERR_OK;
    struct geojson_edge *edges = mem_resize(a->edges, before, before + n, sizeof *edges);
    if (!edges)
        return err_set(e, ERR_MEM, "out of memory for an outline of %zu corners", n);
    a->edges = edges;
    for (size_t i = 0; *ok && i < json_array_size(polygons); i++) {
        const json_t *polygon = json_array_get(polygons, i);
        for (size_t r = 0; *ok && r < json_array_size(polygon); r++)
            *ok = area_add_ring(a, json_array_get(polygon, r), i, &room, &box);
    }
    if (!*ok) {
        a->n_edges = before;
        return ERR_OK;
    }
    a->layer[++a->n_layers] = a->n_edges;
    area_narrow(a, &box, footprint);
    return ERR_OK;
}

/* The footprint that training wrote. One that makes no sense is left out, as if there were none:
 * store_open has warned of a text that is no JSON. */
static enum err_code area_read_footprint(struct area *a, const char *text, struct err *e)
{
    json_t *root = text ? json_loads(text, 0, NULL) : NULL;
    bool ok = false;
    enum err_code rc = root ? area_add_layer(a, root, true, &ok, e) : ERR_OK;
    double px_per_m =
        json_number_value(json_object_get(json_object_get(root, "properties"), "pixels_per_m"));
    a->by_tiles = !ok;
    if (ok && px_per_m > 0 && isfinite(1 / px_per_m))
        a->gsd_m = 1 / px_per_m;
    if (text && !rc && !ok)
        log_warn("store", "the footprint is no MultiPolygon of places: what was surveyed is taken "
                          "from the tiles");
    json_decref(root);
    return rc;
}

/* What clip_store wrote. */
static enum err_code area_read_clip(struct area *a, const char *text, struct err *e)
{
    json_t *root = text ? json_loads(text, 0, NULL) : NULL;
    const json_t *list = json_object_get(root, "features");
    bool ok = true;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && ok && i < json_array_size(list); i++)
        rc = area_add_layer(a, json_array_get(list, i), false, &ok, e);
    if (!rc && !ok)
        log_warn("store",
                 "what it was clipped to is no list of at most %d MultiPolygons: maps show "
                 "the tiles' ground",
                 AREA_LAYERS_MAX - 1);
    json_decref(root);
    return rc;
}

enum err_code area_make(const struct store *s, struct area *out, struct err *e)
{
    struct area a = {.store = s};
    size_t n;
    const struct store_tile *tiles = store_tiles(s, &n);
    enum err_code rc = area_sigma(s, &a.sigma_m, e);
    if (!rc && !(a.in = mem_array(n, sizeof *a.in)))
        rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    const struct index *x = store_tree(s)->index;
    struct area_span span[KEY_ZOOM_MAX + 1] = {0};
    for (size_t i = 0; !rc && i < n; i++) {
        a.in[i] = tree_leaf(store_tree(s), i) && tiles[i].count > 0 &&
                  index_sigma_median_m(x, i) <= AREA_COARSE * a.sigma_m;
        if (a.in[i]) {
            const struct store_shape shape = index_bounds(x, i);
            area_add(&a, &shape);
            area_widen(&span[tiles[i].key.z], tiles[i].key);
        }
    }
    area_bound(&a, span);
    if (!rc)
        rc = area_read_footprint(&a, store_footprint(s), e);
    if (!rc)
        rc = area_read_clip(&a, store_clip(s), e);
    if (!rc && !a.n_edges) { /* of outlines that made no sense */
        mem_free(a.edges);
        a.edges = NULL;
    }
    if (rc)
        area_free(&a);
    *out = a;
    return rc;
}

void area_free(struct area *a)
{
    mem_free(a->in);
    mem_free(a->edges);
    *a = (struct area){0};
}

/* ---- places ---- */

static bool area_tile_holds(const struct area *a, struct key k)
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

bool area_holds(const struct area *a, double lon_deg, double lat_deg)
{
    double at[2];
    bool in = !a->by_tiles ||
              area_tile_holds(a, key_at(lon_deg, lat_deg, store_info(a->store)->zoom_max));
    key_place(lon_deg, lat_deg, at);
    for (size_t l = 0; in && l < a->n_layers; l++)
        in = geojson_holds(a->edges + a->layer[l], a->layer[l + 1] - a->layer[l], at[0], at[1]);
    return in;
}

bool area_touches(const struct area *a, struct key k)
{
    double west, south, east, north;
    key_bounds(k, &west, &south, &east, &north);
    return west < a->east_deg && east > a->west_deg && south < a->north_deg && north > a->south_deg;
}

bool area_is_near(const struct area *a, struct key k, double margin)
{
    double nw[2], se[2], n = ldexp(1, k.z);
    key_place(a->west_deg, a->north_deg, nw);
    key_place(a->east_deg, a->south_deg, se);
    return k.x - margin < se[0] * n && k.x + 1 + margin > nw[0] * n && k.y - margin < se[1] * n &&
           k.y + 1 + margin > nw[1] * n;
}

static void area_mask_tiles(const struct area *a, const double corner[8], uint32_t w, uint32_t h,
                            uint8_t *in)
{
    uint8_t zoom = store_info(a->store)->zoom_max;
    double n = ldexp(1, zoom);
    struct key last = {.z = UINT8_MAX};
    uint8_t held = 0;
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++) {
            double s = (x + 0.5) / w, t = (y + 0.5) / h, at[2];
            for (size_t k = 0; k < 2; k++)
                at[k] = (1 - t) * ((1 - s) * corner[k] + s * corner[2 + k]) +
                        t * ((1 - s) * corner[4 + k] + s * corner[6 + k]);
            struct key key = {zoom, (uint32_t)fmin(fmax(at[0] * n, 0), n - 1),
                              (uint32_t)fmin(fmax(at[1] * n, 0), n - 1)};
            if (key_compare(key, last)) {
                held = area_tile_holds(a, key);
                last = key;
            }
            in[(size_t)y * w + x] = held;
        }
}

enum { AREA_TURN = 2, AREA_IN = 4 }; /* beside the 1 of what is held */

/* A polygon's crossings become its pixels. */
static void area_mask_polygon(uint32_t w, uint8_t *in)
{
    bool inside = false;
    for (uint32_t x = 0; x < w; x++) {
        inside ^= (in[x] & AREA_TURN) != 0;
        in[x] = (uint8_t)((in[x] & ~AREA_TURN) | (inside ? AREA_IN : 0));
    }
}

/* One row. Of a polygon every edge that the row crosses turns what lies right of the crossing. What
 * is in none of the outline's polygons goes. */
static void area_mask_row(const struct area *a, size_t layer, const double left[2],
                          const double right[2], uint32_t w, uint8_t *in)
{
    double d[2] = {right[0] - left[0], right[1] - left[1]}, length2 = d[0] * d[0] + d[1] * d[1];
    bool crossed = false;
    for (size_t i = a->layer[layer]; i < a->layer[layer + 1]; i++) {
        const double *p = a->edges[i].from, *q = a->edges[i].to;
        double p_side = d[0] * (p[1] - left[1]) - d[1] * (p[0] - left[0]),
               q_side = d[0] * (q[1] - left[1]) - d[1] * (q[0] - left[0]);
        if (crossed && a->edges[i].polygon != a->edges[i - 1].polygon) {
            area_mask_polygon(w, in);
            crossed = false;
        }
        if ((p_side > 0) == (q_side > 0))
            continue;
        double t = p_side / (p_side - q_side), u = p[0] + t * (q[0] - p[0]),
               v = p[1] + t * (q[1] - p[1]);
        double x = ceil((d[0] * (u - left[0]) + d[1] * (v - left[1])) / length2 * w - 0.5);
        if (x < w) {
            in[x > 0 ? (size_t)x : 0] ^= AREA_TURN;
            crossed = true;
        }
    }
    if (crossed)
        area_mask_polygon(w, in);
    for (uint32_t x = 0; x < w; x++)
        in[x] = (in[x] & 1) && (in[x] & AREA_IN);
}

size_t area_mask(const struct area *a, const double corner[8], uint32_t w, uint32_t h, uint8_t *in)
{
    size_t n = 0;
    if (a->by_tiles)
        area_mask_tiles(a, corner, w, h, in);
    else
        memset(in, 1, (size_t)w * h);
    for (uint32_t y = 0; a->n_layers && y < h; y++) {
        double t = (y + 0.5) / h, left[2], right[2];
        for (size_t k = 0; k < 2; k++) {
            left[k] = (1 - t) * corner[k] + t * corner[4 + k];
            right[k] = (1 - t) * corner[2 + k] + t * corner[6 + k];
        }
        for (size_t l = 0; l < a->n_layers; l++)
            area_mask_row(a, l, left, right, w, in + (size_t)y * w);
    }
    for (size_t i = 0; i < (size_t)w * h; i++)
        n += in[i];
    return n;
}
