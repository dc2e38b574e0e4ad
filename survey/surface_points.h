/* The surface of a store as a cloud of coloured points: one for every pixel of a map, at the
 * pixel's middle. What is below a roof or on a wall is not seen from above and has none.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_SURFACE_POINTS_H
#define SURVEY_SURFACE_POINTS_H

#include "survey/map.h"

#define SURFACE_POINTS_MAX 4294967295.0 /* many readers count with 32 bits */

/* LAS (survey/las.h), written beside and renamed; r->kind is GEOTIFF_COLOR, r->gsd_m the distance
 * of points. ERR_ARG: more than SURFACE_POINTS_MAX, says which distance fits; errors of map_run and
 * las.h: ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code surface_points_write(struct nadir *n, const struct map_request *r, const char *path,
                                   struct map_report *report, struct err *e) ERR_USE;

#endif
