/* See knn.h. Ranges of up to KNN_LEAF points are searched one by one. A half of the tree is skipped
 * if its splitting plane is farther away than the k-th nearest point found so far.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/math/knn.h"

#include <assert.h>
#include <math.h>

#include "core/base.h"
#include "core/pool.h"

enum { KNN_LEAF = 8, KNN_PARTS = 64, KNN_PART_LEAST = 4096 };

struct knn_part { /* of a tree, to be split: points [a, b) in a box */
    size_t a, b;
    float lo[3], hi[3];
};
struct knn_build {
    struct knn *t;
    struct knn_part part[KNN_PARTS];
    size_t n;
};

/* The box of all points. */
static void knn_bounds(const struct knn *t, struct knn_part *all)
{
    for (int k = 0; k < 3; k++) {
        all->lo[k] = INFINITY;
        all->hi[k] = -INFINITY;
    }
    for (size_t i = 0; i < t->n; i++)
        for (int k = 0; k < 3; k++) {
            float v = t->points[i].xyz[k];
            all->lo[k] = v < all->lo[k] ? v : all->lo[k];
            all->hi[k] = v > all->hi[k] ? v : all->hi[k];
        }
}

/* Hoare's selection: afterwards points[m] is the one that sorting [a, b) would put there. */
static void knn_select(struct knn *t, size_t a, size_t b, size_t m, int axis)
{
    ptrdiff_t lo = (ptrdiff_t)a, hi = (ptrdiff_t)b - 1;
    while (lo < hi) {
        float pivot = t->points[lo + (hi - lo) / 2].xyz[axis];
        ptrdiff_t i = lo, j = hi;
        while (i <= j) {
            while (t->points[i].xyz[axis] < pivot)
                i++;
            while (t->points[j].xyz[axis] > pivot)
                j--;
            if (i <= j) {
                struct knn_point swap = t->points[i];
                t->points[i++] = t->points[j];
                t->points[j--] = swap;
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

/* Put the median of p in its place, across the box's longest side: the halves beside it. */
static void knn_halve(struct knn *t, const struct knn_part *p, struct knn_part *below,
                      struct knn_part *above)
{
    size_t m = p->a + (p->b - p->a) / 2;
    int axis = 0;
    for (int k = 1; k < 3; k++)
        axis = p->hi[k] - p->lo[k] > p->hi[axis] - p->lo[axis] ? k : axis;
    knn_select(t, p->a, p->b, m, axis);
    t->axis[m] = (uint8_t)axis;
    *below = *above = *p;
    below->b = m;
    above->a = m + 1;
    below->hi[axis] = above->lo[axis] = t->points[m].xyz[axis];
}

static void knn_split(struct knn *t, struct knn_part p)
{
    while (p.b - p.a > KNN_LEAF) {
        struct knn_part below;
        knn_halve(t, &p, &below, &p);
        knn_split(t, below); /* recursion on one half: depth is log2 n */
    }
}

static enum err_code knn_split_part(void *user, size_t i, struct err *e)
{
    (void)e;
    struct knn_build *b = user;
    knn_split(b->t, b->part[i]);
    return ERR_OK;
}

/* Split the largest part until there are KNN_PARTS, or it is small. */
static void knn_cut(struct knn_build *b)
{
    while (b->n < KNN_PARTS) {
        size_t largest = 0;
        for (size_t k = 1; k < b->n; k++)
            largest =
                b->part[k].b - b->part[k].a > b->part[largest].b - b->part[largest].a ? k : largest;
        if (b->part[largest].b - b->part[largest].a < KNN_PART_LEAST)
            return;
        struct knn_part whole = b->part[largest];
        knn_halve(b->t, &whole, &b->part[largest], &b->part[b->n]);
        b->n++;
    }
}

void knn_free(struct knn *t)
{
    mem_free(t->points);
    mem_free(t->axis);
    *t = (struct knn){0};
}

enum err_code knn_build(const float *xyz, size_t n, struct knn *out, struct err *e)
{
    struct knn_build b = {.t = out, .n = 1};
    *out = (struct knn){.n = n};
    if (n >= UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu points are more than the neighbour search counts", n);
    out->points = mem_array(n, sizeof *out->points);
    out->axis = mem_array(n, 1);
    if (!out->points || !out->axis) {
        knn_free(out);
        return err_set(e, ERR_MEM, "neighbours of %zu points: out of memory", n);
    }
    for (size_t i = 0; i < n; i++)
        out->points[i] =
            (struct knn_point){{xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]}, (uint32_t)i};
    b.part[0].b = n;
    knn_bounds(out, &b.part[0]);
    knn_cut(&b);
    return pool_for(b.n, 0, knn_split_part, &b, e);
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

static void knn_offer(const struct knn_point *v, struct knn_query *q)
{
    uint32_t id = v->id;
    if (id == q->skip)
        return;
    float dx = v->xyz[0] - q->p[0], dy = v->xyz[1] - q->p[1], dz = v->xyz[2] - q->p[2];
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
        int axis = t->axis[m];
        float gap = q->p[axis] - t->points[m].xyz[axis];
        size_t near_a = gap < 0.0f ? a : m + 1, near_b = gap < 0.0f ? m : b;
        size_t far_a = gap < 0.0f ? m + 1 : a, far_b = gap < 0.0f ? b : m;
        knn_offer(&t->points[m], q);
        knn_search(t, near_a, near_b, q);
        if (q->found == q->k && gap * gap > q->dist2[q->k - 1])
            return;
        a = far_a;
        b = far_b;
    }
    for (size_t i = a; i < b; i++)
        knn_offer(&t->points[i], q);
}

size_t knn_find(const struct knn *t, const float p[3], uint32_t skip, size_t k, uint32_t *ids,
                float *dist2)
{
    struct knn_query q = {.p = p, .skip = skip, .ids = ids, .dist2 = dist2, .k = k};
    assert(k >= 1 && k <= KNN_MAX);
    knn_search(t, 0, t->n, &q);
    return q.found;
}
