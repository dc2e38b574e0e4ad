/* What happens at which step of a level.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SCHEDULE_H
#define TRAIN_SCHEDULE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "train/config.h"

struct schedule {             /* of one level; steps are 1-based and restart at every level */
    uint32_t level, n_levels; /* 1 .. n_levels, 1 = coarsest */
    uint32_t steps;
    double downsample;
    size_t budget;         /* Gaussians inside the cell */
    size_t around;         /* Gaussians of the coarse model that stand around the cell */
    bool stopped;          /* --budget-rule auto: growth has ended ... */
    size_t budget_outside; /* ... with so many outside of the cell; before, half of the budget */
    uint32_t interval, densify_from,
        densify_until; /* densify when from < step < until and interval | step */
    uint32_t reset_interval;
    uint32_t size_from;              /* huge Gaussians are removed after this step */
    uint32_t sh_interval, sh_degree; /* sh_interval 0: the full degree from the start */
    bool absgrad;
    bool mcmc; /* --strategy mcmc: no opacity resets, and moved for longer */
    double tau;
    double lr_factor; /* on the learning rates of positions (included below), sizes and rotations */
    double lr_mean_first, lr_mean_last; /* metres */
    double
        kappa; /* factor on all lengths: photographs / 600 when more, or the share of a short run */
};
struct cell;
/* Fill out[0 .. level_count). ERR_ARG when a level would have no steps. */
enum err_code schedule_make(const struct train_config *cfg, size_t n_photos,
                            const struct cell *cell, struct schedule out[TRAIN_LEVELS_MAX],
                            struct err *e) ERR_USE;
/* Ceiling of Gaussians inside the cell at densification x of n: a parabola from start (x = 0) to
 * exactly budget (x = n - 1), fast first. start >= budget: start. n <= 1: budget. */
size_t schedule_cap(size_t start, size_t budget, uint32_t x, uint32_t n);
/* Gaussians outside of the cell that a level may have: those it began with, and some more. */
size_t schedule_cap_outside(const struct schedule *s);
/* Gaussians inside the cell and outside of it that a level's budget allows. */
size_t schedule_most(const struct schedule *s, const struct cell *cell);
/* Number n of schedule_cap, counting x = 0, which no step uses. */
uint32_t schedule_densify_count(const struct schedule *s);
/* x of this step, or 0 when it does not densify. */
uint32_t schedule_densify_index(const struct schedule *s, uint32_t step);
bool schedule_resets(const struct schedule *s, uint32_t step);
/* May a densification at this step remove Gaussians for their size? */
bool schedule_limits_size(const struct schedule *s, uint32_t step);
uint32_t schedule_sh_degree(const struct schedule *s, uint32_t step);
double schedule_lr_mean(const struct schedule *s, uint32_t step);
#endif
