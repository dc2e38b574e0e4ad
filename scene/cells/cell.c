/* Training cells: the rectangle of ground of one job, and its units of length.
 *
 * edge_m is the side of a cell: the unit of learning rates of positions and of the ramp of
 * thresholds outside. extent_m is 1.1 times the largest distance of a camera from the cameras' mean
 * (the scene extent of 3D Gaussian Splatting): it tells which Gaussians are split. scene_extent_m
 * is the same of the whole scene: it tells which Gaussians are too large to be kept. In a whole
 * scene edge_m is the larger side of the box around the cameras, or their height above the points
 * if they hardly move.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "codec/scene/scene.h"
#include "scene/cells/cell.h"
#include "scene/cells/partition.h"

#define CELL_EXTENT_FACTOR 1.1
#define CELL_SMALLEST_M 1e-3

/* images [n]: NULL for all of the scene. */
static void cell_camera_box(const struct scene *s, const uint32_t *images, size_t n, double lo[3],
                            double hi[3], double mean[3])
{
    for (int k = 0; k < 3; k++) {
        lo[k] = HUGE_VAL;
        hi[k] = -HUGE_VAL;
        mean[k] = 0.0;
    }
    for (size_t i = 0; i < n; i++) {
        double c[3];
        camera_center(&s->images[images ? images[i] : i].cam, c);
        for (int k = 0; k < 3; k++) {
            lo[k] = fmin(lo[k], c[k]);
            hi[k] = fmax(hi[k], c[k]);
            mean[k] += c[k] / (double)n;
        }
    }
}

static double cell_length3(const double a[3], const double b[3])
{
    double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
}

static double cell_extent(const struct scene *s, const uint32_t *images, size_t n)
{
    double lo[3], hi[3], mean[3], far = 0.0;
    cell_camera_box(s, images, n, lo, hi, mean);
    for (size_t i = 0; i < n; i++) {
        double c[3];
        camera_center(&s->images[images ? images[i] : i].cam, c);
        far = fmax(far, cell_length3(c, mean));
    }
    return CELL_EXTENT_FACTOR * far;
}

void cell_whole(const struct scene *s, const uint32_t *images, size_t n_images, struct cell *out)
{
    double lo[3], hi[3], mean[3], points[3] = {0};
    *out = (struct cell){.id = "all", .whole = true};
    cell_camera_box(s, images, n_images, lo, hi, mean);
    for (size_t i = 0; i < s->n_points; i++)
        for (int k = 0; k < 3; k++)
            points[k] += s->points[i].enu_m[k] / (double)s->n_points;
    double height = s->n_points ? cell_length3(points, mean) : 0.0;
    out->edge_m = fmax(fmax(hi[0] - lo[0], hi[1] - lo[1]), fmax(height, CELL_SMALLEST_M));
    out->extent_m = fmax(cell_extent(s, images, n_images), 0.5 * out->edge_m);
    out->scene_extent_m = out->extent_m;
    for (int k = 0; k < 2; k++) {
        out->min_enu_m[k] = lo[k];
        out->max_enu_m[k] = hi[k];
    }
}

void cell_planned(const struct scene *s, const struct partition *p, size_t index,
                  const uint32_t *images, size_t n_images, struct cell *out)
{
    const struct partition_cell *c = &p->cells[index];
    *out = (struct cell){.whole = p->n_cells == 1, .grid = p->grid, .plan = p, .index = index};
    snprintf(out->id, sizeof out->id, "%s", c->id);
    for (int k = 0; k < 2; k++) {
        out->min_enu_m[k] = c->min_m[k];
        out->max_enu_m[k] = c->max_m[k];
    }
    out->edge_m =
        p->edge_m > 0.0 ? p->edge_m : fmax(c->max_m[0] - c->min_m[0], c->max_m[1] - c->min_m[1]);
    out->edge_m = fmax(out->edge_m, CELL_SMALLEST_M);
    out->extent_m = fmax(cell_extent(s, images, n_images), 0.5 * out->edge_m);
    out->scene_extent_m = fmax(cell_extent(s, NULL, s->n_images), out->extent_m);
    out->cut = !out->whole && p->share_min > 0.0;
    size_t most = c->n_images;
    for (size_t i = 0; i < p->n_cells; i++)
        if (p->cells[i].parent < 0 && p->cells[i].n_images > most)
            most = p->cells[i].n_images;
    out->steps_share = out->cut && most ? (double)c->n_images / (double)most : 1.0;
}

double cell_distance(const struct cell *c, double east_m, double north_m)
{
    if (c->whole)
        return 0.0;
    const double *lo = c->min_enu_m, *hi = c->max_enu_m;
    double at[2];
    cell_grid_from_enu(&c->grid, east_m, north_m, at);
    double dx = fmax(fmax(lo[0] - at[0], at[0] - hi[0]), 0.0);
    double dy = fmax(fmax(lo[1] - at[1], at[1] - hi[1]), 0.0);
    return sqrt(dx * dx + dy * dy);
}
