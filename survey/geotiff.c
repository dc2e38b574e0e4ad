/* Cloud Optimized GeoTIFF by GDAL: see geotiff.h. GDAL's COG driver can only copy a whole picture,
 * so a plain tiled one is written first. It is sparse: ground that was not surveyed takes no room.
 *
 * Only the two necessary drivers are registered, so no other reader of GDAL ever opens a file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/geotiff.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base.h"
#include "survey/gdal_library.h"

#define GEOTIFF_CACHE_MB "128"
#define GEOTIFF_ROOM ((uint64_t)1 << 20) /* one block of four bands: with less, writing it failed */

struct geotiff {
    char path[FILE_PATH_MAX], part[FILE_PATH_MAX], base[FILE_PATH_MAX];
    enum geotiff_kind kind;
    GDALDatasetH data; /* of base */
    struct progress progress;
};

enum err_code geotiff_start(struct err *e)
{
    enum err_code rc = gdal_load(e);
    if (rc)
        return rc;
    gdal->CPLSetConfigOption("GDAL_CACHEMAX", GEOTIFF_CACHE_MB);
    gdal->CPLSetConfigOption("GDAL_PAM_ENABLED", "NO"); /* no .aux.xml beside the file */
    gdal->GDALRegister_GTiff();
    gdal->GDALRegister_COG();
    return ERR_OK;
}

/* Bands of a kind, and bytes of a pixel of one. */
static int geotiff_bands(enum geotiff_kind kind)
{
    return kind == GEOTIFF_COLOR ? 4 : kind == GEOTIFF_SURFACE ? 2 : 1;
}

/* GDAL does not say that a disk is full. */
static enum err_code geotiff_fail(const struct geotiff *t, const char *what, struct err *e)
{
    if (file_room(t->path, GEOTIFF_ROOM, e))
        return err_add(e, "%s", what);
    return err_set(e, ERR_IO, "%s: %s: %s", t->path, what, gdal->CPLGetLastErrorMsg());
}

static enum err_code geotiff_describe(struct geotiff *t, const struct geotiff_info *info,
                                      struct err *e)
{
    double transform[6] = {info->west_m, info->pixel_m, 0, info->north_m, 0, -info->pixel_m};
    OGRSpatialReferenceH srs =
        (OGRSpatialReferenceH)(uintptr_t)(t->kind == GEOTIFF_COLOR ? crs_handle(info->crs)
                                                                   : crs_with_heights(info->crs));
    bool bad = gdal->GDALSetSpatialRef(t->data, srs) != CE_None ||
               gdal->GDALSetGeoTransform(t->data, transform) != CE_None;
    if (info->copyright && *info->copyright)
        bad |= gdal->GDALSetMetadataItem(t->data, "TIFFTAG_COPYRIGHT", info->copyright, NULL) !=
               CE_None;
    if (info->source)
        bad |= gdal->GDALSetMetadataItem(t->data, "CITYSPLAT_STORE", info->source, NULL) != CE_None;
    bad |= gdal->GDALSetMetadataItem(t->data, "TIFFTAG_SOFTWARE", "citysplat " CITYSPLAT_VERSION,
                                     NULL) != CE_None;
    for (int k = 1; t->kind != GEOTIFF_COLOR && k <= geotiff_bands(t->kind); k++) {
        GDALRasterBandH band = gdal->GDALGetRasterBand(t->data, k);
        bad |= gdal->GDALSetRasterNoDataValue(band, (double)GEOTIFF_NODATA) != CE_None;
        bad |= gdal->GDALSetRasterUnitType(band, "metre") != CE_None;
        gdal->GDALSetDescription(band,
                                 k == 1 ? info->heights : "standard deviation of the first band");
    }
    if (t->kind == GEOTIFF_COLOR) {
        bad |= gdal->GDALSetRasterColorInterpretation(gdal->GDALGetRasterBand(t->data, 4),
                                                      GCI_AlphaBand) != CE_None;
    }
    return bad ? geotiff_fail(t, "its place or description could not be written", e) : ERR_OK;
}

enum err_code geotiff_create(const char *path, enum geotiff_kind kind,
                             const struct geotiff_info *info, struct geotiff **out, struct err *e)
{
    *out = NULL;
    enum err_code rc = geotiff_start(e);
    if (rc)
        return rc;
    struct geotiff *t = mem_array(1, sizeof *t);
    if (!t)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    t->kind = kind;
    if (snprintf(t->path, sizeof t->path, "%s", path) >= (int)sizeof t->path) {
        mem_free(t);
        return err_set(e, ERR_LIMIT, "%.60s...: the path is too long", path);
    }
    rc = file_begin(path, t->part, e);
    if (!rc && snprintf(t->base, sizeof t->base, "%s-base", t->part) >= (int)sizeof t->base)
        rc = err_set(e, ERR_LIMIT, "%.60s...: the path is too long", path);
    char **options = NULL;
    options = gdal->CSLSetNameValue(options, "TILED", "YES");
    options = gdal->CSLSetNameValue(options, "BLOCKXSIZE", "512");
    /* A row of tiles must fit into the cache to be read by rows: 64 MB of the widest. */
    options = gdal->CSLSetNameValue(options, "BLOCKYSIZE", info->rows ? "16" : "512");
    options = gdal->CSLSetNameValue(options, "COMPRESS", "LZW");
    options = gdal->CSLSetNameValue(options, "SPARSE_OK", "TRUE");
    options = gdal->CSLSetNameValue(options, "BIGTIFF", "IF_SAFER");
    if (kind == GEOTIFF_COLOR)
        options = gdal->CSLSetNameValue(options, "ALPHA", "YES");
    gdal_errors_keep();
    if (!rc)
        t->data = gdal->GDALCreate(gdal->GDALGetDriverByName("GTiff"), t->base, (int)info->width,
                                   (int)info->height, geotiff_bands(kind),
                                   kind == GEOTIFF_COLOR ? GDT_Byte : GDT_Float32, options);
    if (!rc && !t->data)
        rc = geotiff_fail(t, "it could not be created", e);
    if (!rc)
        rc = geotiff_describe(t, info, e);
    gdal_errors_show();
    gdal->CSLDestroy(options);
    if (rc)
        geotiff_close(&t);
    *out = t;
    return rc;
}

