/* Vector files by GDAL: see layer.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/layer.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include <gdal/cpl_string.h>
#include <gdal/gdal.h>
#include <gdal/ogr_api.h>
#include <gdal/ogr_srs_api.h>

#include "survey/geotiff.h"

enum { LAYER_BATCH = 20000 }; /* features of a transaction */

/* Of ogrsf_frmts.h, which is C++. */
void RegisterOGRGeoJSON(void);
void RegisterOGRGeoPackage(void);

struct layer {
    char path[FILE_PATH_MAX], part[FILE_PATH_MAX];
    const struct crs *crs; /* borrowed */
    bool geojson;
    size_t n_fields;
    uint64_t n;
    GDALDatasetH data;
    OGRLayerH layer;
    OGRFeatureDefnH defn;
};

static enum err_code layer_fail(const struct layer *l, const char *what, struct err *e)
{
    return err_set(e, ERR_IO, "%s: %s: %s", l->path, what, CPLGetLastErrorMsg());
}

static bool layer_ends(const char *path, const char *end)
{
    size_t n = strlen(path), m = strlen(end);
    return n > m && !strcasecmp(path + n - m, end);
}

static bool layer_is_geojson(const char *path)
{
    return layer_ends(path, ".geojson") || layer_ends(path, ".json");
}

enum err_code layer_check(const char *path, struct err *e)
{
    return layer_is_geojson(path) || layer_ends(path, ".gpkg")
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "%s: the name must end in .geojson or .gpkg, which says what it is", path);
}

/* The layer and its fields, in the file that is open. */
static enum err_code layer_begin(struct layer *l, const struct layer_info *info, struct err *e)
{
    char **options = CSLSetNameValue(NULL, "DESCRIPTION", info->about);
    OGRSpatialReferenceH srs = (OGRSpatialReferenceH)(uintptr_t)crs_handle(info->crs), wgs84 = NULL;
    if (l->geojson) {
        wgs84 = OSRNewSpatialReference(NULL);
        OSRImportFromEPSG(wgs84, 4326);
        OSRSetAxisMappingStrategy(wgs84, OAMS_TRADITIONAL_GIS_ORDER);
        options = CSLSetNameValue(options, "RFC7946", "YES");
        options = CSLSetNameValue(options, "COORDINATE_PRECISION", "8"); /* a millimetre */
    } else {
        options = CSLSetNameValue(options, "GEOMETRY_NAME", "geom");
    }
    l->layer = GDALDatasetCreateLayer(l->data, info->name, l->geojson ? wgs84 : srs,
                                      info->polygons ? wkbPolygon : wkbLineString, options);
    CSLDestroy(options);
    if (wgs84)
        OSRDestroySpatialReference(wgs84);
    bool bad = !l->layer;
    for (size_t i = 0; !bad && i < info->n_fields; i++) {
        OGRFieldDefnH field = OGR_Fld_Create(info->field[i], OFTReal);
        bad = OGR_L_CreateField(l->layer, field, FALSE) != OGRERR_NONE;
        OGR_Fld_Destroy(field);
    }
    if (bad)
        return layer_fail(l, "its layer could not be made", e);
    l->defn = OGR_L_GetLayerDefn(l->layer);
    return !l->geojson && GDALDatasetStartTransaction(l->data, FALSE) != OGRERR_NONE
               ? layer_fail(l, "it could not be written", e)
               : ERR_OK;
}

enum err_code layer_create(const char *path, const struct layer_info *info, struct layer **out,
                           struct err *e)
{
    *out = NULL;
    enum err_code rc = layer_check(path, e);
    if (rc)
        return rc;
    struct layer *l = mem_array(1, sizeof *l);
    if (!l)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    geotiff_start();
    RegisterOGRGeoJSON();
    RegisterOGRGeoPackage();
    snprintf(l->path, sizeof l->path, "%s", path);
    l->crs = info->crs;
    l->geojson = layer_is_geojson(path);
    l->n_fields = info->n_fields;
    rc = file_begin(path, l->part, e);
    CPLPushErrorHandler(CPLQuietErrorHandler);
    if (!rc) {
        unlink(l->part); /* of a process of that number that was killed */
        GDALDriverH driver = GDALGetDriverByName(l->geojson ? "GeoJSON" : "GPKG");
        l->data = driver ? GDALCreate(driver, l->part, 0, 0, 0, GDT_Unknown, NULL) : NULL;
        if (!l->data)
            rc = layer_fail(l, "it could not be created", e);
    }
    if (!rc)
        rc = layer_begin(l, info, e);
    CPLPopErrorHandler();
    if (rc)
        layer_close(&l);
    *out = l;
    return rc;
}

