/* A factor for each kind of work between what a formula expects and what was measured: a moving
 * mean, so that another machine, a busy one, or a store of other tiles are learned in about ten
 * jobs. One job moves it by at most its double, so one that a debugger or a swap held up is no
 * rule.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/cost.h"

#include <math.h>

#define COST_WEIGHT 0.2 /* of the newest */
#define COST_STEP 4.0   /* one job counts for at most so many times the mean, or its inverse */
#define COST_LEAST 1e-3 /* bounds of a factor */
#define COST_MOST 1e3
#define COST_LEAST_MS 0.01

/* NULL: nothing was learned of it yet. */
static const struct cost_factor *cost_find(const struct cost *c, struct cost_kind kind)
{
    for (size_t i = 0; i < c->n; i++)
        if (c->learned[i].kind.of == kind.of && c->learned[i].kind.variant == kind.variant)
            return &c->learned[i];
    return NULL;
}

double cost_predict(const struct cost *c, struct cost_kind kind, double expected_ms)
{
    const struct cost_factor *f = cost_find(c, kind);
    return fmax(expected_ms, COST_LEAST_MS) * (f ? f->factor : 1);
}

void cost_learn(struct cost *c, struct cost_kind kind, double expected_ms, double took_ms)
{
    const struct cost_factor *found = cost_find(c, kind);
    const size_t at = found ? (size_t)(found - c->learned) : c->n;
    if (at == COST_KINDS || !(took_ms >= 0) || !isfinite(expected_ms))
        return;
    const double f = found ? found->factor : 1, now = took_ms / fmax(expected_ms, COST_LEAST_MS);
    const double held = fmin(fmax(now, f / COST_STEP), f * COST_STEP);
    c->learned[at] =
        (struct cost_factor){kind, fmin(fmax(f + COST_WEIGHT * (held - f), COST_LEAST), COST_MOST)};
    c->n += !found;
}
