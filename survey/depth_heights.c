/* Heights of known depths: see depth_heights.h.
 *
 * Maps of all photographs do not fit into memory, so the map is made in bands of rows. A first walk
 * over the maps counts samples of each row; every band then reads the maps again that reach into
 * it. The key of a sample is its cell and its height, so that one sort groups cells and orders the
 * heights of each.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/depth_heights.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "codec/container/npy.h"
#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/geo/geo.h"
#include "core/geo/heights.h"
#include "core/math/sort.h"
#include "core/splat/camera.h"

enum {
    NODES = 17,        /* of the table of places, an axis */
    SAMPLES = 8 << 20, /* in memory at a time */
    OUTLINE_SAMPLES = 4 << 20,
    HEIGHT_BITS = 24,   /* of a key, in millimetres */
    OUTLINE_EVERY = 61, /* of the samples, at first, that the outline is taken from */
    DEEP = 100,         /* least number of them */
    LAYER_SHARE = 3,    /* a dense layer has a third of the densest */
    LAYER_LEAST = 2,
    BAND_PX = 2, /* pixels of a band for each of its samples, at most; one row is always taken */
};
static const double outline_share = 0.002; /* of samples that lie beyond each edge of the map */
static const double below_m = 100.0; /* heights begin so far below the lowest of the outline */
static const double layer_px = 2.0;  /* height of a layer, in pixels of the map */

struct heights_job {
    const struct depth_heights_request *r;
    const struct scene *scene;
    const char *dir;
    struct crs *crs;
    double low[2], span[2];        /* of the table, ENU m */
    double place[NODES][NODES][3]; /* projected east, north; height above ENU's up */
    double base_m;                 /* heights are counted from */
    struct map_grid grid;
    uint64_t *row_samples; /* [grid.height] */
    uint32_t (*rows)[2];   /* [n_images] first row of the map, and the row behind the last */
    struct map_report report;
};
/* What a walk does with the samples of photograph `image`. */
struct heights_visitor {
    void (*use)(void *user, size_t image, const double enu_m[3], double footprint_m);
    void *user;
};

/* ---- samples ---- */

static enum err_code heights_map(const struct heights_job *j, size_t image, size_t shape[2],
                                 float **inverse, bool *found, struct err *e)
{
    char path[FILE_PATH_MAX], name[FILE_PATH_MAX];
    int k = snprintf(name, sizeof name, "%s.npy", j->scene->images[image].name);
    *inverse = NULL;
    *found = false;
    if (k < 0 || (size_t)k >= sizeof name)
        return err_set(e, ERR_LIMIT, "dsm: the name of photograph %zu is too long", image);
    enum err_code rc = file_join(path, j->dir, name, e);
    if (rc || !file_exists(path))
        return rc;
    *found = true;
    rc = npy_read(path, 2, shape, inverse, e);
    if (!rc && (shape[0] < 1 || shape[1] < 1 || shape[0] > UINT16_MAX || shape[1] > UINT16_MAX))
        rc =
            err_set(e, ERR_FORMAT, "%s: a depth map of shape (%zu, %zu)", path, shape[0], shape[1]);
    if (!rc)
        return ERR_OK;
    mem_free(*inverse);
    *inverse = NULL;
    return rc;
}

static enum err_code heights_photograph(const struct heights_job *j, size_t image,
                                        const struct heights_visitor *v, size_t *maps,
                                        struct err *e)
{
    size_t shape[2] = {0, 0};
    float *inverse;
    bool found;
    double eye[3];
    enum err_code rc = heights_map(j, image, shape, &inverse, &found, e);
    if (rc || !found)
        return rc;
    const struct camera c =
        camera_resize(&j->scene->images[image].cam, (uint32_t)shape[1], (uint32_t)shape[0]);
    camera_center(&c, eye);
    for (size_t i = 0; i < shape[0] * shape[1]; i++) {
        double w = (double)inverse[i], enu[3];
        if (!(w > 0.0) || !isfinite(w))
            continue;
        double depth = 1.0 / w, a = ((double)(i % shape[1]) + 0.5 - c.cx_px) / c.fx_px,
               b = ((double)(i / shape[1]) + 0.5 - c.cy_px) / c.fy_px;
        for (int k = 0; k < 3; k++)
            enu[k] = eye[k] + depth * (c.rot[k] * a + c.rot[3 + k] * b + c.rot[6 + k]);
        v->use(v->user, image, enu, depth / c.fx_px);
    }
    mem_free(inverse);
    ++*maps;
    return ERR_OK;
}

