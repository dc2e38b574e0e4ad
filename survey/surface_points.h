/* The surface of a store as a cloud of coloured points, one at the middle of every pixel of a map.
 * Places below a roof are not visible and have no points. Walls are not visible from above; with
 * r->walls slanted rays from four sides find points on them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_SURFACE_POINTS_H
#define SURVEY_SURFACE_POINTS_H

#include "survey/map.h"

#define SURFACE_POINTS_MAX 4294967295.0 /* many readers count with 32 bits */

/* Writes LAS (survey/las.h) under another name and renames it. r->kind is GEOTIFF_COLOR, r->gsd_m
 * the distance of points. ERR_ARG: more than SURFACE_POINTS_MAX; the message says which distance is
 * possible. ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM as in map_run and las.h.
 */
enum err_code surface_points_write(struct nadir *n, const struct map_request *r, const char *path,
                                   struct map_report *report, struct err *e) ERR_USE;

#endif
