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
    const char *dir;      /* folder of the views */
    const char *pictures; /* folder for pictures "truth | drawing", NAME.png; NULL: none */
    const struct scene *scene;
    struct appearance_view *appearance; /* appearance that the source draws with; NULL: none */
    bool exposure;                      /* the source draws at the mean exposure */
    struct json_t *rows;                /* a JSON array; the scores are appended */
};
void eval_views_print_head(void);
/* Scores a source that draws with `render`: one row for each kind of view, and one for all. Errors
 * as map_views.h. */
enum err_code eval_views_run(const struct eval_views_request *q, const char *what,
                             struct render *render, const struct evaluate_source *src,
                             struct err *e) ERR_USE;

#endif
