/* Replaces Gaussians by fewer ones of the same appearance: simplify.c.
 *
 * Functions are pure; any thread may call them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SIMPLIFY_H
#define LOD_SIMPLIFY_H

#include <stddef.h>

#include "core/err.h"

struct gauss;

/* Merges neighbours by moment matching until `target` rows are left. An input with fewer rows keeps
 * them all. Free *out with gauss_free. Origin, SH degree and embeddings are those of `in`. ERR_ARG
 * (target 0), ERR_LIMIT (2^32 - 1 rows), ERR_MEM. */
enum err_code simplify_gauss(const struct gauss *in, size_t target, struct gauss *out,
                             struct err *e) ERR_USE;

/* Parts, for tests. Eigenvalues (descending) and eigenvectors (columns of v, row-major,
 * right-handed) of the symmetric matrix xx xy xz yy yz zz. */
void simplify_eigen(const double cov[6], double value[3], double v[9]);
/* Projected area of an ellipsoid with half axes s, averaged over all directions and divided by pi.
 */
double simplify_area(const double s[3]);

#endif
