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
#include <unistd.h>

#include <gdal/cpl_string.h>
#include <gdal/gdal.h>
#include <gdal/gdal_alg.h>
#include <gdal/ogr_api.h>
#include <gdal/ogr_srs_api.h>

enum { CONTOUR_BATCH = 20000, CONTOUR_FIELD_MAX = 31 }; /* lines of a transaction */

/* Of ogrsf_frmts.h, which is C++. */
void RegisterOGRGeoJSON(void);
void RegisterOGRGeoPackage(void);

struct contour_job {
    const struct contour_request *request;
    const struct store_meta *meta;
    const char *path;
    char part[FILE_PATH_MAX], heights[100];
    bool geojson;
    struct crs *crs;
    struct map_grid grid;
    struct geotiff *raster;
    float *pixels; /* of a piece */
    float *row;    /* of the whole */
    double *scan;
    GDALDatasetH data;
    OGRLayerH layer;
    OGRFeatureDefnH defn;
    struct contour_report report;
    struct err *e;
    enum err_code rc; /* of what GDAL calls */
};

static enum err_code contour_fail(const struct contour_job *j, const char *what, struct err *e)
{
    return err_set(e, ERR_IO, "%s: %s: %s", j->path, what, CPLGetLastErrorMsg());
}

/* ---- what is asked for ---- */

static bool contour_ends(const char *path, const char *end)
{
    size_t n = strlen(path), m = strlen(end);
    return n > m && !strcasecmp(path + n - m, end);
}

