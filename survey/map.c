/* Maps of a store: see map.h.
 *
 * A piece is drawn in a plane that touches the Earth in its middle, with pixels turned and scaled
 * as the projection has them there. How far that is off at the piece's corners is checked; for
 * conformal projections such as UTM it is nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/map.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

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

/* About as fine as the Gaussians are, a round number. */
static double map_gsd(double sigma_m)
{
    double ten = pow(10, floor(log10(sigma_m))), of = sigma_m / ten;
    return ten * (of < 1.5 ? 1 : of < 3.5 ? 2 : of < 7.5 ? 5 : 10);
}

static enum err_code map_size(const double box[4], double gsd, struct map_grid *g, struct err *e)
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

enum err_code map_plan(const struct nadir *n, const struct map_request *r, struct crs **crs,
                       struct map_grid *out, struct err *e)
{
    const struct area *a = nadir_area(n);
    double deg[4], box[4], gsd = r->gsd_m > 0 ? r->gsd_m : map_gsd(a->sigma_m);
    *crs = NULL;
    enum err_code rc = map_area(a, r->bbox_deg, deg, e);
    if (rc)
        return rc;
    int epsg = r->epsg ? r->epsg : crs_utm(0.5 * (deg[0] + deg[2]), 0.5 * (deg[1] + deg[3]));
    rc = crs_open(epsg, crs, e);
    if (!rc)
        rc = map_box(*crs, deg, box, e);
    if (!rc)
        rc = map_size(box, gsd, out, e);
    out->epsg = epsg;
    if (rc)
        crs_close(crs);
    return rc;
}

/* ---- a piece ---- */

struct map_job {
    struct nadir *nadir;
    const struct crs *crs;
    struct map_grid grid;
    enum geotiff_kind kind;
    struct geotiff *out;
    float *rgb, *height;
    uint8_t *in; /* surveyed */
    void *pixels;
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

static uint8_t map_byte(float v)
{
    return (uint8_t)(fminf(fmaxf(v, 0), 1) * 255 + 0.5f);
}

static void map_pixels(struct map_job *j, size_t n)
{
    uint8_t *byte = j->pixels;
    float *height = j->pixels;
    struct map_report *r = &j->report;
    for (size_t i = 0; i < n; i++) {
        bool held = isfinite(j->height[i]);
        r->pixels_held += held;
        if (held) {
            r->height_min_m = fmin(r->height_min_m, (double)j->height[i]);
            r->height_max_m = fmax(r->height_max_m, (double)j->height[i]);
        }
        if (j->kind == GEOTIFF_HEIGHT) {
            height[i] = held ? j->height[i] : GEOTIFF_NODATA;
            continue;
        }
        for (size_t k = 0; k < 3; k++)
            byte[4 * i + k] = held ? map_byte(j->rgb[3 * i + k]) : 0;
        byte[4 * i + 3] = held ? 255 : 0;
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
    rc = nadir_draw(j->nadir, &p, j->kind == GEOTIFF_COLOR ? j->rgb : NULL, j->height, e);
    if (rc)
        return err_add(e, "piece at pixel %u,%u", x, y);
    for (size_t i = 0; i < (size_t)p.width * p.height; i++)
        if (!j->in[i])
            j->height[i] = NAN;
    map_pixels(j, (size_t)p.width * p.height);
    return geotiff_write(j->out, x, y, p.width, p.height, j->pixels, e);
}

/* ---- the file ---- */

static enum err_code map_draw(struct map_job *j, uint32_t size, struct err *e)
{
    struct progress bar;
    uint64_t done = 0;
    size_t pixels = (size_t)size * size;
    enum err_code rc = ERR_OK;
    j->rgb = mem_array(pixels, 3 * sizeof *j->rgb);
    j->height = mem_array(pixels, sizeof *j->height);
    j->pixels = mem_array(pixels, 4);
    j->in = mem_array(pixels, 1);
    if (!j->rgb || !j->height || !j->pixels || !j->in)
        return err_set(e, ERR_MEM, "out of memory for a piece of %u px", size);
    progress_start(&bar, j->kind == GEOTIFF_COLOR ? "ortho, px" : "dsm, px",
                   (uint64_t)j->grid.width * j->grid.height);
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

enum err_code map_write(struct nadir *n, const struct map_request *r, const char *path,
                        struct map_report *report, struct err *e)
{
    struct map_job j = {.nadir = n, .kind = r->kind};
    struct crs *crs = NULL;
    double start = clock_s();
    uint32_t size = r->piece_px ? r->piece_px : MAP_PIECE_PX;
    char source[128];
    const struct store_meta *m = store_info(nadir_store(n));
    enum err_code rc = size > NADIR_SIZE_MAX ? err_set(e, ERR_ARG, "pieces of %u px: at most %d",
                                                       size, NADIR_SIZE_MAX)
                                             : map_plan(n, r, &crs, &j.grid, e);
    if (rc)
        return rc;
    j.crs = crs;
    j.report.grid = j.grid;
    j.report.height_min_m = HUGE_VAL;
    j.report.height_max_m = -HUGE_VAL;
    snprintf(source, sizeof source, "%s %s", m->name, m->revision);
    const struct geotiff_info info = {.crs = crs,
                                      .west_m = j.grid.west_m,
                                      .north_m = j.grid.north_m,
                                      .pixel_m = j.grid.pixel_m,
                                      .width = j.grid.width,
                                      .height = j.grid.height,
                                      .copyright = m->attribution,
                                      .source = source};
    rc = geotiff_create(path, r->kind, &info, &j.out, e);
    if (!rc)
        rc = map_draw(&j, size, e);
    if (!rc && j.report.pixels_held == 0)
        rc = err_set(e, ERR_ARG, "%s: the area is empty: nothing of the survey is in it", path);
    if (!rc)
        rc = geotiff_commit(&j.out, e);
    j.report.seconds = clock_s() - start;
    if (!rc && report)
        *report = j.report;
    geotiff_close(&j.out);
    crs_close(&crs);
    mem_free(j.rgb);
    mem_free(j.height);
    mem_free(j.pixels);
    mem_free(j.in);
    return rc;
}
