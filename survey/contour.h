/* Contour lines of a store's surface, as GeoJSON in longitude and latitude, or as a GeoPackage in a
 * projection.
 *
 * The surface model is drawn into a file beside the target and read again row by row. Memory holds
 * one row of tiles, and the lines that are not finished.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CONTOUR_H
#define SURVEY_CONTOUR_H

#include "survey/map.h"

enum { CONTOUR_LEVELS_MAX = 10000 };

struct contour_request {
    struct map_request map; /* its kind is GEOTIFF_HEIGHT */
    double interval_m;      /* height between lines, which lie at its multiples */
    double least_m;         /* shorter lines are left out, in metres of the projection */
};
struct contour_report {
    struct map_report map;
    uint64_t lines, points, n_short;
};
/* Writes the lines. The extension of path is .geojson, .json or .gpkg. The file is written under
 * another name and renamed. ERR_ARG: another extension, or more than CONTOUR_LEVELS_MAX heights;
 * the message says what is allowed. ERR_IO, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM
 * as in map_run and geotiff.h. */
enum err_code contour_write(struct nadir *n, const struct contour_request *r, const char *path,
                            struct contour_report *report, struct err *e) ERR_USE;

#endif
