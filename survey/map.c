/* Maps of a store: see map.h.
 *
 * A piece is drawn in a plane that touches the earth in its middle. Its pixels are rotated and
 * scaled as the projection is there. The error at the piece's corners is checked. For conformal
 * projections such as UTM it is negligible.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/map.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "survey/bare.h"

/* ---- the grid ---- */

/* A box of longitudes and latitudes in the projection: its edges, at 33 places each. */
static enum err_code map_box(const struct crs *c, const double deg[4], double out[4], struct err *e)
{
    enum { STEPS = 33 };
    double x[4 * STEPS], y[4 * STEPS];
    for (size_t i = 0; i < STEPS; i++) {
        double t = (double)i / (STEPS - 1), lon = deg[0] + t * (deg[2] - deg[0]),
               lat = deg[1] + t * (deg[3] - deg[1]);
        const double at[4][2] = {{lon, deg[1]}, {lon, deg[3]}, {deg[0], lat}, {deg[2], lat}};
        for (size_t k = 0; k < 4; k++) {
            x[4 * i + k] = at[k][0];
            y[4 * i + k] = at[k][1];
        }
    }
    enum err_code rc = crs_project(c, 4 * STEPS, x, y, e);
    out[0] = out[1] = HUGE_VAL;
    out[2] = out[3] = -HUGE_VAL;
    for (size_t i = 0; !rc && i < 4 * STEPS; i++) {
        out[0] = fmin(out[0], x[i]);
        out[1] = fmin(out[1], y[i]);
        out[2] = fmax(out[2], x[i]);
        out[3] = fmax(out[3], y[i]);
    }
    return rc;
}

/* The surveyed part of what was asked for, degrees. */
static enum err_code map_area(const struct area *a, const double *bbox, double out[4],
                              struct err *e)
{
    out[0] = bbox ? fmax(bbox[0], a->west_deg) : a->west_deg;
    out[1] = bbox ? fmax(bbox[1], a->south_deg) : a->south_deg;
    out[2] = bbox ? fmin(bbox[2], a->east_deg) : a->east_deg;
    out[3] = bbox ? fmin(bbox[3], a->north_deg) : a->north_deg;
    if (!(out[0] < out[2]) || !(out[1] < out[3]))
        return err_set(e, ERR_ARG,
                       "the area is empty: surveyed is west,south,east,north "
                       "%.6f,%.6f,%.6f,%.6f degrees",
                       a->west_deg, a->south_deg, a->east_deg, a->north_deg);
    return ERR_OK;
}

double map_fine(double gsd_m)
{
    double unit = pow(10, floor(log10(gsd_m)) - 1);
    return unit * floor(gsd_m / unit + 0.5);
}

/* About as fine as the Gaussians are, a round number. */
static double map_gsd(double sigma_m)
{
    double ten = pow(10, floor(log10(sigma_m))), of = sigma_m / ten;
    return ten * (of < 1.5 ? 1 : of < 3.5 ? 2 : of < 7.5 ? 5 : 10);
}

enum err_code map_grid_make(const double box[4], double gsd, struct map_grid *g, struct err *e)
{
    double west = floor(box[0] / gsd), south = floor(box[1] / gsd), east = ceil(box[2] / gsd),
           north = ceil(box[3] / gsd), w = east - west, h = north - south;
    if (w > MAP_EDGE_MAX || h > MAP_EDGE_MAX || w * h > MAP_PIXELS_MAX)
        return err_set(e, ERR_ARG,
                       "%.0f x %.0f px: at most %d along an edge and %.0f in all; from %.3g m a "
                       "pixel on this area fits, or give a smaller --bbox",
                       w, h, MAP_EDGE_MAX, MAP_PIXELS_MAX,
                       gsd * fmax(fmax(w, h) / MAP_EDGE_MAX, sqrt(w * h / MAP_PIXELS_MAX)) * 1.01);
    *g = (struct map_grid){west * gsd,           north * gsd,          gsd,
                           (uint32_t)fmax(w, 1), (uint32_t)fmax(h, 1), 0};
    return ERR_OK;
}

static const char *map_stored_heights(const struct nadir *n)
{
    return store_info(nadir_store(n))->heights;
}

