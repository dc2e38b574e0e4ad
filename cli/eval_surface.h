/* `citysplat eval --surface`: how solid a scene's surface is, and how far off (docs/evaluation.md).
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
/* Draws with src->own_size, or src->user, and src->above. */
enum err_code eval_surface_run(const struct eval_surface_request *q, const char *what,
                               struct render *render, const struct evaluate_source *src,
                               struct err *e) ERR_USE;

#endif
