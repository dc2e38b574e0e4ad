/* Random samples without replacement. Functions are pure and may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SAMPLE_H
#define CORE_SAMPLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

/* Chooses k of n ids without replacement, with probability proportional to score [by id] (NULL: all
 * equal). It takes the k smallest of -ln(u_i) / score_i, an exponential race. Ids with score 0 come
 * last. chosen [k] keeps the order of ids [n]. Results depend on seed and stream alone. ERR_ARG (k
 * > n), ERR_MEM. */
enum err_code sample_race(const float *score, const uint32_t *ids, size_t n, size_t k,
                          uint64_t seed, uint64_t stream, uint32_t *chosen, struct err *e) ERR_USE;
#endif