enum err_code map_plan(const struct nadir *n, const struct map_request *r, struct crs **crs,
                       struct map_grid *out, struct err *e)
{
    const struct area *a = nadir_area(n);
    double deg[4], box[4], gsd = r->gsd_m;
    if (!(gsd > 0))
        gsd = a->gsd_m > 0 && !r->coarse ? map_fine(a->gsd_m) : map_gsd(a->sigma_m);
    *crs = NULL;
    enum err_code rc = map_area(a, r->bbox_deg, deg, e);
    if (!rc && r->geoid && !heights_ellipsoidal(map_stored_heights(n)))
        rc = err_set(e, ERR_ARG,
                     "--geoid: heights of this store count from '%s', not from the ellipsoid, so "
                     "no geoid can be taken off; give --geoid to ingest",
                     map_stored_heights(n));
    if (rc)
        return rc;
    int epsg = r->epsg ? r->epsg : crs_utm(0.5 * (deg[0] + deg[2]), 0.5 * (deg[1] + deg[3]));
    rc = crs_open(epsg, crs, e);
    if (!rc)
        rc = map_box(*crs, deg, box, e);
    if (!rc)
        rc = map_grid_make(box, gsd, out, e);
    out->epsg = epsg;
    int vertical =
        r->geoid ? crs_vertical(geoid_name(r->geoid)) : heights_epsg(map_stored_heights(n));
    if (!rc && vertical)
        rc = crs_set_vertical(*crs, vertical, e);
    if (rc)
        crs_close(crs);
    return rc;
}

/* ---- a piece ---- */

struct map_job {
    struct nadir *nadir;
    const struct crs *crs;
    const struct map_request *request;
    const struct map_visitor *visitor;
    struct map_grid grid;
    float *rgb;
    struct surface_maps maps;
    uint8_t *in;      /* surveyed */
    double corner[8]; /* of the piece in the Mercator square, see area_mask */
    struct map_report report;
};

enum err_code map_place(const struct nadir *n, const struct crs *crs, const struct map_grid *g,
                        uint32_t x, uint32_t y, struct nadir_piece *p, double corner[8],
                        double *off_px, struct err *e)
{
    const double w = p->width, h = p->height, at[NADIR_PLACES][2] = {{0.5 * w, 0.5 * h},
                                                                     {w, 0.5 * h},
                                                                     {0.5 * w, h},
                                                                     {0, 0},
                                                                     {w, 0},
                                                                     {0, h},
                                                                     {w, h}};
    double lon[NADIR_PLACES], lat[NADIR_PLACES], off = 0;
    for (size_t i = 0; i < NADIR_PLACES; i++) {
        lon[i] = g->west_m + (x + at[i][0]) * g->pixel_m;
        lat[i] = g->north_m - (y + at[i][1]) * g->pixel_m;
    }
    enum err_code rc = crs_unproject(crs, NADIR_PLACES, lon, lat, e);
    if (!rc)
        rc = nadir_fit(n, lon, lat, p, &off, e);
    if (rc)
        return rc;
    for (size_t i = NADIR_CORNER; i < NADIR_PLACES; i++)
        key_place(lon[i], lat[i], corner + 2 * (i - NADIR_CORNER));
    *off_px = fmax(*off_px, off);
    if (off > MAP_OFF_MAX_PX)
        return err_set(e, ERR_ARG,
                       "EPSG:%d bends or shears a piece of %u px by %.2f px near %.6f,%.6f: use a "
                       "conformal projection, as UTM, or smaller pixels",
                       g->epsg, p->width, off, lon[0], lat[0]);
    return ERR_OK;
}

enum { MAP_SEA_STEPS = 9 }; /* of a piece, at which the geoid is asked */

/* Heights above the geoid, which is smooth: linear between places an eighth of a piece apart. */
static enum err_code map_sea(const struct map_job *j, uint32_t x, uint32_t y, uint32_t w,
                             uint32_t h, struct err *e)
{
    const struct map_grid *g = &j->grid;
    double sea[MAP_SEA_STEPS][MAP_SEA_STEPS];
    for (size_t r = 0; r < MAP_SEA_STEPS; r++)
        for (size_t c = 0; c < MAP_SEA_STEPS; c++) {
            double lon = g->west_m + (x + (double)c / (MAP_SEA_STEPS - 1) * w) * g->pixel_m,
                   lat = g->north_m - (y + (double)r / (MAP_SEA_STEPS - 1) * h) * g->pixel_m;
            enum err_code rc = crs_unproject(j->crs, 1, &lon, &lat, e);
            if (rc)
                return rc;
            sea[r][c] = geoid_above(j->request->geoid, lon, lat);
        }
    for (size_t v = 0; v < h; v++)
        for (size_t u = 0; u < w; u++) {
            double s = ((double)u + 0.5) / w * (MAP_SEA_STEPS - 1),
                   t = ((double)v + 0.5) / h * (MAP_SEA_STEPS - 1);
            size_t c = (size_t)s, r = (size_t)t;
            s -= (double)c;
            t -= (double)r;
            j->maps.height_m[v * w + u] -=
                (float)((1 - t) * ((1 - s) * sea[r][c] + s * sea[r][c + 1]) +
                        t * ((1 - s) * sea[r + 1][c] + s * sea[r + 1][c + 1]));
        }
    return ERR_OK;
}

