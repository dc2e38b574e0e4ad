/* `citysplat eval --surface`: solidity and errors of a scene's surface (lab/EVALUATION.md),
 * against a procedural city (eval_surface.c) or against the scene's own points (eval_points.c).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EVAL_SURFACE_H
#define CLI_EVAL_SURFACE_H

#include "train/evaluate.h"

struct json_t;
struct scene;

struct eval_surface_request {
    const char *city;  /* folder of the procedural city */
    const char *views; /* map views; NULL: those of the city, if there are any */
    const struct scene *scene;
    /* number of Gaussians; share with an opacity below 0.5; NAN: not known */
    double gaussians, faint;
    struct json_t *rows; /* a JSON array; the results are appended */
};
#define EVAL_SURFACE_FAINT 0.5
void eval_surface_print_head(const struct eval_surface_request *q, const char *what, double gsd_m);
/* Measures against a city. It draws with src->own_size (else src->user) and src->above. Errors of
 * truth_city_open, map_views_read and rendering; ERR_CANCEL, ERR_MEM. */
enum err_code eval_surface_run(const struct eval_surface_request *q, const char *what,
                               struct render *render, const struct evaluate_source *src,
                               struct err *e) ERR_USE;

/* Measures a scene without a truth: depths in all photographs, against points that at least
 * EVAL_POINTS_SEEN of them show, and the solidity of the surface along the photographs' rays.
 * ERR_DATA: there are no such points. Errors of rendering; ERR_CANCEL, ERR_MEM. */
#define EVAL_SURFACE_POINTS "points" /* instead of a city's folder */
enum { EVAL_POINTS_SEEN = 5 };
enum err_code eval_points_run(const struct eval_surface_request *q, const char *what,
                              struct render *render, const struct evaluate_source *src,
                              struct err *e) ERR_USE;

#endif
