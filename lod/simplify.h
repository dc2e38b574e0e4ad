/* Fewer Gaussians of the same appearance: simplify.c, see there.
 *
 * Pure: no state, any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SIMPLIFY_H
#define LOD_SIMPLIFY_H

#include <stddef.h>

#include "core/err.h"

struct gauss;

/* Merge neighbours by moment matching down to `target` rows, or all of them if there are fewer.
 * out: gauss_free it; origin, SH degree and embeddings are in's. ERR_ARG (target 0), ERR_LIMIT
 * (2^32 - 1 rows), ERR_MEM. */
enum err_code simplify_gauss(const struct gauss *in, size_t target, struct gauss *out,
                             struct err *e) ERR_USE;

/* Parts, for tests. Eigenvalues, descending, and eigenvectors (columns of v, row-major,
 * right-handed) of a symmetric matrix given as xx xy xz yy yz zz. */
void simplify_eigen(const double cov[6], double value[3], double v[9]);
/* Mean over all directions of the projected area of an ellipsoid of half axes s, divided by pi. */
double simplify_area(const double s[3]);

#endif
