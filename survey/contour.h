/* Contour lines of a store's surface, as GeoJSON in longitude and latitude, or as a GeoPackage in a
 * projection.
 *
 * The surface model is drawn into a file beside the target and read again row by row, so memory
 * holds a row of tiles and the lines that are not finished yet.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CONTOUR_H
#define SURVEY_CONTOUR_H

#include "survey/map.h"

enum { CONTOUR_LEVELS_MAX = 10000 };

struct contour_request {
    struct map_request map; /* its kind is GEOTIFF_HEIGHT */
    double interval_m;      /* between lines */
    double base_m;          /* a height that has a line, if the surface reaches it */
    double least_m;         /* lines that are shorter are left out, metres of the projection */
    const char *field;      /* name of the height in the file */
};
struct contour_report {
    struct map_report map;
    uint64_t lines, points, n_short;
};
/* By the end of path: .geojson (or .json), .gpkg. Written beside and renamed. ERR_ARG: another end,
 * a field that cannot be one, more than CONTOUR_LEVELS_MAX heights, says what is allowed; ERR_IO;
 * errors of map_run and geotiff.h: ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code contour_write(struct nadir *n, const struct contour_request *r, const char *path,
                            struct contour_report *report, struct err *e) ERR_USE;

#endif
