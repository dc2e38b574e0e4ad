/* Predicts the time of work, learned from the time of earlier work.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COST_H
#define SERVER_COST_H

#include "core/base.h"

enum { COST_KINDS = 64 };
struct cost_kind { /* of work; what is learned of one says nothing of another */
    const void *of;
    unsigned variant;
};
struct cost { /* {0} is valid; the caller holds the lock */
    size_t n;
    struct cost_factor {
        struct cost_kind kind;
        double factor; /* time taken / expected, a moving mean */
    } learned[COST_KINDS];
};

/* Milliseconds for work of a kind that would take expected_ms on the machine that the formulas were
 * fitted to. */
double cost_predict(const struct cost *c, struct cost_kind kind, double expected_ms);
/* Learns from work that took took_ms and was expected to take expected_ms. Kinds beyond COST_KINDS
 * are not learned. */
void cost_learn(struct cost *c, struct cost_kind kind, double expected_ms, double took_ms);

#endif
