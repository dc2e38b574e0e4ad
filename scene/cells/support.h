/* The number of training photographs that see each place of a city, with what stands in front of
 * the place taken into account. The footprint counts photographs that show a place; behind a tree
 * or a house none of them may see it. Heights there are guesses, and a surface model gives them a
 * large standard deviation (lod/surface/surface.h).
 *
 * It is a grid over the ground. The surface of a cell is its highest opaque Gaussian, without
 * columns that stand alone. A photograph sees a cell if its picture holds the cell's surface and no
 * surface on the way to the camera rises above the ray.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_SUPPORT_H
#define SCENE_CELLS_SUPPORT_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct buf;
struct footprint;
struct scene;

struct support {                /* {0} is empty; free with support_free */
    double corner_m[2], cell_m; /* south-west corner of the grid, ENU; edge of a cell */
    size_t nx, ny;              /* row 0 is the southernmost */
    float *top_m;               /* [ny][nx] height of the surface; NAN: no opaque Gaussian */
    uint8_t *views;             /* [ny][nx] photographs, at most SEEN_VIEWS_MAX */
};
/* An empty grid over the ground of a footprint. ERR_MEM. */
enum err_code support_open(const struct footprint *f, struct support *out, struct err *e) ERR_USE;
void support_free(struct support *s);
/* Raises the surface under a Gaussian's mean (ENU metres). Gaussians of opacity below a half do not
 * count. One thread at a time. */
void support_add(struct support *s, const double mean_m[3], double opacity);
/* Counts the training photographs that see each cell, after all Gaussians are there. ERR_MEM. */
enum err_code support_count(struct support *s, const struct scene *scene, struct err *e) ERR_USE;
/* Appends the blob that a store keeps (codec/container/seen.h). ERR_MEM. */
enum err_code support_write(const struct support *s, struct buf *out, struct err *e) ERR_USE;

#endif
