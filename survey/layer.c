/* Vector files by GDAL: see layer.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/layer.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "survey/gdal_library.h"
#include "survey/geotiff.h"

enum { LAYER_BATCH = 20000 }; /* features of a transaction */

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
    return err_set(e, ERR_IO, "%s: %s: %s", l->path, what, gdal->CPLGetLastErrorMsg());
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
    char **options = gdal->CSLSetNameValue(NULL, "DESCRIPTION", info->about);
    OGRSpatialReferenceH srs = (OGRSpatialReferenceH)(uintptr_t)crs_handle(info->crs), wgs84 = NULL;
    if (l->geojson) {
        wgs84 = gdal->OSRNewSpatialReference(NULL);
        gdal->OSRImportFromEPSG(wgs84, 4326);
        gdal->OSRSetAxisMappingStrategy(wgs84, OAMS_TRADITIONAL_GIS_ORDER);
        options = gdal->CSLSetNameValue(options, "RFC7946", "YES");
        options = gdal->CSLSetNameValue(options, "COORDINATE_PRECISION", "8"); /* a millimetre */
    } else {
        options = gdal->CSLSetNameValue(options, "GEOMETRY_NAME", "geom");
    }
    l->layer = gdal->GDALDatasetCreateLayer(l->data, info->name, l->geojson ? wgs84 : srs,
                                            info->polygons ? wkbPolygon : wkbLineString, options);
    gdal->CSLDestroy(options);
    if (wgs84)
        gdal->OSRDestroySpatialReference(wgs84);
    bool bad = !l->layer;
    for (size_t i = 0; !bad && i < info->n_fields; i++) {
        OGRFieldDefnH field = gdal->OGR_Fld_Create(info->field[i], OFTReal);
        bad = gdal->OGR_L_CreateField(l->layer, field, FALSE) != OGRERR_NONE;
        gdal->OGR_Fld_Destroy(field);
    }
    if (bad)
        return layer_fail(l, "its layer could not be made", e);
    l->defn = gdal->OGR_L_GetLayerDefn(l->layer);
    return !l->geojson && gdal->GDALDatasetStartTransaction(l->data, FALSE) != OGRERR_NONE
               ? layer_fail(l, "it could not be written", e)
               : ERR_OK;
}

enum err_code layer_create(const char *path, const struct layer_info *info, struct layer **out,
                           struct err *e)
{
    *out = NULL;
    enum err_code rc = layer_check(path, e);
    if (!rc)
        rc = geotiff_start(e);
    if (rc)
        return rc;
    struct layer *l = mem_array(1, sizeof *l);
    if (!l)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    gdal->RegisterOGRGeoJSON();
    gdal->RegisterOGRGeoPackage();
    snprintf(l->path, sizeof l->path, "%s", path);
    l->crs = info->crs;
    l->geojson = layer_is_geojson(path);
    l->n_fields = info->n_fields;
    rc = file_begin(path, l->part, e);
    gdal_errors_keep();
    if (!rc) {
        unlink(l->part); /* of a process of that number that was killed */
        GDALDriverH driver = gdal->GDALGetDriverByName(l->geojson ? "GeoJSON" : "GPKG");
        l->data = driver ? gdal->GDALCreate(driver, l->part, 0, 0, 0, GDT_Unknown, NULL) : NULL;
        if (!l->data)
            rc = layer_fail(l, "it could not be created", e);
    }
    if (!rc)
        rc = layer_begin(l, info, e);
    gdal_errors_show();
    if (rc)
        layer_close(&l);
    *out = l;
    return rc;
}

static enum err_code layer_add(struct layer *l, OGRGeometryH shape, const double *value,
                               struct err *e)
{
    gdal_errors_keep();
    OGRFeatureH f = gdal->OGR_F_Create(l->defn);
    for (size_t i = 0; i < l->n_fields; i++)
        gdal->OGR_F_SetFieldDouble(f, (int)i, value[i]);
    bool bad = gdal->OGR_F_SetGeometryDirectly(f, shape) != OGRERR_NONE ||
               gdal->OGR_L_CreateFeature(l->layer, f) != OGRERR_NONE;
    gdal->OGR_F_Destroy(f);
    if (!bad && !l->geojson && ++l->n % LAYER_BATCH == 0)
        bad = gdal->GDALDatasetCommitTransaction(l->data) != OGRERR_NONE ||
              gdal->GDALDatasetStartTransaction(l->data, FALSE) != OGRERR_NONE;
    gdal_errors_show();
    return bad ? layer_fail(l, "a feature could not be written", e) : ERR_OK;
}

enum err_code layer_add_line(struct layer *l, int n, double *x, double *y, const double *value,
                             struct err *e)
{
    enum err_code rc = l->geojson ? crs_unproject(l->crs, (size_t)n, x, y, e) : ERR_OK;
    if (rc)
        return rc;
    OGRGeometryH line = gdal->OGR_G_CreateGeometry(wkbLineString);
    gdal->OGR_G_SetPoints(line, n, x, sizeof *x, y, sizeof *y, NULL, 0);
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
    OGRGeometryH polygon = gdal->OGR_G_CreateGeometry(wkbPolygon);
    for (size_t i = 0; i < rings; i++) {
        OGRGeometryH ring = gdal->OGR_G_CreateGeometry(wkbLinearRing);
        gdal->OGR_G_SetPoints(ring, count[i], x + at, sizeof *x, y + at, sizeof *y, NULL, 0);
        gdal->OGR_G_AddGeometryDirectly(polygon, ring);
        at += (size_t)count[i];
    }
    return layer_add(l, polygon, value, e);
}

enum err_code layer_commit(struct layer **lp, struct err *e)
{
    struct layer *l = *lp;
    gdal_errors_keep();
    bool bad = !l->geojson && gdal->GDALDatasetCommitTransaction(l->data) != OGRERR_NONE;
    gdal->CPLErrorReset();
    gdal->GDALClose(l->data);
    l->data = NULL;
    enum err_code rc = bad || gdal->CPLGetLastErrorType() >= CE_Failure
                           ? layer_fail(l, "it could not be written", e)
                           : file_commit(l->part, l->path, e);
    gdal_errors_show();
    layer_close(lp);
    return rc;
}

void layer_close(struct layer **lp)
{
    struct layer *l = *lp;
    if (!l)
        return;
    if (l->data) {
        gdal_errors_keep();
        gdal->GDALClose(l->data);
        gdal_errors_show();
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