/* Visits the samples of all photographs, or of those that reach into a band of rows. */
static enum err_code heights_walk(const struct heights_job *j, const uint32_t band[2],
                                  const struct heights_visitor *v, size_t *maps, struct err *e)
{
    enum err_code rc = ERR_OK;
    *maps = 0;
    for (size_t i = 0; !rc && i < j->scene->n_images; i++) {
        if (band && (j->rows[i][1] <= band[0] || j->rows[i][0] >= band[1]))
            continue;
        rc = signals_stopping() ? err_set(e, ERR_CANCEL, "stopped")
                                : heights_photograph(j, i, v, maps, e);
    }
    return rc;
}

/* ---- the map's area ---- */

struct outline { /* every `every`-th sample; that doubles when there would be too many */
    uint64_t seen, every;
    double *axis[4]; /* east, north, up, footprint */
    size_t n;
};

static void outline_take(void *user, size_t image, const double enu_m[3], double footprint_m)
{
    struct outline *o = user;
    (void)image;
    if (o->seen++ % o->every)
        return;
    if (o->n == OUTLINE_SAMPLES) { /* every second of those that are there, and from now on */
        o->n /= 2;
        o->every *= 2;
        for (size_t i = 0; i < o->n; i++)
            for (int k = 0; k < 4; k++)
                o->axis[k][i] = o->axis[k][2 * i];
    }
    for (int k = 0; k < 3; k++)
        o->axis[k][o->n] = enu_m[k];
    o->axis[3][o->n++] = footprint_m;
}

static double outline_at(const double *sorted, size_t n, double share)
{
    return sorted[(size_t)(share * (double)(n - 1) + 0.5)];
}

/* The table of places. Between 17 places an axis the earth bends by less than a millimetre over a
 * survey of 3 km, and by 3 cm over one of 20 km. */
static enum err_code heights_table(struct heights_job *j, double up_m, struct err *e)
{
    for (size_t v = 0; v < NODES; v++)
        for (size_t u = 0; u < NODES; u++) {
            double *p = j->place[v][u];
            const double enu[3] = {j->low[0] + j->span[0] * (double)u / (NODES - 1),
                                   j->low[1] + j->span[1] * (double)v / (NODES - 1), up_m};
            enum err_code rc = geo_from_enu(&j->scene->origin, enu, &p[0], &p[1], &p[2], e);
            if (rc)
                return rc;
            p[2] -= up_m;
            if (j->r->geoid)
                p[2] -= geoid_above(j->r->geoid, p[0], p[1]);
            rc = crs_project(j->crs, 1, &p[0], &p[1], e);
            if (rc)
                return rc;
        }
    return ERR_OK;
}

/* Column, row and height. False: not on the map. */
static bool heights_place(const struct heights_job *j, const double enu_m[3], uint32_t cell[2],
                          double *height_m)
{
    double at[3] = {0, 0, 0}, t[2];
    size_t node[2];
    for (int k = 0; k < 2; k++) {
        t[k] = (enu_m[k] - j->low[k]) / j->span[k] * (NODES - 1);
        if (!(t[k] >= 0.0 && t[k] < NODES - 1))
            return false;
        node[k] = (size_t)t[k];
        t[k] -= (double)node[k];
    }
    for (size_t c = 0; c < 4; c++) {
        double w = (c & 1 ? t[0] : 1 - t[0]) * (c & 2 ? t[1] : 1 - t[1]);
        for (int k = 0; k < 3; k++)
            at[k] += w * j->place[node[1] + (c >> 1)][node[0] + (c & 1)][k];
    }
    double x = floor((at[0] - j->grid.west_m) / j->grid.pixel_m),
           y = floor((j->grid.north_m - at[1]) / j->grid.pixel_m);
    if (!(x >= 0 && y >= 0 && x < j->grid.width && y < j->grid.height))
        return false;
    cell[0] = (uint32_t)x;
    cell[1] = (uint32_t)y;
    *height_m = at[2] + enu_m[2];
    double mm = (*height_m - j->base_m) * 1000.0;
    return mm >= 0.0 && mm < (double)(1 << HEIGHT_BITS);
}

