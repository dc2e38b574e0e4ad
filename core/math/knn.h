/* Exact nearest neighbours in space, by a balanced k-d tree in an array (Bentley 1975). A node is
 * the median of a range of the array, and the two halves of the range are its children, so no
 * pointers are needed. The subtrees below the first splits are built in parallel. The tree does not
 * depend on the number of threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_KNN_H
#define CORE_KNN_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

#define KNN_NOBODY UINT32_MAX
enum { KNN_MAX = 64 };

struct knn_point {
    float xyz[3];
    uint32_t id;
};
struct knn { /* {0} is empty; free with knn_free */
    size_t n;
    struct knn_point *points; /* [n], in the order of the tree */
    uint8_t *axis;            /* [n] split axis of each node */
};
/* Builds a tree of the points xyz [n][3], which must be finite. It copies them. ERR_MEM, ERR_LIMIT
 * (more than 2^32 - 1 points). */
enum err_code knn_build(const float *xyz, size_t n, struct knn *out, struct err *e) ERR_USE;
void knn_free(struct knn *t);
/* Finds the k <= KNN_MAX points nearest to p. The point `skip` is left out (KNN_NOBODY: none). ids
 * and squared distances are sorted by distance; of equal distances the lower id comes first.
 * Returns how many were found. Several threads may call it at once. */
size_t knn_find(const struct knn *t, const float p[3], uint32_t skip, size_t k, uint32_t *ids,
                float *dist2);

#endif