static void map_count(struct map_job *j, size_t n)
{
    struct map_report *r = &j->report;
    for (size_t i = 0; i < n; i++) {
        double h = (double)j->maps.height_m[i];
        if (!j->in[i])
            j->maps.height_m[i] = NAN;
        if (!j->in[i] || !isfinite(h))
            continue;
        r->pixels_held++;
        r->height_min_m = fmin(r->height_min_m, h);
        r->height_max_m = fmax(r->height_max_m, h);
    }
}

static enum err_code map_piece(struct map_job *j, uint32_t x, uint32_t y, uint32_t size,
                               struct err *e)
{
    const struct map_grid *g = &j->grid;
    struct nadir_piece p = {.width = g->width - x < size ? g->width - x : size,
                            .height = g->height - y < size ? g->height - y : size};
    enum err_code rc = map_place(j->nadir, j->crs, g, x, y, &p, j->corner, &j->report.off_px, e);
    if (rc || !area_mask(nadir_area(j->nadir), j->corner, p.width, p.height, j->in))
        return rc;
    rc = j->visitor->colors_alone ? nadir_draw(j->nadir, &p, j->maps.rgb, j->maps.height_m, e)
                                  : surface_draw(j->nadir, &p, &j->maps, e);
    if (rc)
        return err_add(e, "piece at pixel %u,%u", x, y);
    if (j->request->geoid)
        rc = map_sea(j, x, y, p.width, p.height, e);
    if (rc)
        return rc;
    map_count(j, (size_t)p.width * p.height);
    return j->visitor->piece(j->visitor->user, x, y, p.width, p.height, &j->maps, e);
}

static enum err_code map_draw(struct map_job *j, uint32_t size, struct err *e)
{
    struct progress bar;
    uint64_t done = 0;
    size_t pixels = (size_t)size * size;
    enum err_code rc = ERR_OK;
    j->rgb = mem_array(pixels, 3 * sizeof *j->rgb);
    j->maps.height_m = mem_array(pixels, sizeof *j->maps.height_m);
    j->maps.sigma_m = mem_array(pixels, sizeof *j->maps.sigma_m);
    j->maps.noise_m = mem_array(pixels, sizeof *j->maps.noise_m);
    j->maps.rgb = j->request->kind == GEOTIFF_COLOR ? j->rgb : NULL;
    j->in = mem_array(pixels, 1);
    if (!j->rgb || !j->maps.height_m || !j->maps.sigma_m || !j->maps.noise_m || !j->in)
        return err_set(e, ERR_MEM, "out of memory for a piece of %u px", size);
    progress_start(&bar, j->visitor->what, (uint64_t)j->grid.width * j->grid.height);
    for (uint32_t y = 0; !rc && y < j->grid.height; y += size) {
        uint32_t rows = j->grid.height - y < size ? j->grid.height - y : size;
        for (uint32_t x = 0; !rc && x < j->grid.width; x += size) {
            rc = map_piece(j, x, y, size, e);
            done += (uint64_t)rows * (j->grid.width - x < size ? j->grid.width - x : size);
            progress_step(&bar, done, NULL);
            if (!rc && signals_stopping())
                rc = err_set(e, ERR_CANCEL, "stopped");
        }
    }
    progress_end(&bar, NULL);
    return rc;
}

enum err_code map_run(struct nadir *n, const struct map_request *r, const struct map_visitor *v,
                      struct map_report *report, struct err *e)
{
    struct map_job j = {.nadir = n, .request = r, .visitor = v};
    struct crs *crs = NULL;
    double start = clock_s();
    uint32_t size = r->piece_px ? r->piece_px : MAP_PIECE_PX;
    enum err_code rc = size > NADIR_SIZE_MAX ? err_set(e, ERR_ARG, "pieces of %u px: at most %d",
                                                       size, NADIR_SIZE_MAX)
                                             : map_plan(n, r, &crs, &j.grid, e);
    if (rc)
        return rc;
    j.crs = crs;
    j.report.grid = j.grid;
    j.report.height_min_m = HUGE_VAL;
    j.report.height_max_m = -HUGE_VAL;
    rc = v->begin(v->user, crs, &j.grid, e);
    if (!rc)
        rc = map_draw(&j, size, e);
    if (!rc && j.report.pixels_held == 0)
        rc = err_set(e, ERR_ARG, "the area is empty: nothing of the survey is in it");
    j.report.seconds = clock_s() - start;
    if (!rc && report)
        *report = j.report;
    crs_close(&crs);
    mem_free(j.rgb);
    mem_free(j.maps.height_m);
    mem_free(j.maps.sigma_m);
    mem_free(j.maps.noise_m);
    mem_free(j.in);
    return rc;
}