/* Where the map lies: the box of the samples without the outermost. */
static enum err_code heights_box(struct heights_job *j, const struct outline *o, double up_m,
                                 double box[4], struct err *e)
{
    double lon[4], lat[4], h;
    enum err_code rc = ERR_OK;
    for (int k = 0; k < 2; k++) {
        double lo = outline_at(o->axis[k], o->n, outline_share),
               hi = outline_at(o->axis[k], o->n, 1 - outline_share);
        j->low[k] = lo - 1.0;
        j->span[k] = hi - lo + 2.0;
    }
    for (size_t c = 0; !rc && c < 4; c++) {
        const double enu[3] = {j->low[0] + (c & 1 ? j->span[0] : 0),
                               j->low[1] + (c & 2 ? j->span[1] : 0), up_m};
        rc = geo_from_enu(&j->scene->origin, enu, &lon[c], &lat[c], &h, e);
    }
    if (rc)
        return rc;
    j->grid.epsg =
        j->r->epsg ? j->r->epsg : crs_utm(0.5 * (lon[0] + lon[3]), 0.5 * (lat[0] + lat[3]));
    rc = crs_open(j->grid.epsg, &j->crs, e);
    for (size_t c = 0; j->r->bbox_deg && c < 4; c++) {
        lon[c] = j->r->bbox_deg[c & 1 ? 2 : 0];
        lat[c] = j->r->bbox_deg[c & 2 ? 3 : 1];
    }
    if (!rc)
        rc = crs_project(j->crs, 4, lon, lat, e);
    box[0] = box[1] = HUGE_VAL;
    box[2] = box[3] = -HUGE_VAL;
    for (size_t c = 0; c < 4; c++) {
        box[0] = fmin(box[0], lon[c]);
        box[1] = fmin(box[1], lat[c]);
        box[2] = fmax(box[2], lon[c]);
        box[3] = fmax(box[3], lat[c]);
    }
    return rc;
}

static enum err_code heights_grid(struct heights_job *j, struct outline *o, struct err *e)
{
    double box[4], up_m, gsd_m = j->r->gsd_m;
    for (int k = 0; k < 4; k++)
        sort_doubles(o->axis[k], o->n);
    up_m = outline_at(o->axis[2], o->n, 0.5);
    if (!(gsd_m > 0))
        gsd_m = map_fine(outline_at(o->axis[3], o->n, 0.5));
    enum err_code rc = heights_box(j, o, up_m, box, e);
    int epsg = j->grid.epsg, vertical = j->r->geoid ? crs_vertical(geoid_name(j->r->geoid))
                                                    : heights_epsg(j->scene->heights);
    if (!rc)
        rc = map_grid_make(box, gsd_m, &j->grid, e);
    j->grid.epsg = epsg;
    if (!rc && vertical)
        rc = crs_set_vertical(j->crs, vertical, e);
    if (!rc)
        rc = heights_table(j, up_m, e);
    j->base_m =
        outline_at(o->axis[2], o->n, outline_share) + j->place[NODES / 2][NODES / 2][2] - below_m;
    return rc;
}

static enum err_code heights_plan(struct heights_job *j, struct err *e)
{
    struct outline o = {.every = OUTLINE_EVERY};
    const struct heights_visitor take = {outline_take, &o};
    size_t maps;
    double *all = mem_array(4 * (size_t)OUTLINE_SAMPLES, sizeof *all);
    if (!all)
        return err_set(e, ERR_MEM, "dsm: out of memory for %d samples", OUTLINE_SAMPLES);
    for (size_t k = 0; k < 4; k++)
        o.axis[k] = all + k * OUTLINE_SAMPLES;
    enum err_code rc = heights_walk(j, NULL, &take, &maps, e);
    if (!rc && o.n < DEEP)
        rc =
            err_set(e, ERR_NOENT, "dsm: no known depths in %s; make them with: citysplat stereo %s",
                    j->dir, j->r->scene);
    if (!rc)
        rc = heights_grid(j, &o, e);
    mem_free(all);
    return rc;
}

/* ---- bands ---- */

static void heights_count(void *user, size_t image, const double enu_m[3], double footprint_m)
{
    struct heights_job *j = user;
    uint32_t cell[2], *rows = j->rows[image];
    double height;
    (void)footprint_m;
    if (!heights_place(j, enu_m, cell, &height))
        return;
    j->row_samples[cell[1]]++;
    if (!rows[1] || rows[0] > cell[1])
        rows[0] = cell[1];
    if (rows[1] <= cell[1])
        rows[1] = cell[1] + 1;
}

struct band {
    const struct heights_job *job;
    uint32_t rows[2];
    struct sort_item *items, *scratch;
    size_t n, cap;
    float *pairs; /* [rows][grid.width][2] */
};

