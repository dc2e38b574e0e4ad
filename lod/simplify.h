/* Parts of the simplifier that tests look at: internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SIMPLIFY_H
#define LOD_SIMPLIFY_H

#include "lod/lod.h"

/* Share of the hidden coverage of a pair that its merger loses: 1 keeps the coverage of the pair seen alone, 0
 * that of splats which never overlap. See docs/benchmarks.md for the sweep behind it. */
#define SIMPLIFY_HIDDEN_SHARE 1.0

/* Eigenvalues, descending, and eigenvectors (columns of v, row-major, right-handed) of a symmetric matrix given
 * as xx xy xz yy yz zz. */
void simplify_eigen(const double cov[6], double value[3], double v[9]);
/* Mean over all directions of the projected area of an ellipsoid of half axes s, divided by pi. */
double simplify_area(const double s[3]);

#endif
