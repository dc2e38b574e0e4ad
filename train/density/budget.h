/* The number of Gaussians that a level may grow to: that of the table of budgets, or what the
 * photographs support if that is less. How many of them stay: schedule_growth.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_BUDGET_H
#define TRAIN_BUDGET_H

#include "train/base/config.h"
#include "train/base/schedule.h"

struct scene;

enum budget_mode { BUDGET_TABLE, BUDGET_FIT }; /* in the order of options.def */

/* The photographs of a cell. */
struct budget_photos {
    const struct scene *scene;
    const uint32_t *images; /* [n] */
    const double *shares;   /* [n] share of each that shows the cell, 0..1; NULL: all of it */
    size_t n, n_points;     /* n_points: Gaussians that training starts from */
};
/* What a level may grow to by n photographs: density * sum of share * sqrt(w h) px. It is at
 * least n_points, and at most `table`. It grows with the side of a picture and not with the area,
 * because detail grows with the length of edges. Shares make the budgets of cells add up to that of
 * the scene. */
size_t budget_fit(const struct budget_photos *p, const struct train_config *cfg, double downsample,
                  size_t table);
/* Applies cfg->budget_rule to the budgets of all levels, which come from the table. A level never
 * has a smaller budget than the one before. It logs what it lowered. */
void budget_limit(const struct budget_photos *p, const struct train_config *cfg,
                  struct schedule levels[TRAIN_LEVELS_MAX]);

#endif
