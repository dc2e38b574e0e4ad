/* Predicts the time of work, learned from the time of earlier work.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COST_H
#define SERVER_COST_H

#include "core/base.h"

enum { COST_KINDS = 64 };
struct cost { /* {0} is valid; the caller holds the lock */
    /* took / expected of each kind, a moving mean; 0: nothing was learned yet, which means 1 */
    double factor[COST_KINDS];
};

/* Milliseconds for work of a kind that would take expected_ms on the machine that the formulas were
 * fitted to. */
double cost_predict(const struct cost *c, unsigned kind, double expected_ms);
/* Learns from work of this kind that was expected to take expected_ms, and took took_ms. */
void cost_learn(struct cost *c, unsigned kind, double expected_ms, double took_ms);

#endif
