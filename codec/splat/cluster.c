/* Codebooks: see cluster.h. In one dimension, sums over sorted values reduce a step of Lloyd's
 * algorithm to 256 binary searches. Rows of many dimensions are divided again and again
 * (tree-structured vector quantisation). A full search would take n x groups x d a step: seconds
 * instead of tenths.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/cluster.h"

#include <math.h>
#include <string.h>

#include "core/math/sort.h"

enum { CLUSTER_STEPS = 60 };

/* ---- on the line ---- */

/* How many of sorted v [n] are below x. */
static size_t cluster_count_below(const float *v, size_t n, double x)
{
    size_t lo = 0, hi = n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if ((double)v[mid] < x)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

struct cluster_cell {
    size_t from, to;
    double spread; /* sum of squares about the mean */
};

static struct cluster_cell cluster_cell(const double *sum, const double *square, size_t from,
                                        size_t to)
{
    const double n = (double)(to - from), s = sum[to] - sum[from];
    return (struct cluster_cell){from, to,
                                 to - from < 2 ? 0 : square[to] - square[from] - s * s / n};
}

/* The cell with the largest spread is divided at its mean until there are enough: cells are small
 * where most of v is, and those far away have theirs. Where v has fewer values than the book, each
 * stands in it several times. */
static void cluster_start(const float *v, size_t n, const double *sum, const double *square,
                          double *book)
{
    struct cluster_cell cell[CLUSTER_BOOK] = {cluster_cell(sum, square, 0, n)};
    size_t n_cells = 1;
    while (n_cells < CLUSTER_BOOK) {
        size_t at = 0;
        for (size_t k = 1; k < n_cells; k++)
            at = cell[k].spread > cell[at].spread ? k : at;
        const size_t from = cell[at].from, to = cell[at].to;
        const double mean = (sum[to] - sum[from]) / (double)(to - from);
        const size_t mid = from + cluster_count_below(v + from, to - from, mean);
        if (cell[at].spread <= 0)
            break;
        if (mid == from || mid == to) { /* equal but for rounding */
            cell[at].spread = 0;
            continue;
        }
        memmove(cell + at + 2, cell + at + 1, (n_cells++ - at - 1) * sizeof *cell);
        cell[at] = cluster_cell(sum, square, from, mid);
        cell[at + 1] = cluster_cell(sum, square, mid, to);
    }
    for (size_t k = 0; k < CLUSTER_BOOK; k++) {
        const struct cluster_cell *c = &cell[k * n_cells / CLUSTER_BOOK];
        book[k] = (sum[c->to] - sum[c->from]) / (double)(c->to - c->from);
    }
}

static void cluster_settle(const float *v, size_t n, const double *sum, double *book)
{
    for (int step = 0; step < CLUSTER_STEPS; step++) {
        double moved = 0;
        size_t from = 0;
        for (size_t k = 0; k < CLUSTER_BOOK; k++) {
            size_t to =
                k + 1 < CLUSTER_BOOK ? cluster_count_below(v, n, 0.5 * (book[k] + book[k + 1])) : n;
            if (to > from) {
                double mean = (sum[to] - sum[from]) / (double)(to - from);
                moved = fmax(moved, fabs(mean - book[k]));
                book[k] = mean;
                from = to;
            }
        }
        if (moved == 0)
            break;
    }
}

/* Of equal ones the middle: clients that read textures through a canvas, as Babylon.js, get indices
 * that are off by one where alpha is not 255. */
static uint8_t cluster_nearest(const float book[CLUSTER_BOOK], float x)
{
    size_t lo = 0, hi = CLUSTER_BOOK - 1;
    while (lo < hi) {
        size_t mid = (lo + hi) / 2;
        if (x > 0.5f * (book[mid] + book[mid + 1]))
            lo = mid + 1;
        else
            hi = mid;
    }
    for (hi = lo; hi + 1 < CLUSTER_BOOK && book[hi + 1] == book[lo];)
        hi++;
    return (uint8_t)((lo + hi) / 2);
}

/* Ascending, in time linear in n. ERR_MEM. */
static enum err_code cluster_sort(const float *v, size_t n, float *sorted, struct err *e)
{
    uint64_t *words = mem_uninit(n, 2 * sizeof *words);
    if (!words)
        return err_set(e, ERR_MEM, "codebook: out of memory");
    for (size_t i = 0; i < n; i++) {
        uint32_t bits;
        memcpy(&bits, v + i, sizeof bits);
        words[i] = sort_key_float(v[i]) << 32 | bits;
    }
    sort_words(words, words + n, n);
    for (size_t i = 0; i < n; i++) {
        uint32_t bits = (uint32_t)words[i];
        memcpy(sorted + i, &bits, sizeof bits);
    }
    mem_free(words);
    return ERR_OK;
}

enum err_code cluster_values(const float *v, size_t n, float book[CLUSTER_BOOK], uint8_t *index,
                             struct err *e)
{
    double middle[CLUSTER_BOOK];
    float *sorted = mem_uninit(n, sizeof *sorted);
    double *sum = mem_uninit(n + 1, 2 * sizeof *sum), *square = sum ? sum + n + 1 : NULL;
    enum err_code rc = sorted && sum ? cluster_sort(v, n, sorted, e)
                                     : err_set(e, ERR_MEM, "codebook: out of memory");
    if (!rc) {
        sum[0] = square[0] = 0;
        for (size_t i = 0; i < n; i++) {
            sum[i + 1] = sum[i] + (double)sorted[i];
            square[i + 1] = square[i] + (double)sorted[i] * (double)sorted[i];
        }
        cluster_start(sorted, n, sum, square, middle);
        cluster_settle(sorted, n, sum, middle);
        for (size_t k = 0; k < CLUSTER_BOOK; k++)
            book[k] = (float)middle[k];
        for (size_t i = 0; i < n; i++)
            index[i] = cluster_nearest(book, v[i]);
    }
    mem_free(sorted);
    mem_free(sum);
    return rc;
}

/* ---- rows ---- */

struct cluster_group {
    size_t from, n; /* of the order */
    double spread;  /* sum of squares about the mean; 0: not to be divided */
};

struct cluster_rows {
    const float *v;
    size_t d;
    uint32_t *order, *spare;
    struct cluster_group *group; /* a heap by spread */
    size_t n_groups;
    double *work; /* [3][d]: mean, variance, direction */
};

/* Mean and spread of a group; the dimension of largest variance. */
static size_t cluster_measure(const struct cluster_rows *c, struct cluster_group *g, double *mean,
                              double *variance)
{
    const size_t d = c->d;
    size_t widest = 0;
    memset(mean, 0, d * sizeof *mean);
    memset(variance, 0, d * sizeof *variance);
    for (size_t i = 0; i < g->n; i++) {
        const float *row = c->v + d * c->order[g->from + i];
        for (size_t k = 0; k < d; k++) {
            double x = (double)row[k];
            mean[k] += x;
            variance[k] += x * x;
        }
    }
    g->spread = 0;
    for (size_t k = 0; k < d; k++) {
        mean[k] /= (double)g->n;
        variance[k] = fmax(0, variance[k] - (double)g->n * mean[k] * mean[k]);
        g->spread += variance[k];
        if (variance[k] > variance[widest])
            widest = k;
    }
    /* what is left of equal rows by rounding is no reason to divide them */
    if (g->n < 2 || g->spread <= 1e-10 * (double)g->n)
        g->spread = 0;
    return widest;
}

static void cluster_push(struct cluster_rows *c, struct cluster_group g)
{
    size_t at = c->n_groups++;
    for (; at && c->group[(at - 1) / 2].spread < g.spread; at = (at - 1) / 2)
        c->group[at] = c->group[(at - 1) / 2];
    c->group[at] = g;
}

static struct cluster_group cluster_pop(struct cluster_rows *c)
{
    const struct cluster_group top = c->group[0], last = c->group[--c->n_groups];
    size_t at = 0;
    for (size_t kid; (kid = 2 * at + 1) < c->n_groups; at = kid) {
        kid += kid + 1 < c->n_groups && c->group[kid + 1].spread > c->group[kid].spread;
        if (c->group[kid].spread <= last.spread)
            break;
        c->group[at] = c->group[kid];
    }
    c->group[at] = last;
    return top;
}

/* The group's rows on either side of the plane through its mean, across the direction in which they
 * vary most: one step of the power iteration from the widest dimension. How many are below. */
static size_t cluster_divide(struct cluster_rows *c, struct cluster_group *g)
{
    const size_t d = c->d;
    double *mean = c->work, *variance = mean + d, *along = variance + d;
    const size_t widest = cluster_measure(c, g, mean, variance);
    uint32_t *order = c->order + g->from;
    size_t low = 0, high = 0;
    memset(along, 0, d * sizeof *along);
    for (size_t i = 0; i < g->n; i++) {
        const float *row = c->v + d * order[i];
        const double x = (double)row[widest] - mean[widest];
        for (size_t k = 0; k < d; k++)
            along[k] += x * ((double)row[k] - mean[k]);
    }
    for (size_t i = 0; i < g->n; i++) {
        const float *row = c->v + d * order[i];
        double side = 0;
        for (size_t k = 0; k < d; k++)
            side += along[k] * ((double)row[k] - mean[k]);
        if (side < 0)
            order[low++] = order[i];
        else
            c->spare[high++] = order[i];
    }
    memcpy(order + low, c->spare, high * sizeof *order);
    return low;
}

static void cluster_split_all(struct cluster_rows *c, size_t n, size_t most)
{
    struct cluster_group all = {.n = n};
    cluster_measure(c, &all, c->work, c->work + c->d);
    cluster_push(c, all);
    while (c->n_groups < most && c->group[0].spread > 0) {
        struct cluster_group g = cluster_pop(c);
        const size_t low = cluster_divide(c, &g);
        struct cluster_group part[2] = {{.from = g.from, .n = low},
                                        {.from = g.from + low, .n = g.n - low}};
        if (!low || low == g.n) { /* rounding put all on one side */
            g.spread = 0;
            cluster_push(c, g);
            continue;
        }
        for (int k = 0; k < 2; k++) {
            cluster_measure(c, &part[k], c->work, c->work + c->d);
            cluster_push(c, part[k]);
        }
    }
}

enum err_code cluster_rows(const float *v, size_t n, size_t d, size_t most, float *mean,
                           uint16_t *label, size_t *n_groups, struct err *e)
{
    struct cluster_rows c = {.v = v, .d = d};
    c.order = mem_uninit(n, sizeof *c.order);
    c.spare = mem_uninit(n, sizeof *c.spare);
    c.group = mem_array(most + 1, sizeof *c.group);
    c.work = mem_array(3 * d, sizeof *c.work);
    enum err_code rc = c.order && c.spare && c.group && c.work
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "palette: out of memory");
    for (size_t i = 0; !rc && i < n; i++)
        c.order[i] = (uint32_t)i;
    if (!rc)
        cluster_split_all(&c, n, most);
    for (size_t g = 0; !rc && g < c.n_groups; g++) {
        cluster_measure(&c, &c.group[g], c.work, c.work + d);
        for (size_t k = 0; k < d; k++)
            mean[d * g + k] = (float)c.work[k];
        for (size_t i = 0; i < c.group[g].n; i++)
            label[c.order[c.group[g].from + i]] = (uint16_t)g;
    }
    *n_groups = rc ? 0 : c.n_groups;
    mem_free(c.order);
    mem_free(c.spare);
    mem_free(c.group);
    mem_free(c.work);
    return rc;
}
