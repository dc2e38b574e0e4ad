/* Maps read again: see sheet.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/sheet.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "survey/gdal_library.h"

struct sheet {
    char path[FILE_PATH_MAX];
    enum geotiff_kind kind;
    GDALDatasetH data;
    struct crs *crs;
    struct map_grid grid;
};

static enum err_code sheet_fail(const struct sheet *s, const char *what, struct err *e)
{
    return err_set(e, ERR_FORMAT, "%s: %s", s->path, what);
}

static enum err_code sheet_check_bands(const struct sheet *s, struct err *e)
{
    bool color = s->kind == GEOTIFF_COLOR;
    int bands = gdal->GDALGetRasterCount(s->data);
    if (color ? bands != 4 : bands != 1 && bands != 2)
        return sheet_fail(
            s,
            color ? "not an orthophoto: red, green, blue and alpha are expected"
                  : "not a surface model: one band of heights is expected, and at most one of "
                    "their standard deviation beside it",
            e);
    if (color && gdal->GDALGetRasterDataType(gdal->GDALGetRasterBand(s->data, 1)) != GDT_Byte)
        return sheet_fail(s, "not an orthophoto: 8 bits a colour are expected", e);
    return ERR_OK;
}

static enum err_code sheet_place(struct sheet *s, struct err *e)
{
    double t[6];
    OGRSpatialReferenceH srs = gdal->GDALGetSpatialRef(s->data);
    /* Heights may stand beside the projection. */
    const char *code = srs ? gdal->OSRGetAuthorityCode(srs, "PROJCS") : NULL,
               *name = srs ? gdal->OSRGetAuthorityName(srs, "PROJCS") : NULL;
    double w = gdal->GDALGetRasterXSize(s->data), h = gdal->GDALGetRasterYSize(s->data);
    if (gdal->GDALGetGeoTransform(s->data, t) != CE_None || t[2] != 0 || t[4] != 0 || !(t[1] > 0) ||
        fabs(t[1] + t[5]) > 1e-9 * t[1])
        return sheet_fail(s, "it is not north up, or its pixels are not square", e);
    if (!code || !name || strcmp(name, "EPSG") != 0)
        return sheet_fail(s, "it does not say its coordinate system by an EPSG code", e);
    if (w > MAP_EDGE_MAX || h > MAP_EDGE_MAX || w * h > MAP_PIXELS_MAX)
        return err_set(e, ERR_LIMIT, "%s: %.0f x %.0f px: at most %d along an edge and %.0f in all",
                       s->path, w, h, MAP_EDGE_MAX, MAP_PIXELS_MAX);
    s->grid = (struct map_grid){t[0], t[3], t[1], (uint32_t)w, (uint32_t)h, atoi(code)};
    return crs_open(s->grid.epsg, &s->crs, e);
}

enum err_code sheet_open(const char *path, enum geotiff_kind kind, struct sheet **out,
                         struct err *e)
{
    struct sheet *s = mem_array(1, sizeof *s);
    *out = NULL;
    if (!s)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    enum err_code rc = ERR_OK;
    s->kind = kind;
    if (snprintf(s->path, sizeof s->path, "%s", path) >= (int)sizeof s->path)
        rc = err_set(e, ERR_LIMIT, "%.60s...: the path is too long", path);
    else if (!file_exists(path))
        rc = err_set(e, ERR_NOENT, "%s: no such file", path);
    if (!rc)
        rc = geotiff_start(e);
    static const char *const drivers[] = {"GTiff", NULL};
    gdal_errors_keep();
    if (!rc)
        s->data = gdal->GDALOpenEx(path, GDAL_OF_RASTER | GDAL_OF_READONLY, drivers, NULL, NULL);
    if (!rc && !s->data)
        rc = sheet_fail(s, "not a GeoTIFF", e);
    if (!rc)
        rc = sheet_check_bands(s, e);
    if (!rc)
        rc = sheet_place(s, e);
    gdal_errors_show();
    if (rc)
        sheet_close(&s);
    *out = s;
    return rc;
}

void sheet_close(struct sheet **sp)
{
    struct sheet *s = *sp;
    if (!s)
        return;
    if (s->data)
        gdal->GDALClose(s->data);
    crs_close(&s->crs);
    mem_free(s);
    *sp = NULL;
}

const struct map_grid *sheet_grid(const struct sheet *s)
{
    return &s->grid;
}

const struct crs *sheet_crs(const struct sheet *s)
{
    return s->crs;
}

struct geotiff_info sheet_info(const struct sheet *s)
{
    return (struct geotiff_info){.crs = s->crs,
                                 .west_m = s->grid.west_m,
                                 .north_m = s->grid.north_m,
                                 .pixel_m = s->grid.pixel_m,
                                 .width = s->grid.width,
                                 .height = s->grid.height};
}

enum err_code sheet_read(const struct sheet *s, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                         void *pixels, struct err *e)
{
    bool color = s->kind == GEOTIFF_COLOR;
    int size = color ? 1 : 4, bands = color ? 4 : 1;
    gdal_errors_keep();
    CPLErr rc = gdal->GDALDatasetRasterIO(s->data, GF_Read, (int)x, (int)y, (int)w, (int)h, pixels,
                                          (int)w, (int)h, color ? GDT_Byte : GDT_Float32, bands,
                                          NULL, size * bands, size * bands * (int)w, color ? 1 : 0);
    gdal_errors_show();
    return rc == CE_None ? ERR_OK
                         : err_set(e, ERR_FORMAT, "%s: %s", s->path, gdal->CPLGetLastErrorMsg());
}

bool sheet_has_sigma(const struct sheet *s)
{
    return s->kind != GEOTIFF_COLOR && gdal->GDALGetRasterCount(s->data) == 2;
}

enum err_code sheet_read_sigma(const struct sheet *s, uint32_t x, uint32_t y, uint32_t w,
                               uint32_t h, float *sigma_m, struct err *e)
{
    int band = 2;
    gdal_errors_keep();
    CPLErr rc = gdal->GDALDatasetRasterIO(s->data, GF_Read, (int)x, (int)y, (int)w, (int)h, sigma_m,
                                          (int)w, (int)h, GDT_Float32, 1, &band, 4, 4 * (int)w, 0);
    gdal_errors_show();
    return rc == CE_None ? ERR_OK
                         : err_set(e, ERR_FORMAT, "%s: %s", s->path, gdal->CPLGetLastErrorMsg());
}