static enum err_code layer_add(struct layer *l, OGRGeometryH shape, const double *value,
                               struct err *e)
{
    CPLPushErrorHandler(CPLQuietErrorHandler);
    OGRFeatureH f = OGR_F_Create(l->defn);
    for (size_t i = 0; i < l->n_fields; i++)
        OGR_F_SetFieldDouble(f, (int)i, value[i]);
    bool bad = OGR_F_SetGeometryDirectly(f, shape) != OGRERR_NONE ||
               OGR_L_CreateFeature(l->layer, f) != OGRERR_NONE;
    OGR_F_Destroy(f);
    if (!bad && !l->geojson && ++l->n % LAYER_BATCH == 0)
        bad = GDALDatasetCommitTransaction(l->data) != OGRERR_NONE ||
              GDALDatasetStartTransaction(l->data, FALSE) != OGRERR_NONE;
    CPLPopErrorHandler();
    return bad ? layer_fail(l, "a feature could not be written", e) : ERR_OK;
}

enum err_code layer_add_line(struct layer *l, int n, double *x, double *y, const double *value,
                             struct err *e)
{
    enum err_code rc = l->geojson ? crs_unproject(l->crs, (size_t)n, x, y, e) : ERR_OK;
    if (rc)
        return rc;
    OGRGeometryH line = OGR_G_CreateGeometry(wkbLineString);
    OGR_G_SetPoints(line, n, x, sizeof *x, y, sizeof *y, NULL, 0);
    return layer_add(l, line, value, e);
}

enum err_code layer_add_polygon(struct layer *l, size_t rings, const int *count, double *x,
                                double *y, const double *value, struct err *e)
{
    size_t n = 0, at = 0;
    for (size_t i = 0; i < rings; i++)
        n += (size_t)count[i];
    enum err_code rc = l->geojson ? crs_unproject(l->crs, n, x, y, e) : ERR_OK;
    if (rc)
        return rc;
    OGRGeometryH polygon = OGR_G_CreateGeometry(wkbPolygon);
    for (size_t i = 0; i < rings; i++) {
        OGRGeometryH ring = OGR_G_CreateGeometry(wkbLinearRing);
        OGR_G_SetPoints(ring, count[i], x + at, sizeof *x, y + at, sizeof *y, NULL, 0);
        OGR_G_AddGeometryDirectly(polygon, ring);
        at += (size_t)count[i];
    }
    return layer_add(l, polygon, value, e);
}

enum err_code layer_commit(struct layer **lp, struct err *e)
{
    struct layer *l = *lp;
    CPLPushErrorHandler(CPLQuietErrorHandler);
    bool bad = !l->geojson && GDALDatasetCommitTransaction(l->data) != OGRERR_NONE;
    CPLErrorReset();
    GDALClose(l->data);
    l->data = NULL;
    enum err_code rc = bad || CPLGetLastErrorType() >= CE_Failure
                           ? layer_fail(l, "it could not be written", e)
                           : file_commit(l->part, l->path, e);
    CPLPopErrorHandler();
    layer_close(lp);
    return rc;
}

void layer_close(struct layer **lp)
{
    struct layer *l = *lp;
    if (!l)
        return;
    if (l->data) {
        CPLPushErrorHandler(CPLQuietErrorHandler);
        GDALClose(l->data);
        CPLPopErrorHandler();
    }
    if (*l->part) { /* what was renamed is not there */
        char journal[FILE_PATH_MAX + 16];
        snprintf(journal, sizeof journal, "%s-journal", l->part);
        unlink(journal);
        unlink(l->part);
    }
    mem_free(l);
    *lp = NULL;
}
