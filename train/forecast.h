/* Inside of train/: how long the rest of a run will take. Every kind of work has a cost in units of
 * one Gaussian of one step. How long a unit takes is measured as the run goes on.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_FORECAST_H
#define TRAIN_FORECAST_H

#include <stddef.h>
#include <stdint.h>

#include "train/config.h"

struct gallery;
struct stage;

struct forecast {                    /* {0} at first; forecast_open */
    double pixels[TRAIN_LEVELS_MAX]; /* of a training photograph, mean, by level */
    double views;                    /* drawn at a densification, for importance */
    size_t n_images, n_tests;
    double work, seconds; /* done so far; what is long ago counts less */
};
/* What does not change in a run. n_tests: photographs that are scored after a level. */
void forecast_open(struct forecast *f, const struct gallery *g, const struct stage *at,
                   size_t n_tests);
/* The steps of the level in work from `first` to at->step took so many seconds, with this many
 * Gaussians, without the time that compiling kernels took. */
void forecast_add(struct forecast *f, const struct stage *at, uint32_t first, double gaussians,
                  double seconds);
/* Seconds for what is left of all levels, with their ends; 0 where nothing was measured. Gaussians
 * grow as the schedule lets them. */
double forecast_left_s(const struct forecast *f, const struct stage *at, double gaussians);
/* "40 s", "12 min", "3 h 20 min", "2 d 4 h" into out. */
void forecast_text(double seconds, char *out, size_t size);

#endif
