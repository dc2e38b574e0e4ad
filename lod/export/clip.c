/* A part of a store: see clip.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/export/clip.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/geo/heights.h"
#include "core/splat/gauss.h"
#include "lod/store/store.h"

enum err_code clip_open(const char *path, double low_m, double high_m, struct clip *out,
                        struct err *e)
{
    *out = (struct clip){.low_m = low_m, .high_m = high_m};
    enum err_code rc =
        low_m < high_m
            ? ERR_OK
            : err_set(e, ERR_DATA, "heights from %g to %g m: the lower must be below the upper",
                      low_m, high_m);
    return !rc && path ? geojson_read(path, &out->area, e) : rc;
}

enum err_code clip_of_ring(const double (*at)[2], size_t n, struct clip *out, struct err *e)
{
    *out = (struct clip){.low_m = -HUGE_VAL, .high_m = HUGE_VAL};
    return geojson_of_ring(at, n, &out->area, e);
}

void clip_free(struct clip *c)
{
    geojson_free(&c->area);
    *c = (struct clip){0};
}

/* ---- what is held ---- */

bool clip_holds(const struct clip *c, double lon_deg, double lat_deg, double h_m)
{
    return h_m >= c->low_m && h_m <= c->high_m &&
           (!c->area.n || geojson_holds(c->area.edges, c->area.n, lon_deg, lat_deg));
}

enum err_code clip_rows(const struct clip *c, const struct geo_origin *origin, struct gauss *g,
                        struct err *e)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        double enu[3], lon, lat, h;
        for (size_t k = 0; k < 3; k++)
            enu[k] = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k];
        enum err_code rc = geo_from_enu(origin, enu, &lon, &lat, &h, e);
        if (rc)
            return rc;
        if (!clip_holds(c, lon, lat, h))
            continue;
        if (n != i)
            gauss_copy_row(g, n, g, i);
        n++;
    }
    g->n = n;
    return ERR_OK;
}

/* ---- what a store says of it ---- */

static json_t *clip_ring_to_json(const struct clip *c, size_t from, size_t end)
{
    json_t *ring = json_array();
    for (size_t i = from; i < end; i++)
        json_array_append_new(
            ring, json_pack("[f, f]", c->area.edges[i].from[0], c->area.edges[i].from[1]));
    json_array_append_new(
        ring, json_pack("[f, f]", c->area.edges[end - 1].to[0], c->area.edges[end - 1].to[1]));
    return ring;
}

static json_t *clip_feature(const struct clip *c)
{
    json_t *polygons = json_array(), *height = json_object();
    for (size_t i = 0, end; i < c->area.n; i = end) {
        for (end = i; end < c->area.n && c->area.edges[end].ring == c->area.edges[i].ring;)
            end++;
        if (!i || c->area.edges[i].polygon != c->area.edges[i - 1].polygon)
            json_array_append_new(polygons, json_array());
        json_array_append_new(json_array_get(polygons, json_array_size(polygons) - 1),
                              clip_ring_to_json(c, i, end));
    }
    if (isfinite(c->low_m))
        json_object_set_new(height, "low_m", json_real(c->low_m));
    if (isfinite(c->high_m))
        json_object_set_new(height, "high_m", json_real(c->high_m));
    return json_pack("{s:s, s:o, s:{s:s, s:o}}", "type", "Feature", "properties", height,
                     "geometry", "type", "MultiPolygon", "coordinates", polygons);
}

/* The blob STORE_CLIP of a part: GeoJSON, with this clip added to the features of `before`, the
 * blob of a store that is a part already, or NULL. A clip without polygons adds nothing. */
static enum err_code clip_describe(const struct clip *c, const char *before, struct buf *out,
                                   struct err *e)
{
    json_t *root = before ? json_loads(before, 0, NULL) : NULL;
    char *text = NULL;
    if (!json_is_array(json_object_get(root, "features"))) {
        json_decref(root);
        root = json_pack("{s:s, s:[]}", "type", "FeatureCollection", "features");
    }
    if (c->area.n && !json_array_append_new(json_object_get(root, "features"), clip_feature(c)))
        text = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(12));
    if (text)
        buf_add(out, text, strlen(text));
    bool failed = c->area.n && !text;
    json_decref(root);
    free(text);
    return failed ? err_set(e, ERR_MEM, "out of memory for a clip of %zu edges", c->area.n)
                  : buf_check(out, e);
}

/* ---- a store ---- */

