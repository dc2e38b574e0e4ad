/* What merging two Gaussians costs: internal to lod/ and to its tests.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SIMPLIFY_COST_H
#define LOD_SIMPLIFY_COST_H

#include <stddef.h>
#include <stdint.h>

/* Share of the coverage that two splats hide of each other which their merger loses. 1 would keep
 * the coverage of the pair seen alone and thins out layers of many splats; 0 that of splats which
 * never overlap, and thickens them. docs/decisions/007-pyramid.md has the pictures behind 1/2. */
#define SIMPLIFY_HIDDEN_SHARE 0.5
/* Half a squared step of 0.2 in colour counts like a mean one sigma apart. */
#define SIMPLIFY_COLOR_WEIGHT 4.0f

/* The living clusters, in order along a curve; one array a field, so that costs are vectors. */
enum {
    SIMPLIFY_X,          /* mean x y z, metres */
    SIMPLIFY_CXX = 3,    /* covariance xx xy xz yy yz zz, metres^2 */
    SIMPLIFY_RED = 9,    /* colour r g b, 0..1 */
    SIMPLIFY_COVER = 12, /* opacity x mean projected area, metres^2 */
    SIMPLIFY_INFO,       /* coverage x log2 det of the blurred covariance */
    SIMPLIFY_OPACITY,
    SIMPLIFY_FIELDS,
    SIMPLIFY_WINDOW = 5, /* neighbours along the curve that are looked at, each side */
};
struct simplify_set {
    float *f[SIMPLIFY_FIELDS];
    uint32_t *root; /* row of the input that this cluster began as */
    size_t n;
};
/* cost[i] of merging i with its cheapest neighbour who[i] within SIMPLIFY_WINDOW, both [n]; scratch
 * [n]. Runnalls' upper bound of the Kullback-Leibler divergence between the two and their merger,
 * weighted by coverage, plus the difference in colour. Never NaN; n >= 2. */
void simplify_cost(const struct simplify_set *s, float blur2, float *cost, uint32_t *who,
                   float *scratch);
/* log2 of the determinant of cov + blur2 I, as the cost reckons it; cov at the stride of a set. */
float simplify_log_det(const float cov[6], float blur2);

#endif