/* ---- the file ---- */

void map_heights(const struct nadir *n, const struct map_request *r, char out[100])
{
    char words[HEIGHTS_WORDS_MAX];
    heights_words(map_stored_heights(n), words);
    if (r->geoid)
        snprintf(out, 100, "height above sea level by %.60s", geoid_name(r->geoid));
    else
        snprintf(out, 100, "height above %s", words);
}

struct map_file {
    const struct nadir *nadir;
    const struct map_request *request;
    const char *path;
    const struct store_meta *meta;
    struct geotiff *out;
    void *pixels; /* of a piece */
};

static enum err_code map_file_begin(void *user, const struct crs *crs, const struct map_grid *g,
                                    struct err *e)
{
    struct map_file *f = user;
    char source[128], heights[120];
    size_t size = f->request->piece_px ? f->request->piece_px : MAP_PIECE_PX;
    if (!(f->pixels = mem_array(size * size, 8)))
        return err_set(e, ERR_MEM, "out of memory for a piece of %zu px", size);
    snprintf(source, sizeof source, "%s %s", f->meta->name, f->meta->revision);
    map_heights(f->nadir, f->request, heights);
    if (f->request->ground)
        snprintf(heights + strlen(heights), sizeof heights - strlen(heights), ", bare earth");
    const struct geotiff_info info = {.crs = crs,
                                      .west_m = g->west_m,
                                      .north_m = g->north_m,
                                      .pixel_m = g->pixel_m,
                                      .width = g->width,
                                      .height = g->height,
                                      .copyright = f->meta->attribution,
                                      .source = source,
                                      .heights = heights};
    return geotiff_create(f->path,
                          f->request->kind == GEOTIFF_COLOR ? GEOTIFF_COLOR : GEOTIFF_SURFACE,
                          &info, &f->out, e);
}

static uint8_t map_byte(float v)
{
    return (uint8_t)(fminf(fmaxf(v, 0), 1) * 255 + 0.5f);
}

/* Bare earth instead of what stands on it. How well that is known nobody says. */
static void map_bare(const struct bare *g, uint32_t x, uint32_t y, float pair[2])
{
    float bare = bare_at(g, x, y);
    if (pair[0] <= bare + (float)BARE_NEAR_M)
        return;
    pair[0] = bare;
    pair[1] = GEOTIFF_NODATA;
}

static enum err_code map_file_piece(void *user, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                                    const struct surface_maps *m, struct err *e)
{
    struct map_file *f = user;
    const struct bare *bare = f->request->ground;
    uint8_t *byte = f->pixels;
    float *height = f->pixels;
    for (size_t i = 0; i < (size_t)w * h; i++) {
        bool held = isfinite(m->height_m[i]);
        if (!m->rgb) {
            height[2 * i] = held ? m->height_m[i] : GEOTIFF_NODATA;
            height[2 * i + 1] = held ? m->sigma_m[i] : GEOTIFF_NODATA;
            if (held && bare)
                map_bare(bare, x + (uint32_t)(i % w), y + (uint32_t)(i / w), height + 2 * i);
            continue;
        }
        for (size_t k = 0; k < 3; k++)
            byte[4 * i + k] = held ? map_byte(m->rgb[3 * i + k]) : 0;
        byte[4 * i + 3] = held ? 255 : 0;
    }
    return geotiff_write(f->out, x, y, w, h, f->pixels, e);
}

enum err_code map_write(struct nadir *n, const struct map_request *r, const char *path,
                        struct map_report *report, struct err *e)
{
    struct map_file f = {
        .nadir = n, .request = r, .path = path, .meta = store_info(nadir_store(n))};
    struct map_report own;
    const struct map_visitor v = {r->kind == GEOTIFF_COLOR ? "ortho, px" : "dsm, px", &f,
                                  map_file_begin, map_file_piece,
                                  .colors_alone = r->kind == GEOTIFF_COLOR};
    double start = clock_s();
    enum err_code rc = map_run(n, r, &v, &own, e);
    if (!rc)
        rc = geotiff_commit(&f.out, e);
    own.seconds = clock_s() - start;
    if (!rc && report)
        *report = own;
    geotiff_close(&f.out);
    mem_free(f.pixels);
    return rc;
}