static void band_gather(void *user, size_t image, const double enu_m[3], double footprint_m)
{
    struct band *b = user;
    const struct heights_job *j = b->job;
    uint32_t cell[2];
    double height;
    (void)image;
    (void)footprint_m;
    if (!heights_place(j, enu_m, cell, &height) || cell[1] < b->rows[0] || cell[1] >= b->rows[1] ||
        b->n == b->cap)
        return;
    uint64_t at = (uint64_t)(cell[1] - b->rows[0]) * j->grid.width + cell[0],
             mm = (uint64_t)((height - j->base_m) * 1000.0);
    b->items[b->n++].key = at << HEIGHT_BITS | mm;
}

static double band_height(const struct sort_item *item)
{
    return (double)(item->key & ((1 << HEIGHT_BITS) - 1));
}

/* Height and scatter of a cell's heights, ascending, in mm. False: no layer is dense. */
static bool band_cell(const struct sort_item *items, size_t n, double layer_mm, double out[2])
{
    size_t most = 0, first = 0, last = 0;
    for (size_t i = 0, end = 0; i < n; i++) {
        while (end < n && band_height(&items[end]) <= band_height(&items[i]) + layer_mm)
            end++;
        most = end - i > most ? end - i : most;
    }
    size_t share = (most + LAYER_SHARE - 1) / LAYER_SHARE,
           least = share > LAYER_LEAST ? share : LAYER_LEAST;
    if (most < LAYER_LEAST)
        return false;
    for (size_t i = 0, end = 0; i < n; i++) { /* the last one that is dense is the highest */
        while (end < n && band_height(&items[end]) <= band_height(&items[i]) + layer_mm)
            end++;
        if (end - i >= least && end > last) {
            first = i;
            last = end;
        }
    }
    size_t middle = first + (last - first) / 2, lo = middle, hi = middle;
    out[0] =
        0.5 * (band_height(&items[middle]) + band_height(&items[first + (last - first - 1) / 2]));
    /* The median of distances to the median: grow to both sides until half of them are inside. */
    while (2 * (hi - lo + 1) < last - first) {
        bool down = lo > first && (hi + 1 == last || out[0] - band_height(&items[lo - 1]) <=
                                                         band_height(&items[hi + 1]) - out[0]);
        lo -= down;
        hi += !down;
    }
    out[1] = 1.4826 * fmax(out[0] - band_height(&items[lo]), band_height(&items[hi]) - out[0]);
    return true;
}

static void band_fill(struct band *b, struct map_report *report)
{
    const struct heights_job *j = b->job;
    size_t pixels = (size_t)(b->rows[1] - b->rows[0]) * j->grid.width;
    for (size_t i = 0; i < 2 * pixels; i++)
        b->pairs[i] = GEOTIFF_NODATA;
    for (size_t i = 0, end = 0; i < b->n; i = end) {
        uint64_t at = b->items[i].key >> HEIGHT_BITS;
        double mm[2];
        while (end < b->n && b->items[end].key >> HEIGHT_BITS == at)
            end++;
        if (!band_cell(b->items + i, end - i, 1000.0 * layer_px * j->grid.pixel_m, mm))
            continue;
        double height = j->base_m + 0.001 * mm[0];
        b->pairs[2 * at] = (float)height;
        b->pairs[2 * at + 1] = (float)(0.001 * mm[1]);
        report->pixels_held++;
        report->height_min_m = fmin(report->height_min_m, height);
        report->height_max_m = fmax(report->height_max_m, height);
    }
}

static void band_free(struct band *b)
{
    mem_free(b->items);
    mem_free(b->scratch);
    mem_free(b->pairs);
}

static enum err_code band_run(struct heights_job *j, struct band *b, struct geotiff *file,
                              struct err *e)
{
    const struct heights_visitor gather = {band_gather, b};
    uint32_t rows = b->rows[1] - b->rows[0];
    size_t maps;
    b->items = mem_array(b->cap + 1, sizeof *b->items);
    b->scratch = mem_array(b->cap + 1, sizeof *b->scratch);
    b->pairs = mem_array((size_t)rows * j->grid.width, 2 * sizeof *b->pairs);
    if (!b->items || !b->scratch || !b->pairs) {
        band_free(b);
        return err_set(e, ERR_MEM, "dsm: out of memory for %zu samples", b->cap);
    }
    enum err_code rc = heights_walk(j, b->rows, &gather, &maps, e);
    if (!rc) {
        sort_items(b->items, b->scratch, b->n);
        band_fill(b, &j->report);
        rc = geotiff_write(file, 0, b->rows[0], j->grid.width, rows, b->pairs, e);
    }
    band_free(b);
    return rc;
}