static enum err_code contour_check(struct contour_job *j, struct err *e)
{
    const struct contour_request *r = j->request;
    size_t n = strspn(r->field, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_");
    j->geojson = contour_ends(j->path, ".geojson") || contour_ends(j->path, ".json");
    if (!j->geojson && !contour_ends(j->path, ".gpkg"))
        return err_set(e, ERR_ARG,
                       "%s: the name must end in .geojson or .gpkg, which says what it is",
                       j->path);
    if (!n || r->field[n] || n > CONTOUR_FIELD_MAX || (*r->field >= '0' && *r->field <= '9') ||
        !strcasecmp(r->field, "fid") || !strcasecmp(r->field, "geom"))
        return err_set(
            e, ERR_ARG,
            "the field of heights cannot be '%.80s': up to %d letters, digits and _, not "
            "fid or geom, no digit first",
            r->field, CONTOUR_FIELD_MAX);
    if (!(r->interval_m > 0) || !isfinite(r->base_m) || !(r->least_m >= 0))
        return err_set(e, ERR_ARG,
                       "lines every %g m from %g m on: the interval must be more than 0",
                       r->interval_m, r->base_m);
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
    char **options = NULL;
    OGRSpatialReferenceH srs = (OGRSpatialReferenceH)(uintptr_t)crs_handle(j->crs), wgs84 = NULL;
    RegisterOGRGeoJSON();
    RegisterOGRGeoPackage();
    enum err_code rc = file_begin(j->path, j->part, e);
    if (rc)
        return rc;
    unlink(j->part); /* of a process of that number that was killed */
    GDALDriverH driver = GDALGetDriverByName(j->geojson ? "GeoJSON" : "GPKG");
    j->data = driver ? GDALCreate(driver, j->part, 0, 0, 0, GDT_Unknown, NULL) : NULL;
    if (!j->data)
        return contour_fail(j, "it could not be created", e);
    if (j->geojson) {
        wgs84 = OSRNewSpatialReference(NULL);
        OSRImportFromEPSG(wgs84, 4326);
        OSRSetAxisMappingStrategy(wgs84, OAMS_TRADITIONAL_GIS_ORDER);
        options = CSLSetNameValue(options, "RFC7946", "YES");
        options = CSLSetNameValue(options, "COORDINATE_PRECISION", "8"); /* a millimetre */
    } else {
        options = CSLSetNameValue(options, "GEOMETRY_NAME", "geom");
    }
    char about[200];
    snprintf(about, sizeof about, "%s, m; %s %s", j->heights, j->meta->name, j->meta->revision);
    options = CSLSetNameValue(options, "DESCRIPTION", about);
    j->layer = GDALDatasetCreateLayer(j->data, "contours", j->geojson ? wgs84 : srs, wkbLineString,
                                      options);
    CSLDestroy(options);
    if (wgs84)
        OSRDestroySpatialReference(wgs84);
    OGRFieldDefnH field = OGR_Fld_Create(j->request->field, OFTReal);
    bool bad = !j->layer || OGR_L_CreateField(j->layer, field, FALSE) != OGRERR_NONE;
    OGR_Fld_Destroy(field);
    if (bad)
        return contour_fail(j, "its layer could not be made", e);
    j->defn = OGR_L_GetLayerDefn(j->layer);
    if (!j->geojson && GDALDatasetStartTransaction(j->data, FALSE) != OGRERR_NONE)
        return contour_fail(j, "it could not be written", e);
    return ERR_OK;
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
    enum err_code rc = j->geojson ? crs_unproject(j->crs, (size_t)n, x, y, e) : ERR_OK;
    if (rc)
        return rc;
    OGRFeatureH f = OGR_F_Create(j->defn);
    OGRGeometryH line = OGR_G_CreateGeometry(wkbLineString);
    OGR_G_SetPoints(line, n, x, sizeof *x, y, sizeof *y, NULL, 0);
    OGR_F_SetFieldDouble(f, 0, level);
    bool bad = OGR_F_SetGeometryDirectly(f, line) != OGRERR_NONE ||
               OGR_L_CreateFeature(j->layer, f) != OGRERR_NONE;
    OGR_F_Destroy(f);
    j->report.lines++;
    j->report.points += (uint64_t)n;
    if (!bad && !j->geojson && j->report.lines % CONTOUR_BATCH == 0)
        bad = GDALDatasetCommitTransaction(j->data) != OGRERR_NONE ||
              GDALDatasetStartTransaction(j->data, FALSE) != OGRERR_NONE;
    return bad ? contour_fail(j, "a line could not be written", e) : ERR_OK;
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
        GDAL_CG_Create((int)g->width, (int)g->height, TRUE, (double)GEOTIFF_NODATA,
                       j->request->interval_m, j->request->base_m, contour_line, j);
    if (!cg)
        return contour_fail(j, "lines could not be started", e);
    enum err_code rc = ERR_OK;
    j->e = e;
    progress_start(&bar, "contours, rows", g->height);
    for (uint32_t y = 0; !rc && y < g->height; y++) {
        rc = geotiff_row(j->raster, y, j->row, e);
        for (size_t x = 0; x < g->width; x++)
            j->scan[x] = (double)j->row[x];
        if (!rc && GDAL_CG_FeedLine(cg, j->scan) != CE_None)
            rc = contour_fail(j, "lines could not be drawn", e);
        rc = rc ? rc : j->rc;
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
        progress_step(&bar, y + 1, NULL);
    }
    progress_end(&bar, NULL);
    if (rc && !j->rc)
        j->rc = rc;      /* no more lines */
    GDAL_CG_Destroy(cg); /* gives the lines that end at the border */
    return j->rc;
}

static enum err_code contour_commit(struct contour_job *j, struct err *e)
{
    bool bad = !j->geojson && GDALDatasetCommitTransaction(j->data) != OGRERR_NONE;
    CPLErrorReset();
    GDALClose(j->data);
    j->data = NULL;
    if (bad || CPLGetLastErrorType() >= CE_Failure)
        return contour_fail(j, "it could not be written", e);
    return file_commit(j->part, j->path, e);
}

enum err_code contour_write(struct nadir *n, const struct contour_request *r, const char *path,
                            struct contour_report *report, struct err *e)
{
    struct contour_job j = {.request = r, .path = path, .meta = store_info(nadir_store(n))};
    const struct map_visitor v = {"surface, px", &j, contour_begin, contour_piece, false};
    map_heights(n, &r->map, j.heights);
    enum err_code rc = contour_check(&j, e);
    if (!rc)
        rc = map_run(n, &r->map, &v, &j.report.map, e);
    if (!rc)
        rc = contour_count(&j, e);
    CPLPushErrorHandler(CPLQuietErrorHandler);
    if (!rc)
        rc = contour_open(&j, e);
    if (!rc)
        rc = contour_lines(&j, e);
    if (!rc)
        rc = contour_commit(&j, e);
    if (j.data)
        GDALClose(j.data);
    CPLPopErrorHandler();
    if (rc && *j.part) {
        char journal[FILE_PATH_MAX + 16];
        snprintf(journal, sizeof journal, "%s-journal", j.part);
        unlink(journal);
        unlink(j.part);
    }
    geotiff_close(&j.raster);
    crs_close(&j.crs);
    mem_free(j.pixels);
    mem_free(j.row);
    mem_free(j.scan);
    if (!rc && report)
        *report = j.report;
    return rc;
}
