/* Turning places of the ground plane into a grid's axes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/cell_grid.h"

#include <math.h>

struct cell_grid cell_grid_make(double yaw_rad, const double origin_m[2])
{
    return (struct cell_grid){.turned = true,
                              .yaw_rad = yaw_rad,
                              .cos_yaw = cos(yaw_rad),
                              .sin_yaw = sin(yaw_rad),
                              .origin_m = {origin_m[0], origin_m[1]}};
}

void cell_grid_from_enu(const struct cell_grid *g, double east_m, double north_m, double out[2])
{
    double x = east_m - g->origin_m[0], y = north_m - g->origin_m[1];
    out[0] = g->turned ? g->cos_yaw * x + g->sin_yaw * y : east_m;
    out[1] = g->turned ? g->cos_yaw * y - g->sin_yaw * x : north_m;
}
