/* Internal to train/: checks whether a checkpoint belongs to this run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STATE_CHECK_H
#define TRAIN_STATE_CHECK_H

#include <stddef.h>

#include "core/err.h"

struct appearance_train;
struct cell;
struct inputs;
struct json_t; /* jansson.h */
struct train_config;

struct state_run { /* identity of a run; all borrowed */
    const struct train_config *cfg;
    const struct cell *cell;
    size_t n_images;                 /* training photographs */
    const struct inputs *inputs;     /* NULL: neither saved nor compared */
    const struct geo_origin *origin; /* of the scene; NULL: not saved */
};

/* Removes options that do not change the result from `config`, so that they do not change its bytes
 * either. */
void state_check_drop_free(struct json_t *config);
/* Compares options with `saved`, the "config" in the head of the checkpoint at `path`. ERR_ARG
 * names the first that differs. */
enum err_code state_check_config(const struct train_config *cfg, const char *path,
                                 const struct json_t *saved, struct err *e) ERR_USE;
/* Compares cell, number of photographs and inputs with the head `meta` of a checkpoint. The names
 * are not enough, because a new plan uses the same names for other cells. ERR_DATA: they differ.
 * ERR_FORMAT: the head is incomplete. */
enum err_code state_check_cell(const struct state_run *run, const char *path,
                               const struct json_t *meta, struct err *e) ERR_USE;
/* Checks whether a file is the result of a run with these options, cell, photographs and shared
 * appearance. ERR_ARG, ERR_DATA: it is not, and the message says what differs. ERR_NOENT, ERR_IO,
 * ERR_FORMAT: it cannot be read. */
enum err_code state_check_result(const struct state_run *run, const struct appearance_train *a,
                                 const char *path, struct err *e) ERR_USE;

#endif
