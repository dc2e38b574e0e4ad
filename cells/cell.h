/* What one training job covers: a rectangle of the ground plane, or the whole scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_CELL_H
#define CELLS_CELL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "cells/cell_grid.h"

struct partition;
struct scene;

struct cell {    /* a rectangle of the ground plane; Gaussians outside serve as background */
    char id[32]; /* folder name below cells/ */
    bool whole;  /* the whole scene: everything is inside, the rectangle is not used */
    struct cell_grid grid;             /* the axes of the rectangle */
    double min_enu_m[2], max_enu_m[2]; /* east, north; along a turned grid its axes */
    double edge_m;   /* of an unmerged cell: unit of learning rates and of the distance ramp */
    double extent_m; /* 1.1 * largest distance of a camera from their mean: unit of sizes */
};
/* The single cell "all" of a scene. `images` lists the photographs used for training, at least one.
 */
void cell_whole(const struct scene *s, const uint32_t *images, size_t n_images, struct cell *out);
/* A cell of a plan; `images` lists its cameras by location, the measure of its extent. */
void cell_planned(const struct scene *s, const struct partition *p, size_t index,
                  const uint32_t *images, size_t n_images, struct cell *out);
/* Horizontal distance of a place from the rectangle, 0 inside. */
double cell_distance(const struct cell *c, double east_m, double north_m);
#endif
