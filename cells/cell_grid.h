/* The axes along which a partition's boxes lie.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_CELL_GRID_H
#define CELLS_CELL_GRID_H

#include <stdbool.h>

/* Axes of a partition's grid: turned by `yaw_rad` counter-clockwise from east about `origin_m`,
 * which is a corner of squares. {0}: those of ENU. */
struct cell_grid {
    bool turned; /* else the rest is not looked at */
    double yaw_rad, cos_yaw, sin_yaw, origin_m[2];
};
struct cell_grid cell_grid_make(double yaw_rad, const double origin_m[2]);
/* ENU metres to metres along the grid. */
void cell_grid_from_enu(const struct cell_grid *g, double east_m, double north_m, double out[2]);

#endif
