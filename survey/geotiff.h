/* Cloud Optimized GeoTIFF by GDAL. Pieces are written in any order to a plain GeoTIFF beside the
 * target. geotiff_commit then makes tiles and overviews and renames the result.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_GEOTIFF_H
#define SURVEY_GEOTIFF_H

#include <stdbool.h>
#include <stdint.h>

#include "survey/crs.h"

#define GEOTIFF_NODATA -9999.0f /* of heights */

struct geotiff_info {
    const struct crs *crs;
    double west_m, north_m, pixel_m; /* top left corner and size of a pixel, in the projection */
    uint32_t width, height;
    const char *copyright, *source; /* may be NULL */
    const char *heights;            /* reference of heights, "height above the WGS 84 ellipsoid" */
    bool rows;                      /* the file will be read by rows */
};
enum geotiff_kind {
    GEOTIFF_COLOR,  /* red, green, blue, alpha: uint8 */
    GEOTIFF_HEIGHT, /* one band of float32, m; nodata GEOTIFF_NODATA */
    GEOTIFF_SURFACE /* two such bands: heights and their standard deviations */
};
struct geotiff;
/* Loads GDAL and starts it with only the GeoTIFF drivers, without files of its own, and with a
 * limited cache. Call it before GDAL opens any file. ERR_NOENT, ERR_INTERNAL: as gdal_load. */
enum err_code geotiff_start(struct err *e) ERR_USE;
/* Begins a file. End with geotiff_commit or geotiff_close. ERR_IO, ERR_MEM, ERR_LIMIT (the path is
 * too long), and those of geotiff_start. */
enum err_code geotiff_create(const char *path, enum geotiff_kind kind,
                             const struct geotiff_info *info, struct geotiff **out,
                             struct err *e) ERR_USE;
/* Writes a piece inside the picture. pixels: uint8 [h][w][4], float [h][w] or float [h][w][2].
 * Pixels that are never written are nodata. ERR_IO. */
enum err_code geotiff_write(struct geotiff *t, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                            const void *pixels, struct err *e) ERR_USE;
/* Reads row y [width] of a band (1 is the first) of the pixels that were written. ERR_IO. */
enum err_code geotiff_row(struct geotiff *t, int band, uint32_t y, float *row,
                          struct err *e) ERR_USE;
/* Adds a polygon for each area of pixels with the same whole number to an OGRLayerH, whose first
 * field gets the number. Corners are in pixels from the top left corner. Nodata pixels have no
 * polygon. ERR_IO. */
enum err_code geotiff_outline(struct geotiff *t, void *ogr_layer, struct err *e) ERR_USE;
/* Makes the final file; it closes *t in any case. ERR_IO. ERR_CANCEL: the program was told to stop.
 */
enum err_code geotiff_commit(struct geotiff **t, struct err *e) ERR_USE;
void geotiff_close(struct geotiff **t); /* without a commit nothing is left */

#endif