static enum err_code clip_tile(const struct clip *c, struct store *from,
                               const struct store_tile *tile, struct store *to,
                               struct clip_report *r, struct err *e)
{
    struct gauss g = {0};
    struct buf payload = {0};
    struct store_entry t = {*tile, store_shape(from, tile)};
    enum err_code rc = store_read_gauss(from, tile->key, &g, e);
    size_t n = g.n;
    if (!rc)
        rc = clip_rows(c, &store_info(from)->origin, &g, e);
    if (!rc && g.n == n && n > 0) { /* untouched: not a bit of it changes */
        rc = store_read(from, tile->key, &payload, e);
        if (!rc)
            rc = store_add(to, &t, &payload, e);
        r->n_copied += !rc;
    } else if (!rc && g.n > 0) {
        rc = store_put(to, &t, &g, e);
    }
    if (!rc) {
        r->n_tiles += g.n > 0;
        r->n_kept += g.n;
        r->n_dropped += n - g.n;
    }
    buf_free(&payload);
    gauss_free(&g);
    return rc;
}

static enum err_code clip_blobs(const struct clip *c, struct store *from, struct store *to,
                                struct err *e)
{
    struct arena a = {0};
    char **names;
    size_t n;
    enum err_code rc = store_list_blobs(from, &a, &names, &n, e);
    for (size_t i = 0; !rc && i < n; i++) {
        struct buf b = {0};
        if (c->area.n && !strcmp(names[i], STORE_CLIP))
            continue; /* told anew */
        rc = store_get_blob(from, names[i], &b, e);
        if (!rc)
            rc = store_put_blob(to, names[i], b.data, b.size, e);
        buf_free(&b);
    }
    struct buf told = {0};
    if (!rc && c->area.n)
        rc = clip_describe(c, store_clip(from), &told, e);
    if (!rc && told.size)
        rc = store_put_blob(to, STORE_CLIP, told.data, told.size, e);
    buf_free(&told);
    arena_free(&a);
    return rc;
}

/* Where a store lies, for whoever asked for a part that is none of it. */
static enum err_code clip_nothing(const struct store *s, struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    const struct geo_origin *o = &store_info(s)->origin;
    double west, south, east, north, low = HUGE_VAL, high = -HUGE_VAL,
                                     box[4] = {180, 90, -180, -90};
    char above[HEIGHTS_WORDS_MAX];
    heights_words(store_info(s)->heights, above);
    for (size_t i = 0; i < n; i++) {
        key_bounds(t[i].key, &west, &south, &east, &north);
        if (t[i].key.z != store_info(s)->zoom_max)
            continue;
        box[0] = fmin(box[0], west);
        box[1] = fmin(box[1], south);
        box[2] = fmax(box[2], east);
        box[3] = fmax(box[3], north);
        const struct store_shape x = store_shape(s, &t[i]);
        low = fmin(low, o->h_m + x.min_enu_m[2]);
        high = fmax(high, o->h_m + x.max_enu_m[2]);
    }
    return err_set(e, ERR_DATA,
                   "nothing is left: the store lies within west,south,east,north "
                   "%.6f,%.6f,%.6f,%.6f degrees, from %.0f to %.0f m above %s",
                   box[0], box[1], box[2], box[3], low, high, above);
}

enum err_code clip_store(const struct clip *c, const char *path, const char *name,
                         const char *out_path, struct clip_report *report, struct err *e)
{
    struct store *from = NULL, *to = NULL;
    struct store_meta meta;
    struct progress bar;
    size_t n = 0;
    *report = (struct clip_report){0};
    if (file_same(path, out_path))
        return err_set(e, ERR_ARG, "%s: a store cannot be clipped onto itself", out_path);
    enum err_code rc = store_open(path, &from, e);
    if (rc)
        return rc;
    meta = *store_info(from);
    meta.created[0] = '\0'; /* now */
    if (name && strlen(name) >= sizeof meta.name)
        rc = err_set(e, ERR_ARG, "--name: at most %zu letters", sizeof meta.name - 1);
    else if (name)
        snprintf(meta.name, sizeof meta.name, "%s", name);
    if (!rc)
        rc = store_create(out_path, &meta, &to, e);
    const struct store_tile *tiles = store_tiles(from, &n);
    progress_start(&bar, "clip", n);
    for (size_t i = 0; !rc && i < n; i++) {
        rc = clip_tile(c, from, &tiles[i], to, report, e);
        progress_step(&bar, i + 1, NULL);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    progress_end(&bar, NULL);
    if (!rc && !report->n_tiles)
        rc = clip_nothing(from, e);
    if (!rc)
        rc = clip_blobs(c, from, to, e);
    if (!rc)
        rc = store_commit(&to, e);
    store_close(&to);
    store_close(&from);
    if (!rc)
        rc = store_open(out_path, &from, e);
    if (!rc)
        memcpy(report->revision, store_info(from)->revision, sizeof report->revision);
    store_close(&from);
    return rc;
}
