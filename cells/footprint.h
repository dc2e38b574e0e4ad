/* What the photographs of a scene support: the ground that at least two of them see, how finely
 * they resolve it, and between which heights its surface lies. What was trained elsewhere is
 * guesswork, and looks like it from any side but the photographs'.
 *
 * A grid over the ground. Heights are those of the sparse points; a cell counts as seen by the
 * photographs whose picture its middle falls into. Nothing is said about what hides what.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_FOOTPRINT_H
#define CELLS_FOOTPRINT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct buf;
struct camera;
struct geo_origin;
struct scene;

enum { FOOTPRINT_VIEWS = 2 };

struct footprint {              /* {0} is empty: everything is supported; footprint_free */
    double corner_m[2], cell_m; /* south-west corner of the grid, ENU; edge of a cell */
    size_t nx, ny;              /* row 0 is the southernmost */
    uint8_t *inside;            /* [ny][nx] */
    float *edge_m;         /* [ny][nx] from the middle of a cell to the border, negative inside */
    float *low_m, *high_m; /* [ny][nx] of the surface and what stands on it, with a margin */
    float *ground_m;       /* [ny][nx] of the ground itself */
    uint16_t *views;       /* [ny][nx] training photographs that the ground falls into */
    uint8_t *has_points;   /* [ny][nx] its heights are its own, not its neighbours' */
    double height_m;       /* of the flight above the ground, median */
    double fade_m;         /* from the border to where nothing is left */
    double margin_m;       /* in low_m and high_m; as far may a Gaussian reach beyond them */
    double px_per_m;       /* median over the ground inside of the nearest photograph's */
};
/* From the training photographs and the sparse points. Empty (nx 0, with a warning) where no ground
 * is supported: too few points or photographs. ERR_MEM. */
enum err_code footprint_of(const struct scene *s, struct footprint *out, struct err *e) ERR_USE;
/* The ground from a GeoJSON file instead (codec/geojson.h), heights as above: `f` is that of the
 * scene. Borders are kept to half a cell of the grid. ERR_DATA: it lies elsewhere; errors of
 * geojson_read: ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_FORMAT, ERR_DATA, ERR_MEM. */
enum err_code footprint_read(struct footprint *f, const char *path, const struct geo_origin *origin,
                             struct err *e) ERR_USE;
void footprint_free(struct footprint *f);
/* How much of a Gaussian's opacity is left, 0 to 1: mean [3] and covariance [3][3] in ENU metres. 1
 * well inside, 0 beyond the faded edge; what is so large that it reaches out fades, too. */
double footprint_weight(const struct footprint *f, const double mean_m[3], const double cov[9]);
/* Is the ground under a place supported? */
bool footprint_has(const struct footprint *f, const double x_m[3]);
/* Metres by which a place lies above the highest sparse point around it, or below the lowest;
 * negative between them, -HUGE_VAL beyond the grid, where nothing is known. */
double footprint_off(const struct footprint *f, const double x_m[3]);
/* The cell in which a ray from a camera meets the ground; -1 beyond the grid and above the horizon.
 * The direction has any length. */
ptrdiff_t footprint_meets(const struct footprint *f, const double from_m[3], const double ray[3]);
/* The direction of the ray through a pixel's middle, ENU. */
void footprint_ray(const struct camera *c, double x_px, double y_px, double ray[3]);
/* A GeoJSON Feature: the MultiPolygon, with views, px_per_m, area_m2 and the range of
 * heights as properties. ERR_DATA where it is empty. */
enum err_code footprint_write(const struct footprint *f, const struct geo_origin *origin,
                              struct buf *out, struct err *e) ERR_USE;

#endif
