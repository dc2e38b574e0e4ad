/* Small symmetric positive definite systems.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_CHOLESKY_H
#define CORE_CHOLESKY_H

#include <stdbool.h>
#include <stddef.h>

/* Replaces the matrix a by its Cholesky factor L, L L^T = a. a has n rows, `stride` doubles apart;
 * only its lower triangle is read, and the upper one becomes L^T. Returns false if a is not
 * positive definite to 13 digits; a is then destroyed. */
bool cholesky_factor(double *a, size_t n, size_t stride);
/* Solves L L^T x = b for x [n]. x may be b. */
void cholesky_solve(const double *l, size_t n, size_t stride, const double *b, double *x);
/* Several matrices at once, one a lane, with the same bits as one after the other: a [n][stride]
 * and x [n][CHOLESKY_RIGHT] of lanes, with so many right sides. ok [lane] is false where
 * cholesky_factor returns false; what is left there then says nothing. The upper triangles are not
 * touched. n: at most CHOLESKY_LANES_N. */
enum { CHOLESKY_LANES = 8, CHOLESKY_RIGHT = 3, CHOLESKY_LANES_N = 16 };
void cholesky_factor_lanes(double (*a)[CHOLESKY_LANES], size_t n, size_t stride,
                           bool ok[CHOLESKY_LANES]);
void cholesky_solve_lanes(double (*l)[CHOLESKY_LANES], size_t n, size_t stride,
                          double (*x)[CHOLESKY_RIGHT][CHOLESKY_LANES]);

#endif
