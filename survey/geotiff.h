/* Cloud Optimized GeoTIFF by GDAL: pieces in any order into a plain GeoTIFF beside the target,
 * which geotiff_commit turns into tiles and overviews and renames.
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
    const char *heights;            /* what they are, "height above the WGS 84 ellipsoid" */
    bool rows;                      /* it will be read by rows, and not committed */
};
enum geotiff_kind {
    GEOTIFF_COLOR, /* red, green, blue, alpha: uint8 */
    GEOTIFF_HEIGHT /* one band of float32, m; nodata GEOTIFF_NODATA */
};
struct geotiff;
/* GDAL with the drivers of GeoTIFF alone, no files of its own beside ours, and a bounded cache.
 * Whatever opens a file by GDAL calls it first. */
void geotiff_start(void);
/* ERR_IO, ERR_MEM, ERR_LIMIT (a path too long). */
enum err_code geotiff_create(const char *path, enum geotiff_kind kind,
                             const struct geotiff_info *info, struct geotiff **out,
                             struct err *e) ERR_USE;
/* pixels: uint8 [h][w][4] or float [h][w]; inside of the picture. What is never written is nodata.
 * ERR_IO. */
enum err_code geotiff_write(struct geotiff *t, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                            const void *pixels, struct err *e) ERR_USE;
/* Row y of heights that were written [width]. ERR_IO. */
enum err_code geotiff_row(struct geotiff *t, uint32_t y, float *row, struct err *e) ERR_USE;
/* Make the file; closes in any case. ERR_IO; ERR_CANCEL when the program was told to stop. */
enum err_code geotiff_commit(struct geotiff **t, struct err *e) ERR_USE;
void geotiff_close(struct geotiff **t); /* without a commit: nothing is left behind */

#endif
