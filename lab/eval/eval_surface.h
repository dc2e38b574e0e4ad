/* `citysplat-lab eval-surface`: solidity and errors of a scene's surface (lab/EVALUATION.md),
 * against a procedural city (eval_surface.c) or against the scene's own points (eval_points.c).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_EVAL_SURFACE_H
#define LAB_EVAL_SURFACE_H

#include "cli/train/eval_city.h"

struct json_t;

struct eval_surface_request {
    const char *city;  /* folder of the procedural city */
    const char *views; /* map views; NULL: those of the city, if there are any */
    const struct scene *scene;
    struct json_t *rows; /* a JSON array; the results are appended */
};
/* Measures against a city, without supersampling. Errors of truth_city_open, map_views_read and
 * rendering; ERR_CANCEL, ERR_MEM. */
enum err_code eval_surface_run(const struct eval_surface_request *q, struct render *render,
                               const struct eval_drawing *d, struct err *e) ERR_USE;

/* Measures a scene without a truth: depths in all photographs, against points that at least
 * EVAL_POINTS_SEEN of them show, and the solidity of the surface along the photographs' rays.
 * ERR_DATA: there are no such points. Errors of rendering; ERR_CANCEL, ERR_MEM. */
#define EVAL_SURFACE_POINTS "points" /* instead of a city's folder */
enum { EVAL_POINTS_SEEN = 5 };
enum err_code eval_points_run(const struct eval_surface_request *q, struct render *render,
                              const struct eval_drawing *d, struct err *e) ERR_USE;

#endif
