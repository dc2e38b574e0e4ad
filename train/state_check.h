/* Inside of train/: does a checkpoint belong to this run?
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STATE_CHECK_H
#define TRAIN_STATE_CHECK_H

#include <stddef.h>

#include "core/err.h"

struct appearance_train;
struct cell;
struct json_t; /* jansson.h */
struct train_config;

struct state_run { /* which run it is; all borrowed */
    const struct train_config *cfg;
    const struct cell *cell;
    size_t n_images; /* training photographs */
};

/* Remove from resolved options those that do not change the result: it must not change its bytes
 * either. */
void state_check_drop_free(struct json_t *config);
/* ERR_ARG names the first option that differs from `saved`, the "config" of the head of the
 * checkpoint at `path` (for the message). */
enum err_code state_check_config(const struct train_config *cfg, const char *path,
                                 const struct json_t *saved, struct err *e) ERR_USE;
/* The cell and number of photographs of a checkpoint's head `meta`. A plan that was made anew gives
 * other cells the same names. ERR_DATA: another one; ERR_FORMAT: the head is incomplete. */
enum err_code state_check_cell(const struct state_run *run, const char *path,
                               const struct json_t *meta, struct err *e) ERR_USE;
/* Is this file the result of a run with these options, cell, photographs and shared appearance?
 * ERR_ARG, ERR_DATA: no, and the message says what is different; ERR_NOENT, ERR_IO, ERR_FORMAT: it
 * cannot be read. */
enum err_code state_check_result(const struct state_run *run, const struct appearance_train *a,
                                 const char *path, struct err *e) ERR_USE;

#endif
