/* Rows of `citysplat eval --views`: drawings of a scene against map views (train/map_views.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EVAL_VIEWS_H
#define CLI_EVAL_VIEWS_H

#include "train/evaluate.h"

struct appearance_view;
struct json_t;
struct scene;

struct eval_views_request {
    const char *dir;      /* of the views */
    const char *pictures; /* folder for truth | drawing as NAME.png; NULL: none */
    const struct scene *scene;
    struct appearance_view *appearance; /* what the source draws with; NULL: without */
    bool exposure;                      /* the source draws at the mean exposure */
    struct json_t *rows;                /* a JSON array that the scores are added to */
};
void eval_views_print_head(void);
/* Score a source that draws with `render`: a row for each kind of view, one for all. */
enum err_code eval_views_run(const struct eval_views_request *q, const char *what,
                             struct render *render, const struct evaluate_source *src,
                             struct err *e) ERR_USE;

#endif
