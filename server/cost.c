/* A factor for each kind of work between what a formula expects and what was measured: a moving
 * mean, so that another machine, a busy one, or a store of other tiles are learned in about ten
 * jobs. One job moves it by at most its double, so one that a debugger or a swap held up is no
 * rule.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/cost.h"

#include <math.h>

#define COST_WEIGHT 0.2 /* of the newest */
#define COST_STEP 4.0   /* one job counts for at most so many times the mean, or its inverse */
#define COST_LEAST 1e-3 /* bounds of a factor */
#define COST_MOST 1e3
#define COST_LEAST_MS 0.01

double cost_predict(const struct cost *c, unsigned kind, double expected_ms)
{
    const double f = kind < COST_KINDS && c->factor[kind] > 0 ? c->factor[kind] : 1;
    return fmax(expected_ms, COST_LEAST_MS) * f;
}

void cost_learn(struct cost *c, unsigned kind, double expected_ms, double took_ms)
{
    if (kind >= COST_KINDS || !(took_ms >= 0) || !isfinite(expected_ms))
        return;
    const double f = c->factor[kind] > 0 ? c->factor[kind] : 1,
                 now = took_ms / fmax(expected_ms, COST_LEAST_MS);
    const double held = fmin(fmax(now, f / COST_STEP), f * COST_STEP);
    c->factor[kind] = fmin(fmax(f + COST_WEIGHT * (held - f), COST_LEAST), COST_MOST);
}
