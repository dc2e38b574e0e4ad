/* See knn.h. Ranges of up to KNN_LEAF points are searched one by one; a half is left out when its
 * side of the splitting plane is farther than the worst of k found so far.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/knn.h"

#include <assert.h>
#include <math.h>

#include "core/base.h"

enum { KNN_LEAF = 8 };

/* The box of all points. */
static void knn_bounds(const struct knn *t, float lo[3], float hi[3])
{
    for (int k = 0; k < 3; k++) {
        lo[k] = INFINITY;
        hi[k] = -INFINITY;
    }
    for (size_t i = 0; i < 3 * t->n; i++) {
        float v = t->xyz[i];
        lo[i % 3] = v < lo[i % 3] ? v : lo[i % 3];
        hi[i % 3] = v > hi[i % 3] ? v : hi[i % 3];
    }
}

/* Hoare's selection: afterwards order[m] is the one that sorting [a, b) would put there. */
static void knn_select(struct knn *t, size_t a, size_t b, size_t m, int axis)
{
    ptrdiff_t lo = (ptrdiff_t)a, hi = (ptrdiff_t)b - 1;
    while (lo < hi) {
        float pivot = t->xyz[3 * (size_t)t->order[lo + (hi - lo) / 2] + (size_t)axis];
        ptrdiff_t i = lo, j = hi;
        while (i <= j) {
            while (t->xyz[3 * (size_t)t->order[i] + (size_t)axis] < pivot)
                i++;
            while (t->xyz[3 * (size_t)t->order[j] + (size_t)axis] > pivot)
                j--;
            if (i <= j) {
                uint32_t swap = t->order[i];
                t->order[i++] = t->order[j];
                t->order[j--] = swap;
            }
        }
        if ((ptrdiff_t)m <= j)
            hi = j;
        else if ((ptrdiff_t)m >= i)
            lo = i;
        else
            return;
    }
}

/* Split [a, b), whose points lie in the box, across the box's longest side. */
static void knn_split(struct knn *t, size_t a, size_t b, const float box_lo[3],
                      const float box_hi[3])
{
    float lo[3] = {box_lo[0], box_lo[1], box_lo[2]}, hi[3] = {box_hi[0], box_hi[1], box_hi[2]};
    while (b - a > KNN_LEAF) {
        size_t m = a + (b - a) / 2;
        int axis = 0;
        for (int k = 1; k < 3; k++)
            axis = hi[k] - lo[k] > hi[axis] - lo[axis] ? k : axis;
        knn_select(t, a, b, m, axis);
        t->axis[m] = (uint8_t)axis;
        float at = t->xyz[3 * (size_t)t->order[m] + (size_t)axis], top = hi[axis];
        hi[axis] = at;
        knn_split(t, a, m, lo, hi); /* recursion on one half: depth is log2 n */
        hi[axis] = top;
        lo[axis] = at;
        a = m + 1;
    }
}

void knn_free(struct knn *t)
{
    mem_free(t->order);
    mem_free(t->axis);
    *t = (struct knn){0};
}

enum err_code knn_build(const float *xyz, size_t n, struct knn *out, struct err *e)
{
    float lo[3], hi[3];
    *out = (struct knn){.xyz = xyz, .n = n};
    if (n >= UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu points are more than the neighbour search counts", n);
    out->order = mem_array(n, sizeof(*out->order));
    out->axis = mem_array(n, 1);
    if (!out->order || !out->axis) {
        knn_free(out);
        return err_set(e, ERR_MEM, "neighbours of %zu points: out of memory", n);
    }
    for (size_t i = 0; i < n; i++)
        out->order[i] = (uint32_t)i;
    knn_bounds(out, lo, hi);
    knn_split(out, 0, n, lo, hi);
    return ERR_OK;
}

struct knn_query {
    const float *p;
    uint32_t skip, *ids;
    float *dist2; /* ascending */
    size_t k, found;
};

static bool knn_before(float d, uint32_t id, float d2, uint32_t id2)
{
    return d < d2 || (d == d2 && id < id2);
}

static void knn_offer(const struct knn *t, uint32_t id, struct knn_query *q)
{
    if (id == q->skip)
        return;
    const float *v = t->xyz + 3 * (size_t)id;
    float dx = v[0] - q->p[0], dy = v[1] - q->p[1], dz = v[2] - q->p[2];
    float d = dx * dx + dy * dy + dz * dz;
    size_t at = q->found;
    if (at == q->k) {
        if (!knn_before(d, id, q->dist2[at - 1], q->ids[at - 1]))
            return;
        at--;
    } else {
        q->found++;
    }
    for (; at > 0 && knn_before(d, id, q->dist2[at - 1], q->ids[at - 1]); at--) {
        q->dist2[at] = q->dist2[at - 1];
        q->ids[at] = q->ids[at - 1];
    }
    q->dist2[at] = d;
    q->ids[at] = id;
}

static void knn_search(const struct knn *t, size_t a, size_t b, struct knn_query *q)
{
    while (b - a > KNN_LEAF) {
        size_t m = a + (b - a) / 2;
        uint32_t id = t->order[m];
        int axis = t->axis[m];
        float gap = q->p[axis] - t->xyz[3 * (size_t)id + (size_t)axis];
        size_t near_a = gap < 0.0f ? a : m + 1, near_b = gap < 0.0f ? m : b;
        size_t far_a = gap < 0.0f ? m + 1 : a, far_b = gap < 0.0f ? b : m;
        knn_offer(t, id, q);
        knn_search(t, near_a, near_b, q);
        if (q->found == q->k && gap * gap > q->dist2[q->k - 1])
            return;
        a = far_a;
        b = far_b;
    }
    for (size_t i = a; i < b; i++)
        knn_offer(t, t->order[i], q);
}

size_t knn_find(const struct knn *t, const float p[3], uint32_t skip, size_t k, uint32_t *ids,
                float *dist2)
{
    struct knn_query q = {.p = p, .skip = skip, .ids = ids, .dist2 = dist2, .k = k};
    assert(k >= 1 && k <= KNN_MAX);
    knn_search(t, 0, t->n, &q);
    return q.found;
}
