/* What happens at which step of a level.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SCHEDULE_H
#define TRAIN_SCHEDULE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "train/base/config.h"

struct schedule { /* schedule of one level; steps are 1-based and restart at every level */
    uint32_t level, n_levels; /* 1 .. n_levels, 1 = coarsest */
    uint32_t turn;            /* from 1: which of them is trained first, second, ... */
    uint32_t steps;
    uint32_t tuned; /* --level-order both: steps of the level when it is made of the finer one */
    double downsample;
    size_t budget; /* most Gaussians inside the cell at the end */
    size_t around; /* Gaussians of the coarse model around the cell */
    uint32_t interval, densify_from,
        densify_until;               /* densify if from < step < until and interval | step */
    uint32_t size_from;              /* Gaussians that are too large are removed after this step */
    uint32_t sh_interval, sh_degree; /* sh_interval 0: full degree from the start */
    bool absgrad;
    bool derived;      /* made of the next finer level by thinning, and fine-tuned without growth */
    double thin_share; /* derived: the part of the finer level's Gaussians that is left */
    bool last;  /* after the level's own steps: what fades during a level stays as at its end */
    bool still; /* positions, sizes, rotations and opacities stay; only colours learn */
    double tau;
    /* factor on learning rates of positions (included in those below), sizes and rotations */
    double lr_factor;
    double lr_mean_first, lr_mean_last; /* metres */
    /* after this step all rates fall, to the part fade_to at the end */
    uint32_t fade_from;
    double fade_to;
    /* factor on step counts: photographs / 600 if above 1, or the part of the full length that a
     * short run has */
    double kappa;
};
struct cell;
/* --level-order, in the order of options.def. */
enum schedule_order { SCHEDULE_COARSE_TO_FINE, SCHEDULE_BOTH };
/* Part of the finest level in which its rates fall, its last
 * (docs/decisions/013-rates-and-length.md). */
#define SCHEDULE_FADE_SHARE 0.2
/* Steps of all levels together that --iterations or its default asks for. 0: a list gives the steps
 * of each level. */
int64_t schedule_asked(const struct train_config *cfg, size_t n_photos);
/* Steps of all levels in a run of full length, before they grow with the photographs. */
double schedule_full(const struct train_config *cfg);
/* Fills out[0 .. level_count). ERR_ARG: a level would have no steps. */
enum err_code schedule_make(const struct train_config *cfg, size_t n_photos,
                            const struct cell *cell, struct schedule out[TRAIN_LEVELS_MAX],
                            struct err *e) ERR_USE;
/* The level when it is made of the finer one, with --level-order both. Both of
 * schedule_make. */
struct schedule schedule_again(const struct schedule *s, const struct schedule *finer,
                               const struct train_config *cfg);
/* Ratio of the largest number of Gaussians to the budget: above 1 where the level is thinned after
 * it has grown, else 1. */
double schedule_growth(const struct schedule *s);
/* The largest number itself, inside the cell. */
size_t schedule_grows(const struct schedule *s);
/* Largest number of Gaussians inside the cell at densification x of n: a parabola that rises fast
 * at first, from `start` at x = 0 to `most` at x = n - 1. If start >= most it is start. If n <= 1
 * it is most. */
size_t schedule_cap(size_t start, size_t most, uint32_t x, uint32_t n);
/* Largest number of Gaussians outside the cell: those that the level began with, and some more. */
size_t schedule_cap_outside(const struct schedule *s);
/* Largest number of Gaussians, inside the cell and outside, that a level ever has. */
size_t schedule_most(const struct schedule *s, const struct cell *cell);
/* The n of schedule_cap. It counts x = 0, which no step uses. */
uint32_t schedule_densify_count(const struct schedule *s);
/* The x of this step, or 0 if it does not densify. */
uint32_t schedule_densify_index(const struct schedule *s, uint32_t step);
/* Thinnings of a level (train/density/thin.h), if it has as many steps: in the first half of the
 * steps after the finest level's densification, and of those of a derived level from its first. */
enum { SCHEDULE_THINNINGS = 3 };
/* Which of them follows this step, from 1; 0: none, as in all steps that only fit colours again. */
uint32_t schedule_thinning(const struct schedule *s, uint32_t step);
/* How many a derived level has: it ends with its share of Gaussians also where it is short. */
uint32_t schedule_thinnings_derived(const struct schedule *s);
/* Returns whether a densification at this step may remove Gaussians for their size. */
bool schedule_limits_size(const struct schedule *s, uint32_t step);
uint32_t schedule_sh_degree(const struct schedule *s, uint32_t step);
double schedule_lr_mean(const struct schedule *s, uint32_t step);
/* Factor on all rates, those of schedule_lr_mean too: 1 to fade_to. */
double schedule_fade(const struct schedule *s, uint32_t step);
/* Factor on the rate of harmonics above the base colour, at most 1: a run that draws each of its n
 * photographs more than SCHEDULE_SH_LOOKS times moves them no farther than one that draws each so
 * often (docs/decisions/013-rates-and-length.md). */
#define SCHEDULE_SH_LOOKS 100.0
double schedule_sh_factor(const struct train_config *cfg, const struct schedule *s,
                          size_t n_photos);
/* The part of the level that is done, 0 to 1. */
double schedule_done(const struct schedule *s, uint32_t step);
#endif
