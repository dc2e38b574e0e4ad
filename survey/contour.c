/* Contour lines: see contour.h. GDAL's generator takes rows and gives lines (marching squares
 * between the centres of pixels). A line ends at a pixel without height.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/contour.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "survey/gdal_library.h"
#include "survey/layer.h"

struct contour_job {
    const struct contour_request *request;
    const struct store_meta *meta;
    const char *path;
    char heights[100];
    struct crs *crs;
    struct map_grid grid;
    struct geotiff *raster;
    float *pixels; /* of a piece */
    float *row;    /* of the whole */
    double *scan;
    struct layer *out;
    struct contour_report report;
    struct err *e;
    enum err_code rc; /* of what GDAL calls */
};

static enum err_code contour_fail(const struct contour_job *j, const char *what, struct err *e)
{
    return err_set(e, ERR_IO, "%s: %s: %s", j->path, what, gdal->CPLGetLastErrorMsg());
}

/* ---- what is asked for ---- */

static enum err_code contour_check(struct contour_job *j, struct err *e)
{
    const struct contour_request *r = j->request;
    enum err_code rc = layer_check(j->path, e);
    if (rc)
        return rc;
    if (!(r->interval_m > 0) || !(r->least_m >= 0))
        return err_set(e, ERR_ARG, "lines every %g m: the interval must be more than 0",
                       r->interval_m);
    return ERR_OK;
}

/* ---- the raster ---- */

static enum err_code contour_begin(void *user, const struct crs *crs, const struct map_grid *g,
                                   struct err *e)
{
    struct contour_job *j = user;
    size_t side = j->request->map.piece_px ? j->request->map.piece_px : MAP_PIECE_PX;
    const struct geotiff_info info = {.crs = crs,
                                      .west_m = g->west_m,
                                      .north_m = g->north_m,
                                      .pixel_m = g->pixel_m,
                                      .width = g->width,
                                      .height = g->height,
                                      .heights = j->heights,
                                      .rows = true};
    j->grid = *g;
    j->pixels = mem_array(side * side, sizeof *j->pixels);
    j->row = mem_array(g->width, sizeof *j->row);
    j->scan = mem_array(g->width, sizeof *j->scan);
    if (!j->pixels || !j->row || !j->scan)
        return err_set(e, ERR_MEM, "out of memory for a row of %u px", g->width);
    enum err_code rc = crs_open(g->epsg, &j->crs, e); /* outlives the drawing */
    return rc ? rc : geotiff_create(j->path, GEOTIFF_HEIGHT, &info, &j->raster, e);
}

static enum err_code contour_piece(void *user, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                                   const struct surface_maps *m, struct err *e)
{
    struct contour_job *j = user;
    for (size_t i = 0; i < (size_t)w * h; i++)
        j->pixels[i] = isfinite(m->height_m[i]) ? m->height_m[i] : GEOTIFF_NODATA;
    return geotiff_write(j->raster, x, y, w, h, j->pixels, e);
}

static enum err_code contour_count(const struct contour_job *j, struct err *e)
{
    double lo = j->report.map.height_min_m, hi = j->report.map.height_max_m,
           levels = (hi - lo) / j->request->interval_m;
    return levels <= CONTOUR_LEVELS_MAX
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "heights of %.2f to %.2f m every %g m are %.0f lines: at most %d; from an "
                         "interval of %.3g m on it fits",
                         lo, hi, j->request->interval_m, levels, CONTOUR_LEVELS_MAX,
                         (hi - lo) / CONTOUR_LEVELS_MAX * 1.01);
}

/* ---- the lines ---- */

static enum err_code contour_open(struct contour_job *j, struct err *e)
{
    static const char *const field[1] = {"height_m"};
    char about[200];
    snprintf(about, sizeof about, "%s, m; %s %s", j->heights, j->meta->name, j->meta->revision);
    const struct layer_info info = {"contours", about, j->crs, false, field, 1};
    return layer_create(j->path, &info, &j->out, e);
}

/* From pixels to the projection, in place; returns its length, m. */
static double contour_place(const struct map_grid *g, int n, double *x, double *y)
{
    double length = 0;
    for (int i = 0; i < n; i++) {
        x[i] = g->west_m + x[i] * g->pixel_m;
        y[i] = g->north_m - y[i] * g->pixel_m;
        length += i ? hypot(x[i] - x[i - 1], y[i] - y[i - 1]) : 0;
    }
    return length;
}

static enum err_code contour_add(struct contour_job *j, double level, int n, double *x, double *y,
                                 struct err *e)
{
    double length = contour_place(&j->grid, n, x, y);
    if (n < 2 || length < j->request->least_m) {
        j->report.n_short++;
        return ERR_OK;
    }
    j->report.lines++;
    j->report.points += (uint64_t)n;
    return layer_add_line(j->out, n, x, y, &level, e);
}

/* GDAL's generator would throw where this fails, also while it is destroyed: what went wrong is
 * kept in the job instead. */
static CPLErr contour_line(double level, int n, double *x, double *y, void *user)
{
    struct contour_job *j = user;
    if (!j->rc)
        j->rc = contour_add(j, level, n, x, y, j->e);
    return CE_None;
}

static enum err_code contour_lines(struct contour_job *j, struct err *e)
{
    const struct map_grid *g = &j->grid;
    struct progress bar;
    GDALContourGeneratorH cg =
        gdal->GDAL_CG_Create((int)g->width, (int)g->height, TRUE, (double)GEOTIFF_NODATA,
                             j->request->interval_m, 0, contour_line, j);
    if (!cg)
        return contour_fail(j, "lines could not be started", e);
    enum err_code rc = ERR_OK;
    j->e = e;
    progress_start(&bar, "contours, rows", g->height);
    for (uint32_t y = 0; !rc && y < g->height; y++) {
        rc = geotiff_row(j->raster, 1, y, j->row, e);
        for (size_t x = 0; x < g->width; x++)
            j->scan[x] = (double)j->row[x];
        if (!rc && gdal->GDAL_CG_FeedLine(cg, j->scan) != CE_None)
            rc = contour_fail(j, "lines could not be drawn", e);
        rc = rc ? rc : j->rc;
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
        progress_step(&bar, y + 1, NULL);
    }
    progress_end(&bar, NULL);
    if (rc && !j->rc)
        j->rc = rc;            /* no more lines */
    gdal->GDAL_CG_Destroy(cg); /* gives the lines that end at the border */
    return j->rc;
}

enum err_code contour_write(struct nadir *n, const struct contour_request *r, const char *path,
                            struct contour_report *report, struct err *e)
{
    struct contour_job j = {.request = r, .path = path, .meta = store_info(nadir_store(n))};
    const struct map_visitor v = {"surface, px", &j, contour_begin, contour_piece, false};
    struct map_request map = r->map;
    map.coarse = true;
    map_heights(n, &map, j.heights);
    enum err_code rc = contour_check(&j, e);
    if (!rc)
        rc = map_run(n, &map, &v, &j.report.map, e);
    if (!rc)
        rc = contour_count(&j, e);
    if (!rc)
        rc = contour_open(&j, e);
    gdal_errors_keep();
    if (!rc)
        rc = contour_lines(&j, e);
    gdal_errors_show();
    if (!rc)
        rc = layer_commit(&j.out, e);
    layer_close(&j.out);
    geotiff_close(&j.raster);
    crs_close(&j.crs);
    mem_free(j.pixels);
    mem_free(j.row);
    mem_free(j.scan);
    if (!rc && report)
        *report = j.report;
    return rc;
}
