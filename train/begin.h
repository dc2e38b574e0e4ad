/* Inside of train/: everything up to the first step of a cell.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_BEGIN_H
#define TRAIN_BEGIN_H

#include "cells/footprint.h"
#include "cells/trim.h"
#include "core/base.h"
#include "train/appearance_train.h"
#include "train/schedule.h"

struct run_cell;
struct train_cell_result;

struct begin { /* {.job, .lock_fd = -1} at first; begin_close, also after an error */
    const struct run_cell *job; /* borrowed */
    char dir[FILE_PATH_MAX], resume_path[FILE_PATH_MAX];
    bool resumes;            /* there is a state to go on from, and that is wanted */
    uint32_t *images, *held; /* photographs that train, and those held out */
    size_t n_images, n_held;
    struct schedule levels[TRAIN_LEVELS_MAX];
    size_t table[TRAIN_LEVELS_MAX];     /* budgets of the table, before --budget lowers them */
    struct appearance_train appearance; /* {0}: without; the level takes it over */
    struct footprint ground;            /* nx 0: not known */
    struct trim rim;
    int lock_fd;
};

/* The file of a level's result, level from 1. ERR_LIMIT: the path is too long. */
enum err_code begin_level_path(const struct begin *b, uint32_t level, char *out,
                               struct err *e) ERR_USE;
/* Lock the folder, look whether the run is finished (*done: *out is the finished result, and there
 * is nothing to do), choose photographs and budgets, look what is known of the ground, say what it
 * will take. ERR_BUSY, ERR_ARG, ERR_DATA, ERR_LIMIT, ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_MEM: as
 * run_cell. */
enum err_code begin_run(struct begin *b, struct train_cell_result *out, bool *done,
                        struct err *e) ERR_USE;
void begin_close(struct begin *b);
/* The first Gaussians of a run that does not resume. gauss_free them. ERR_DATA, ERR_MEM. */
enum err_code begin_gauss(const struct begin *b, const struct appearance_train *appearance,
                          struct gauss *out, struct err *e) ERR_USE;
/* The levels below `at` (from 0) were finished before this process: their scores into *out.
 * ERR_NOENT, ERR_FORMAT, ERR_IO: such a level's file; ERR_MEM. */
enum err_code begin_earlier_levels(const struct begin *b, uint32_t at,
                                   struct train_cell_result *out, struct err *e) ERR_USE;
/* config.jsonc beside the results: feeding the file back repeats the run. ERR_IO, ERR_MEM. */
enum err_code begin_write_config(const struct begin *b, struct err *e) ERR_USE;

#endif
