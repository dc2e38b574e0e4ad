/* The footprint: ground that at least two photographs of a scene see, how finely they resolve it,
 * and the range of heights of its surface. Gaussians outside are guesses, and look wrong from any
 * view but the photographs'.
 *
 * It is a grid over the ground. Heights come from the sparse points. A photograph sees a cell if
 * the cell's middle lies in its picture; whether something is in between is not checked.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_FOOTPRINT_H
#define SCENE_CELLS_FOOTPRINT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct buf;
struct camera;
struct geo_origin;
struct scene;

enum {
    FOOTPRINT_VIEWS = 2,
    FOOTPRINT_DEEP_VIEWS = 3 /* least number of photographs that see ground well inside */
};
/* ground that is this many flight heights inside of the border is well inside */
#define FOOTPRINT_DEEP 0.2

struct footprint { /* {0} is empty: all ground counts as supported; free with footprint_free */
    double corner_m[2], cell_m; /* south-west corner of the grid, ENU; edge of a cell */
    size_t nx, ny;              /* row 0 is the southernmost */
    uint8_t *inside;            /* [ny][nx], 1: supported */
    /* [ny][nx] distance from the middle of a cell to the border, negative inside */
    float *edge_m;
    /* [ny][nx] heights of the surface and of what stands on it, with a margin */
    float *low_m, *high_m;
    float *ground_m; /* [ny][nx] height of the ground itself */
    uint16_t *views; /* [ny][nx] number of training photographs that see the ground */
    /* [ny][nx] 1: heights come from its own points, 0: from its neighbours */
    uint8_t *has_points;
    double height_m; /* median height of the flight above the ground */
    double fade_m;   /* distance from the border at which all Gaussians have faded */
    double margin_m; /* margin in low_m and high_m; a Gaussian may reach this far beyond them */
    double px_per_m; /* resolution of the nearest photograph, median over the ground inside */
};
/* Computes the footprint from training photographs and sparse points. If no ground is supported
 * (too few points or photographs) it warns, and *out is empty (nx 0). ERR_MEM. */
enum err_code footprint_of(const struct scene *s, struct footprint *out, struct err *e) ERR_USE;
/* Replaces the ground of the scene's footprint `f` by that of a GeoJSON file
 * (codec/container/geojson.h). Heights stay. Borders are accurate to half a cell of the grid.
 * ERR_DATA: it lies elsewhere. ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_FORMAT, ERR_DATA, ERR_MEM as in
 * geojson_read. */
enum err_code footprint_read(struct footprint *f, const char *path, const struct geo_origin *origin,
                             struct err *e) ERR_USE;
void footprint_free(struct footprint *f);
/* The factor, 0 to 1, for a Gaussian's opacity. mean [3] and covariance [3][3] are in ENU metres.
 * It is 1 well inside and 0 beyond the faded edge. A Gaussian that is large enough to reach outside
 * fades too. */
double footprint_weight(const struct footprint *f, const double mean_m[3], const double cov[9]);
/* Returns whether a cell of the grid lies well inside, and enough photographs see it. */
bool footprint_is_deep(const struct footprint *f, size_t cell);
/* Returns whether the ground under a place is supported. */
bool footprint_has(const struct footprint *f, const double x_m[3]);
/* Metres by which a place is above the highest sparse point around it, or below the lowest. Between
 * them it is negative. Outside the grid it is -HUGE_VAL: nothing is known. */
double footprint_off(const struct footprint *f, const double x_m[3]);
/* The cell where a ray from a camera meets the ground, or -1 outside the grid and above the
 * horizon. The direction may have any length. */
ptrdiff_t footprint_meets(const struct footprint *f, const double from_m[3], const double ray[3]);
/* The direction (ENU) of the ray through the middle of a pixel. */
void footprint_ray(const struct camera *c, double x_px, double y_px, double ray[3]);
/* Writes a GeoJSON Feature: the MultiPolygon with the properties views, px_per_m, area_m2 and the
 * range of heights. ERR_DATA: the footprint is empty. ERR_MEM. */
enum err_code footprint_write(const struct footprint *f, const struct geo_origin *origin,
                              struct buf *out, struct err *e) ERR_USE;

#endif
