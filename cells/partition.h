/* Cells: which square of ground is trained from which photographs.
 *
 * A horizontal grid of edge P over the camera centres. A photograph belongs to a cell by location
 * (its centre lies in the cell grown by a margin) or by visibility (a large part of what it sees
 * lies in the cell: ratio of the convex hull of its own feature observations inside the cell to the
 * hull of all scene points it could see). Poor cells are merged, rich ones divided. Every Gaussian
 * is owned by exactly one cell. Source: REUrbanGS (ICCV 2025) section 3.1 and its supplement;
 * VastGaussian (2024) for visibility selection.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_PARTITION_H
#define CELLS_PARTITION_H

#include "cells/cell_grid.h"
#include "core/base.h"
#include "core/err.h"

struct arena;
struct scene;

struct partition_config { /* partition_defaults fills it */
    double edge_m;        /* P; 0 = one cell over everything */
    /* of P, on every side: cameras in the overlap belong to several cells */
    double location_margin;
    double visibility_gate; /* of P: a photograph farther from the cell is not considered */
    double visibility_min;  /* least hull ratio */
    size_t images_few;      /* cells with fewer photographs are merged where possible */
    size_t images_many;     /* cells with more are divided, down to an edge of P/2 */
    /* cells that still have fewer are not trained: background of a neighbour */
    size_t images_least;
    bool use_visibility; /* false: location alone (the ablation) */
    bool all_images;     /* true: test photographs train as well */
    struct cell_grid
        grid; /* {0}: along ENU, centred on the cameras; else squares meet its origin */
};
struct partition_config partition_defaults(void);

struct partition_cell {
    char id[24];               /* "x2y0", of its first grid square; stable over runs */
    double min_m[2], max_m[2]; /* x, y along the grid, which is ENU unless turned; half-open */
    /* indices into scene.images: first n_location by location, then by visibility */
    uint32_t *images;
    size_t n_images, n_location;
    size_t n_points;     /* reliable points inside */
    ptrdiff_t parent;    /* -1: trained; else the cell whose background this one is */
    uint32_t azimuth[8]; /* photographs by direction of view, octants clockwise from north: is a
                            side missing? */
};
struct partition { /* {0} is empty */
    double edge_m;
    struct cell_grid grid;        /* the axes of all boxes */
    struct partition_cell *cells; /* sorted by y, then x */
    size_t n_cells;
    size_t n_merged, n_divided; /* rebalancing steps */
    struct arena arena;
};

/* Make the cells. partition_free it. Deterministic. ERR_DATA: the scene has no photographs;
 * ERR_LIMIT: the edge makes more than 4,096 cells; ERR_MEM. */
enum err_code partition_make(const struct scene *s, const struct partition_config *cfg,
                             struct partition *out, struct err *e) ERR_USE;
void partition_free(struct partition *p);
/* The trained cell that owns a Gaussian at ENU (x, y): the one whose box holds it (half-open), else
 * the one whose box is nearest (ties: lowest index). Background cells hand over to their parent. */
size_t partition_owner(const struct partition *p, double x_m, double y_m);
/* Does an ENU box (x, y) lie within the box of cell `index` alone? */
bool partition_covers(const struct partition *p, size_t index, const double min_enu_m[2],
                      const double max_enu_m[2]);
/* Distance from (x, y), along the grid, to a cell's box, 0 inside. */
double partition_distance(const struct partition_cell *c, double x_m, double y_m);

#endif
