/* What the scores of citysplat-lab have in common: options, a scene, and rows of JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_EVAL_LAB_H
#define LAB_EVAL_LAB_H

#include "cli/train/eval_city.h"

struct eval_lab_options {
    struct eval_city_options city;
#define OPT OPTIONS_MEMBER
#include "lab/eval/eval_lab.def"
};
struct eval_lab { /* {0} is empty; eval_lab_close */
    struct eval_lab_options o;
    struct eval_city city;
    struct json_t *rows; /* a JSON array */
    struct options_args args;
    struct arena arena;
};
/* Reads a command line, checks --output and opens the scene of the first argument with its test
 * photographs. `own`: the options of this command alone, into `options`. If v->args.done, --help
 * was answered and nothing is open. ERR_ARG. Errors of options_parse and eval_city_open. */
enum err_code eval_lab_open(struct eval_lab *v, const struct options_spec *own, int argc,
                            char **argv, void *options, size_t options_size, struct err *e) ERR_USE;
/* Writes the rows to --output, if it is given. ERR_IO, ERR_MEM. */
enum err_code eval_lab_write(const struct eval_lab *v, struct err *e) ERR_USE;
void eval_lab_close(struct eval_lab *v);

#endif
