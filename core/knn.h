/* Exact nearest neighbours in space: a balanced k-d tree laid out in an array of points. The median
 * of a range is its node, the halves are its children, so the tree needs no pointers (Bentley
 * 1975). It is built in parallel below its first few splits, and is the same for any number of
 * threads.
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
struct knn { /* {0} is empty; knn_free */
    size_t n;
    struct knn_point *points; /* [n], in the order of the tree */
    uint8_t *axis;            /* [n]: split axis of the node at that place */
};
/* xyz [n][3] is copied. ERR_MEM, ERR_LIMIT (more than 2^32 - 1 points). Points must be finite. */
enum err_code knn_build(const float *xyz, size_t n, struct knn *out, struct err *e) ERR_USE;
void knn_free(struct knn *t);
/* The k <= KNN_MAX points nearest to p, but for point `skip` (KNN_NOBODY: none left out): ids and
 * squared distances, ascending, of equal ones the lower id first. Returns how many there are. May
 * be called from several threads at once. */
size_t knn_find(const struct knn *t, const float p[3], uint32_t skip, size_t k, uint32_t *ids,
                float *dist2);

#endif
