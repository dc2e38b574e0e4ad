/* The cost of merging two Gaussians. Internal to lod/ and to its tests.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SIMPLIFY_COST_H
#define LOD_SIMPLIFY_COST_H

#include <stddef.h>
#include <stdint.h>

/* Splats that overlap hide a part of each other, so a pair covers less than the sum of both. This
 * is the share of the hidden part that a merger loses. 1: the merger covers as much as the pair
 * alone, and layers of many splats become thinner. 0: it covers the sum, as if splats never
 * overlapped, and layers become thicker. docs/decisions/019-tiles.md shows pictures for 1/2. */
#define SIMPLIFY_HIDDEN_SHARE 0.5
/* A colour step of 0.2 costs as much as means one sigma apart, by half its square. */
#define SIMPLIFY_COLOR_WEIGHT 4.0f

/* Remaining clusters, in their order along a curve. Each field is an array, so that costs are
 * vectors. */
enum {
    SIMPLIFY_X,          /* mean x y z, metres */
    SIMPLIFY_CXX = 3,    /* covariance xx xy xz yy yz zz, metres^2 */
    SIMPLIFY_RED = 9,    /* colour r g b, 0..1 */
    SIMPLIFY_COVER = 12, /* opacity x mean projected area, metres^2 */
    SIMPLIFY_INFO,       /* coverage x log2 of the determinant of the blurred covariance */
    SIMPLIFY_OPACITY,
    SIMPLIFY_FIELDS,
    SIMPLIFY_WINDOW = 5, /* neighbours along the curve that are considered, on each side */
};
struct simplify_set {
    float *f[SIMPLIFY_FIELDS];
    uint32_t *root; /* input row from which the cluster began */
    size_t n;
};
/* Computes cost[i] of merging cluster i with its cheapest neighbour who[i] within SIMPLIFY_WINDOW.
 * Both are [n], n >= 2, and scratch is [n]. The cost is Runnalls' upper bound of the
 * Kullback-Leibler divergence between the two and their merger, weighted by coverage, plus the
 * difference in colour. It is never NaN. */
void simplify_cost(const struct simplify_set *s, float blur2, float *cost, uint32_t *who,
                   float *scratch);
/* log2 of the determinant of cov + blur2 I, computed as in the cost. cov has the stride of a set.
 */
float simplify_log_det(const float cov[6], float blur2);

#endif
