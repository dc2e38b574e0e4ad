/* Random samples.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SAMPLE_H
#define CORE_SAMPLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

/* The k smallest of -ln(u_i) / importance_i (exponential race = sampling without replacement): ids of
 * the chosen, in order of arrival. Scores of 0 come last. */
enum err_code sample_race(const float *score, const uint32_t *ids, size_t n, size_t k,
                          uint64_t seed, uint64_t stream, uint32_t *chosen, struct err *e) ERR_USE;
#endif
