/* The axes of a partition's boxes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_CELL_GRID_H
#define SCENE_CELLS_CELL_GRID_H

#include <stdbool.h>

/* Axes turned by `yaw_rad` counter-clockwise from east. origin_m (ENU) is a corner of squares. {0}:
 * the axes of ENU. */
struct cell_grid {
    bool turned; /* false: the other members are not used */
    double yaw_rad, cos_yaw, sin_yaw, origin_m[2];
};
struct cell_grid cell_grid_make(double yaw_rad, const double origin_m[2]);
/* Converts ENU metres to metres along the grid. */
void cell_grid_from_enu(const struct cell_grid *g, double east_m, double north_m, double out[2]);

#endif
