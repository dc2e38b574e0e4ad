/* Budgets that follow the photographs.
 *
 * A level with more Gaussians than its photographs can distinguish fits their noise and their wrong
 * poses. On 65 aerial photographs of 400 x 300 px, 7000 steps reach 33.7 dB with 240 k Gaussians.
 * With the 770 k that gradients alone ask for, they reach 32.3 dB in twice the time
 * (docs/decisions/011-density-control.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/density/budget.h"

#include <math.h>

#include "codec/scene/scene.h"
#include "train/base/config.h"
#include "train/base/schedule.h"
#include "train/photographs/photo_loader.h"

#define BUDGET_DENSITY 10.0 /* docs/decisions/011-density-control.md */

size_t budget_fit(const struct budget_photos *p, const struct train_config *cfg, double downsample,
                  size_t table)
{
    double sum = 0.0;
    for (size_t i = 0; i < p->n; i++) {
        struct camera c = photo_loader_camera(&p->scene->images[p->images[i]].cam,
                                              (uint32_t)cfg->max_edge_px, downsample);
        sum += (p->shares ? p->shares[i] : 1.0) * sqrt((double)c.width_px * c.height_px);
    }
    double fit = fmax(floor(BUDGET_DENSITY * sum), (double)p->n_points);
    return fit < (double)table ? (size_t)fmax(fit, 1.0) : table;
}

void budget_limit(const struct budget_photos *p, const struct train_config *cfg,
                  struct schedule levels[TRAIN_LEVELS_MAX])
{
    size_t before = 0;
    for (int64_t i = 0; cfg->budget_rule != BUDGET_TABLE && i < cfg->level_count; i++) {
        struct schedule *l = &levels[i];
        size_t table = l->budget;
        size_t fit = budget_fit(p, cfg, l->downsample, schedule_grows(l));
        fit = (size_t)((double)fit / schedule_growth(l));
        l->budget = fit > before ? fit : before;
        before = l->budget;
        if (l->budget < table)
            log_info("train",
                     "level %u: at most %zu Gaussians, what %zu photographs of this size support; "
                     "--budget-rule table allows %zu",
                     l->level, l->budget, p->n, table);
    }
}
