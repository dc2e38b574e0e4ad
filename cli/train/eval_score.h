/* Scores of a city against photographs, as rows of a table and of JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EVAL_SCORE_H
#define CLI_EVAL_SCORE_H

#include "cli/train/eval_city.h"
#include "scene/cells/footprint.h"
#include "train/photographs/evaluate.h"

struct photo_loader;
struct residual_list;

struct eval_score {       /* {0} is empty; eval_score_close */
    const char *pictures; /* folder for photograph and drawing side by side; NULL: none */
    const struct evaluate_more *more; /* one more score, borrowed; NULL: none */
    struct footprint ground;          /* what training photographs show */
    struct json_t *rows;              /* a JSON array, borrowed */
};
/* `pictures`, `more` and `rows` are set before. Errors of footprint_of. */
enum err_code eval_score_open(struct eval_city *c, struct eval_score *out, struct err *e) ERR_USE;
void eval_score_close(struct eval_score *s);

void eval_score_print_head(void);
/* Prints a row and appends it to s->rows. ERR_MEM. */
enum err_code eval_score_row(struct eval_score *s, const char *what, uint32_t edge_px,
                             const struct evaluate_score *score, struct err *e) ERR_USE;
/* Opens the photographs that a drawing is scored at. *edge_px: the longest edge of the first.
 * Errors of photo_loader_open. */
enum err_code eval_score_load(const struct eval_city *c, const struct eval_drawing *d,
                              struct photo_loader **out, uint32_t *edge_px, struct err *e) ERR_USE;
/* Scores a drawing: a row. `residuals`: gets the error of each photograph; NULL: not wanted. Errors
 * of evaluate_run; ERR_MEM. */
enum err_code eval_score_drawing(struct eval_score *s, const struct eval_city *c,
                                 const struct eval_drawing *d, struct photo_loader *photos,
                                 uint32_t edge_px, struct residual_list *residuals,
                                 struct err *e) ERR_USE;

/* Gives the folder for pictures of a row in `pictures`; *out is NULL if that is NULL. ERR_LIMIT. */
enum err_code eval_score_folder(const char *pictures, const char *what, char path[FILE_PATH_MAX],
                                const char **out, struct err *e) ERR_USE;
/* Writes the rows as JSON; path NULL: nowhere. ERR_IO, ERR_MEM. */
enum err_code eval_score_write(const struct eval_city *c, const struct json_t *rows,
                               const char *path, struct err *e) ERR_USE;

#endif
