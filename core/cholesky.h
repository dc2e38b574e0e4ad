/* Small symmetric positive definite systems.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_CHOLESKY_H
#define CORE_CHOLESKY_H

#include <stdbool.h>
#include <stddef.h>

/* a, [n] rows that are `stride` apart, of which the lower triangle is read, becomes its factor L
 * with L L^T = a. False: not positive definite to 13 digits, and a is spoiled. */
bool cholesky_factor(double *a, size_t n, size_t stride);
/* x [n] with L L^T x = b; x may be b. */
void cholesky_solve(const double *l, size_t n, size_t stride, const double *b, double *x);

#endif
