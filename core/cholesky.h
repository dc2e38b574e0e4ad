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
/* The same for several right sides at once, in place, with the same bits. */
enum { CHOLESKY_SIDES = 4 };
void cholesky_solve_sides(const double *l, size_t n, size_t stride, double (*x)[CHOLESKY_SIDES]);

#endif
