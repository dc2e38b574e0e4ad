/* What a training will take, before there is a scene: the schedule, budgets, memory and forecast of
 * training, for photographs of which only number and size are known.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_EXPECT_H
#define TRAIN_EXPECT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "train/base/config.h"

struct run_cell;

/* Share of the cores that a training keeps busy: with it, recorded times by the clock agree with
 * processor seconds of other runs. */
#define EXPECT_BUSY 0.9

struct expect_photos {
    size_t n_train, n_test;
    uint32_t width_px, height_px; /* as ingest will store them */
    bool depths;                  /* depth maps of `citysplat stereo` will be there */
};
struct expect {
    size_t gaussians[TRAIN_LEVELS_MAX]; /* most of each level, coarsest first */
    uint64_t steps;
    double cpu_s;            /* processor seconds on the usual machine */
    double memory_bytes;     /* most, with the program itself */
    double checkpoint_bytes; /* of all levels */
};
/* Fills *out for one cell with these options. ERR_ARG: as schedule_make. ERR_MEM. */
enum err_code expect_training(const struct train_config *cfg, const struct expect_photos *photos,
                              struct expect *out, struct err *e) ERR_USE;
/* The same for a cell of a scene: its own photographs and points, the parts of them that show the
 * cell, and its share of the steps. n_around: most Gaussians of a coarse model that it begins from;
 * 0: from points. ERR_ARG, ERR_DATA, ERR_LIMIT: as when it is trained. ERR_MEM. */
enum err_code expect_cell(const struct run_cell *job, size_t n_around, struct expect *out,
                          struct err *e) ERR_USE;

#endif