/* For another row; memory then grows neither with the samples nor with the width of the map. */
static bool band_has_room(const struct band *b, uint32_t row, size_t most)
{
    const struct heights_job *j = b->job;
    return b->cap + j->row_samples[row] <= most &&
           (uint64_t)(row + 1 - b->rows[0]) * j->grid.width <= BAND_PX * most;
}

static enum err_code heights_bands(struct heights_job *j, struct geotiff *file, struct err *e)
{
    const struct heights_visitor count = {heights_count, j};
    const size_t most = j->r->most_samples ? j->r->most_samples : SAMPLES;
    size_t maps;
    struct progress bar;
    j->row_samples = mem_array(j->grid.height, sizeof *j->row_samples);
    j->rows = mem_array(j->scene->n_images, sizeof *j->rows);
    if (!j->row_samples || !j->rows)
        return err_set(e, ERR_MEM, "dsm: out of memory for %u rows", j->grid.height);
    progress_start(&bar, "dsm, rows", j->grid.height);
    enum err_code rc = heights_walk(j, NULL, &count, &maps, e);
    for (uint32_t y = 0; !rc && y < j->grid.height;) {
        struct band b = {.job = j, .rows = {y, y}};
        while (y < j->grid.height && (y == b.rows[0] || band_has_room(&b, y, most)))
            b.cap += j->row_samples[y++];
        b.rows[1] = y;
        rc = band_run(j, &b, file, e);
        progress_step(&bar, y, NULL);
    }
    progress_end(&bar, NULL);
    if (!rc && !j->report.pixels_held)
        rc = err_set(e, ERR_ARG, "dsm: the area is empty: no known depths lie in it");
    return rc;
}

static enum err_code heights_run(struct heights_job *j, const char *path, const char *words,
                                 struct err *e)
{
    struct geotiff *file = NULL;
    enum err_code rc = heights_plan(j, e);
    const struct geotiff_info info = {.crs = j->crs,
                                      .west_m = j->grid.west_m,
                                      .north_m = j->grid.north_m,
                                      .pixel_m = j->grid.pixel_m,
                                      .width = j->grid.width,
                                      .height = j->grid.height,
                                      .copyright = j->scene->attribution,
                                      .source = "known depths of photographs",
                                      .heights = words};
    if (!rc)
        rc = geotiff_create(path, GEOTIFF_SURFACE, &info, &file, e);
    if (!rc)
        rc = heights_bands(j, file, e);
    if (!rc)
        rc = geotiff_commit(&file, e);
    geotiff_close(&file);
    mem_free(j->row_samples);
    mem_free(j->rows);
    crs_close(&j->crs);
    return rc;
}

enum err_code depth_heights_write(const struct depth_heights_request *r, const char *path,
                                  struct map_report *out, char words[100], struct err *e)
{
    struct scene scene = {0};
    char own[FILE_PATH_MAX], datum[HEIGHTS_WORDS_MAX];
    struct heights_job *j = mem_array(1, sizeof *j);
    double start = clock_s();
    if (!j)
        return err_set(e, ERR_MEM, "dsm: out of memory");
    *j = (struct heights_job){.r = r, .scene = &scene, .dir = r->depth ? r->depth : own};
    j->report.height_min_m = HUGE_VAL;
    j->report.height_max_m = -HUGE_VAL;
    enum err_code rc = scene_read(r->scene, &scene, e);
    if (!rc)
        rc = file_join(own, r->scene, "depth", e);
    if (!rc && r->geoid && !heights_ellipsoidal(scene.heights))
        rc = err_set(e, ERR_ARG,
                     "--geoid: heights of this scene count from '%s', not from the ellipsoid, so "
                     "no geoid can be taken off; give --geoid to ingest",
                     scene.heights);
    if (!rc) {
        heights_words(scene.heights, datum);
        if (r->geoid)
            snprintf(words, 100, "height above sea level by %.60s", geoid_name(r->geoid));
        else
            snprintf(words, 100, "height above %s", datum);
        rc = heights_run(j, path, words, e);
    }
    j->report.grid = j->grid;
    j->report.seconds = clock_s() - start;
    if (!rc)
        *out = j->report;
    mem_free(j);
    scene_free(&scene);
    return rc;
}
