/* The ground of one training job: a rectangle, or the whole scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_CELL_H
#define SCENE_CELLS_CELL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "scene/cells/cell_grid.h"

struct partition;
struct scene;

struct cell {              /* a rectangle of the ground plane; Gaussians outside are background */
    char id[32];           /* folder name below cells/ */
    bool whole;            /* the cell is the whole scene, and the rectangle is not used */
    struct cell_grid grid; /* the axes of the rectangle */
    double min_enu_m[2], max_enu_m[2]; /* east, north; in a turned grid x, y along its axes */
    bool cut; /* photographs are cut to what shows the cell (scene/cells/window.h) */
    const struct partition *plan; /* borrowed; NULL: the cell is of no plan */
    size_t index;                 /* of the cell in the plan */
    /* share of the configured steps that the cell takes; 0 counts as 1. Where photographs are cut,
     * it is in proportion to the cell's number of photographs, so every cell uses each of its
     * photographs equally often. The cell with most photographs takes all steps. */
    double steps_share;
    /* edge of a cell before merging: unit of learning rates and of the distance ramp */
    double edge_m;
    /* 1.1 * largest distance of a camera from the cameras' mean, of the cameras in the cell: larger
     * Gaussians are split rather than cloned by this unit */
    double extent_m;
    /* the same length over all cameras of the scene. Gaussians are removed as too large by this
     * unit: the ground around a small cell rightly has Gaussians larger than extent_m allows. */
    double scene_extent_m;
};
/* Makes the only cell, "all", of a scene without a plan. `images` lists the training photographs,
 * at least one. */
void cell_whole(const struct scene *s, const uint32_t *images, size_t n_images, struct cell *out);
/* Makes cell `index` of a plan. `images` lists the photographs whose cameras lie in it; they give
 * its extent. */
void cell_planned(const struct scene *s, const struct partition *p, size_t index,
                  const uint32_t *images, size_t n_images, struct cell *out);
/* Horizontal distance of a place from the rectangle in metres, 0 inside. */
double cell_distance(const struct cell *c, double east_m, double north_m);
#endif
