/* Internal to train/: the time that the rest of a run will take. Every kind of work has a cost, in
 * units of the work for one Gaussian in one step. The time of a unit is measured during the run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_FORECAST_H
#define TRAIN_FORECAST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "train/base/config.h"

struct gallery;
struct schedule;
struct stage;

struct forecast {                   /* {0} at first, then forecast_open */
    const struct train_config *cfg; /* borrowed */
    double pixels;                  /* of a photograph at the size of downsample 1, in the mean */
    double views;                   /* photographs that a densification draws for importance */
    double seen_from; /* Gaussians from which on a step moves those in the frustum alone */
    double
        outside; /* Gaussians outside of the cell for each inside, beside those of a coarse model */
    size_t n_images, n_tests;
    double work, seconds; /* units done and their time; older work counts less */
};
/* Sets what is constant in a run. n_tests: number of photographs that are scored after a level.
 * whole: the cell has no outside. */
void forecast_open(struct forecast *f, const struct gallery *g, const struct stage *at,
                   size_t n_tests, bool whole);
/* How many Gaussians the model of a level has, if `inside` of them lie inside the cell. */
double forecast_all(const struct forecast *f, const struct schedule *s, double inside);
/* Adds a measurement: the steps of the current level from `first` to at->step took `seconds`, with
 * this many Gaussians. Time for compiling kernels is not included. */
void forecast_add(struct forecast *f, const struct stage *at, uint32_t first, double gaussians,
                  double seconds);
/* Seconds for the rest of all levels, with the work at their ends. 0: nothing was measured yet.
 * gaussians: of the model, with those around the cell. It assumes that those of the cell grow by
 * the schedule. */
double forecast_left_s(const struct forecast *f, const struct stage *at, double gaussians);
/* Seconds for the steps of the current level alone, from its first one. 0: nothing was measured. */
double forecast_steps_s(const struct forecast *f, const struct stage *at, double gaussians);
/* Writes a time as "40 s", "12 min", "3 h 20 min" or "2 d 4 h". */
void forecast_text(double seconds, char *out, size_t size);

#endif
