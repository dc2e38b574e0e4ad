/* `citysplat eval --surface`: how solid a scene's surface is, and how far off (docs/evaluation.md):
 * against a procedural city (eval_surface.c), or against the scene's own points (eval_points.c).
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
    const char *views; /* map views; NULL: the city's own, if it has some */
    const struct scene *scene;
    double gaussians, faint; /* how many; share of opacity below 0.5; NAN: not known */
    struct json_t *rows;     /* a JSON array that the figures are added to */
};
#define EVAL_SURFACE_FAINT 0.5
void eval_surface_print_head(const struct eval_surface_request *q, const char *what, double gsd_m);
/* Draws with src->own_size, or src->user, and src->above. Errors of truth_city_open, map_views_read
 * and rendering; ERR_CANCEL, ERR_MEM. */
enum err_code eval_surface_run(const struct eval_surface_request *q, const char *what,
                               struct render *render, const struct evaluate_source *src,
                               struct err *e) ERR_USE;

/* A scene without a truth: depths in all photographs against the points that EVAL_POINTS_SEEN of
 * them show, and how solid the surface is along the photographs' rays. ERR_DATA: there are no such
 * points; errors of rendering; ERR_CANCEL, ERR_MEM. */
#define EVAL_SURFACE_POINTS "points" /* in place of a city's folder */
enum { EVAL_POINTS_SEEN = 5 };
enum err_code eval_points_run(const struct eval_surface_request *q, const char *what,
                              struct render *render, const struct evaluate_source *src,
                              struct err *e) ERR_USE;

#endif