enum err_code geotiff_write(struct geotiff *t, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                            const void *pixels, struct err *e)
{
    bool color = t->kind == GEOTIFF_COLOR;
    int size = color ? 1 : 4, bands = geotiff_bands(t->kind);
    gdal_errors_keep();
    CPLErr rc = gdal->GDALDatasetRasterIO(t->data, GF_Write, (int)x, (int)y, (int)w, (int)h,
                                          (void *)(uintptr_t)pixels, (int)w, (int)h,
                                          color ? GDT_Byte : GDT_Float32, bands, NULL, size * bands,
                                          size * bands * (int)w, size);
    gdal_errors_show();
    return rc == CE_None ? ERR_OK : geotiff_fail(t, "pixels could not be written", e);
}

enum err_code geotiff_row(struct geotiff *t, int band, uint32_t y, float *row, struct err *e)
{
    int w = gdal->GDALGetRasterXSize(t->data);
    gdal_errors_keep();
    CPLErr rc = gdal->GDALRasterIO(gdal->GDALGetRasterBand(t->data, band), GF_Read, 0, (int)y, w, 1,
                                   row, w, 1, GDT_Float32, 0, 0);
    gdal_errors_show();
    return rc == CE_None ? ERR_OK : geotiff_fail(t, "pixels could not be read again", e);
}

enum err_code geotiff_outline(struct geotiff *t, void *ogr_layer, struct err *e)
{
    GDALRasterBandH band = gdal->GDALGetRasterBand(t->data, 1);
    /* Pixels: a file that has a place would give places. */
    double none[6] = {0, 1, 0, 0, 0, 1};
    gdal_errors_keep();
    CPLErr rc = gdal->GDALSetGeoTransform(t->data, none);
    if (rc == CE_None)
        rc = gdal->GDALPolygonize(band, gdal->GDALGetMaskBand(band), (OGRLayerH)ogr_layer, 0, NULL,
                                  NULL, NULL);
    gdal_errors_show();
    return rc == CE_None ? ERR_OK : geotiff_fail(t, "outlines could not be found", e);
}

static int CPL_STDCALL geotiff_progress(double share, const char *message, void *user)
{
    struct geotiff *t = user;
    (void)message;
    progress_step(&t->progress, (uint64_t)(share * 100), NULL);
    return !signals_stopping();
}

static enum err_code geotiff_copy(struct geotiff *t, struct err *e)
{
    char **options = NULL;
    options = gdal->CSLSetNameValue(options, "BLOCKSIZE", "512");
    options = gdal->CSLSetNameValue(options, "COMPRESS", "DEFLATE");
    options = gdal->CSLSetNameValue(options, "PREDICTOR", "YES");
    options = gdal->CSLSetNameValue(options, "OVERVIEW_RESAMPLING", "AVERAGE");
    options = gdal->CSLSetNameValue(options, "NUM_THREADS", "ALL_CPUS"); /* of compression */
    options = gdal->CSLSetNameValue(options, "BIGTIFF", "IF_SAFER");
    progress_start(&t->progress, "tiles and overviews, %", 100);
    GDALDatasetH cog = gdal->GDALCreateCopy(gdal->GDALGetDriverByName("COG"), t->part, t->data,
                                            FALSE, options, geotiff_progress, t);
    progress_end(&t->progress, NULL);
    gdal->CSLDestroy(options);
    if (cog) {
        gdal->CPLErrorReset();
        gdal->GDALClose(cog);
    }
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    return cog && gdal->CPLGetLastErrorType() < CE_Failure
               ? ERR_OK
               : geotiff_fail(t, "the Cloud Optimized GeoTIFF could not be written", e);
}

enum err_code geotiff_commit(struct geotiff **tp, struct err *e)
{
    struct geotiff *t = *tp;
    gdal_errors_keep();
    gdal->CPLErrorReset();
    gdal->GDALFlushCache(t->data);
    enum err_code rc = gdal->CPLGetLastErrorType() < CE_Failure
                           ? ERR_OK
                           : geotiff_fail(t, "pixels could not be written", e);
    if (!rc)
        rc = geotiff_copy(t, e);
    gdal_errors_show();
    if (!rc)
        rc = file_commit(t->part, t->path, e);
    geotiff_close(tp);
    return rc;
}

void geotiff_close(struct geotiff **tp)
{
    static const char *const left[] = {"", "-base", ".ovr.tmp", ".msk.ovr.tmp"};
    struct geotiff *t = *tp;
    if (!t)
        return;
    if (t->data) {
        gdal_errors_keep();
        gdal->GDALClose(t->data);
        gdal_errors_show();
    }
    for (size_t i = 0; *t->part && i < sizeof left / sizeof *left; i++) {
        char name[FILE_PATH_MAX + 16];
        snprintf(name, sizeof name, "%s%s", t->part, left[i]);
        unlink(name); /* what was renamed is not there */
    }
    mem_free(t);
    *tp = NULL;
}
