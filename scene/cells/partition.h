/* Divides a scene into cells: squares of ground, and the photographs that train each.
 *
 * A horizontal grid with squares of edge P covers the camera centres. A photograph belongs to a
 * cell by location or by visibility. By location: its centre lies in the cell grown by a margin. By
 * visibility: a large part of what it sees lies in the cell. That part is a ratio of two convex
 * hulls in the picture: of its own feature observations inside the cell, and of all scene points
 * that it could see. Cells with few photographs are merged, those with many are divided. Every
 * Gaussian belongs to exactly one cell. Source: REUrbanGS (ICCV 2025) section 3.1 and its
 * supplement; VastGaussian (2024) for visibility selection.
 *
 * These photographs may be replaced by all that show enough of the cell (scene/cells/share.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_PARTITION_H
#define SCENE_CELLS_PARTITION_H

#include "core/base.h"
#include "core/err.h"
#include "scene/cells/cell_grid.h"

struct arena;
struct scene;

struct partition_config { /* filled by partition_defaults */
    double edge_m;        /* P; 0 = one cell for everything */
    /* share of P by which a cell grows on every side; cameras in the overlap belong to several
     * cells */
    double location_margin;
    size_t images_few;  /* cells with fewer photographs are merged where possible */
    size_t images_many; /* cells with more photographs are divided, down to an edge of P/2 */
    /* cells that still have fewer photographs are not trained: they are a neighbour's background */
    size_t images_least;
    bool use_visibility; /* false: location alone, for comparison */
    /* {0}: along ENU, centred on the cameras; else its origin is a corner of squares */
    struct cell_grid grid;
};
struct partition_config partition_defaults(void);

struct partition_cell {
    char id[24];               /* "x2y0", from its first grid square; the same in every run */
    double min_m[2], max_m[2]; /* x, y along the grid; half-open */
    /* indices into scene.images: first n_location by location, then those by visibility */
    uint32_t *images;
    size_t n_images, n_location;
    size_t n_points;  /* reliable points inside */
    ptrdiff_t parent; /* -1: trained; else the cell that has this one as background */
    /* number of photographs by direction of view, in octants clockwise from north */
    uint32_t azimuth[8];
};
struct partition { /* {0} is empty; free with partition_free */
    double edge_m;
    struct cell_grid grid;        /* the axes of all boxes */
    struct partition_cell *cells; /* sorted by y, then x */
    size_t n_cells;
    size_t n_merged, n_divided; /* number of merges and divisions */
    double share_min;           /* as given to share_photographs; above 0, photographs are cut */
    struct arena arena;
};

/* Makes the cells. Free *out with partition_free. The result is deterministic. ERR_DATA: the scene
 * has no photographs. ERR_LIMIT: there would be more than 4,096 cells. ERR_MEM. */
enum err_code partition_make(const struct scene *s, const struct partition_config *cfg,
                             struct partition *out, struct err *e) ERR_USE;
void partition_free(struct partition *p);
/* The trained cell that owns a Gaussian at ENU (x, y). It is the cell whose half-open box contains
 * the place, else the nearest one (the lowest index if several are equally near). A background cell
 * passes its Gaussians to its parent. */
size_t partition_owner(const struct partition *p, double x_m, double y_m);
/* Returns whether an ENU box (x, y) lies in the box of cell `index` and of no other. */
bool partition_covers(const struct partition *p, size_t index, const double min_enu_m[2],
                      const double max_enu_m[2]);
/* Counts the photographs of a cell by the direction from which they see its middle. */
void partition_count_azimuth(const struct scene *s, const struct cell_grid *g,
                             struct partition_cell *c);
/* Distance from (x, y), along the grid, to a cell's box, 0 inside. */
double partition_distance(const struct partition_cell *c, double x_m, double y_m);

#endif
