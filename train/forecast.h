/* Inside of train/: how long the rest of a run will take. A level's steps cost what its Gaussians
 * and pixels do, so the rate of the level in work says what the levels to come will need.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_FORECAST_H
#define TRAIN_FORECAST_H

#include <stddef.h>

struct gallery;
struct stage;

struct forecast { /* {0}: nothing was measured yet */
    double work, seconds;
};
/* `steps` of the level in work took so many seconds, with this many Gaussians. */
void forecast_add(struct forecast *f, const struct gallery *g, const struct stage *at,
                  double gaussians, double steps, double seconds);
/* Seconds for what is left of all levels; 0 where nothing was measured. Later levels count with
 * their budgets. */
double forecast_left_s(const struct forecast *f, const struct gallery *g, const struct stage *at,
                       double gaussians);
/* "40 s", "12 min", "3 h 20 min", "2 d 4 h" into out. */
void forecast_text(double seconds, char *out, size_t size);

#endif
