/* Inside of train/: a cell's run in work, and everything up to its first step.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_BEGIN_H
#define TRAIN_BEGIN_H

#include "cells/footprint.h"
#include "cells/trim.h"
#include "core/base.h"
#include "train/forecast.h"
#include "train/level.h"
#include "train/timing.h"

struct run_cell;
struct train_cell_result;

struct run {
    struct level level;
    const struct run_cell *job; /* borrowed */
    const struct train_config *cfg;
    char dir[FILE_PATH_MAX], resume_path[FILE_PATH_MAX];
    struct progress progress;
    struct timing_seconds spent_before; /* when the level in work began */
    struct forecast forecast;
    double looked_s;      /* when steps were last counted for it */
    uint32_t looked_step; /* the step of that look */
    uint32_t looks;
    uint64_t last_saved; /* steps of this process when the state was last saved */
    struct train_cell_result *result;
    uint32_t *images; /* training, then held-out photographs */
    struct footprint ground;
    struct trim rim;
    int lock_fd;
};

/* The file of a level's result, level from 1. ERR_LIMIT: the path is too long. */
enum err_code begin_level_path(const struct run *t, uint32_t level, char *out,
                               struct err *e) ERR_USE;
/* Lock the folder, look whether the run is finished, resume or make the first Gaussians, say what
 * it will take. *done: there is nothing to do. Whoever calls closes what it opened, whatever comes.
 * ERR_BUSY, ERR_ARG, ERR_DATA, ERR_LIMIT, ERR_NOENT, ERR_IO, ERR_FORMAT,
 * ERR_MEM, ERR_DEVICE: as run_cell. */
enum err_code begin_run(struct run *t, bool *done, struct err *e) ERR_USE;

#endif
