/* Random samples without replacement. Pure: any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SAMPLE_H
#define CORE_SAMPLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

/* The k smallest of -ln(u_i) / importance_i (exponential race = sampling without replacement): ids
 * of the chosen [k], in order of arrival. Importances of 0 come last. score [by id], NULL: all
 * equal; ids [n]. The same for the same seed and stream. ERR_ARG (k > n), ERR_MEM. */
enum err_code sample_race(const float *score, const uint32_t *ids, size_t n, size_t k,
                          uint64_t seed, uint64_t stream, uint32_t *chosen, struct err *e) ERR_USE;
#endif
