/* Edges of a surface model: see edge.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/edge.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "core/base.h"
#include "core/math/sort.h"

/* A wall has level ground below and a level roof above, so far and so much. */
static const double edge_level_m = 0.5, edge_beside_m = 1.5, edge_aslant_max = 1.7320508;

/* Between samples i and i + 1 of the truth the wall stands. */
static bool edge_stands(const float *truth, size_t n, size_t i, size_t beside)
{
    if (!(fabs((double)truth[i + 1] - (double)truth[i]) > EDGE_LEAST_M) || i < beside ||
        i + 1 + beside >= n)
        return false;
    for (size_t k = 1; k <= beside; k++)
        if (fabs((double)truth[i - k] - (double)truth[i]) > edge_level_m ||
            fabs((double)truth[i + 1 + k] - (double)truth[i + 1]) > edge_level_m)
            return false;
    return true;
}

/* By how many pixels the wall stands elsewhere a pixel further; false: it ends. */
static bool edge_slope(const float *truth, const float *next, size_t n, size_t i, double *out)
{
    double up = (double)truth[i + 1] - (double)truth[i];
    for (size_t k = 0; k <= 2 * EDGE_FINE; k++)
        for (int side = -1; side <= 1; side += 2) {
            ptrdiff_t at = (ptrdiff_t)i + side * (ptrdiff_t)k;
            if (at < 0 || at + 1 >= (ptrdiff_t)n ||
                fabs((double)next[at + 1] - (double)next[at] - up) > 2 * edge_level_m)
                continue;
            *out = (double)(at - (ptrdiff_t)i) / EDGE_FINE;
            return true;
        }
    return false;
}

/* Where the model goes through the height, in the direction of the wall, nearest to x px. */
static bool edge_crossing(const float *height, size_t w, double x, double level, bool up,
                          double *out)
{
    double best = EDGE_REACH_PX;
    size_t from = x > EDGE_REACH_PX + 1 ? (size_t)(x - EDGE_REACH_PX - 1) : 0;
    bool found = false;
    for (size_t k = from; k + 1 < w && (double)k < x + EDGE_REACH_PX + 1; k++) {
        double a = (double)height[k], b = (double)height[k + 1];
        if (!isfinite(a + b) || (up ? !(a < level && b >= level) : !(a >= level && b < level)))
            continue;
        double at = (double)k + 0.5 + (level - a) / (b - a);
        if (fabs(at - x) > best)
            continue;
        best = fabs(at - x);
        *out = at;
        found = true;
    }
    return found;
}

static enum err_code edge_add(struct edge_list *l, double offset_px, struct err *e)
{
    double *p = mem_room(l->offset_px, l->n, &l->cap, 256, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for %zu edges", l->n + 1);
    l->offset_px = p;
    l->offset_px[l->n++] = offset_px;
    return ERR_OK;
}

enum err_code edge_line(struct edge_list *l, const float *height, const float *truth,
                        const float *next, size_t w, double pixel_m, struct err *e)
{
    size_t n = w * EDGE_FINE, beside = (size_t)ceil(edge_beside_m / pixel_m * EDGE_FINE);
    for (size_t i = 0; i + 1 < n; i++) {
        double slope, at, x = (double)(i + 1) / EDGE_FINE;
        bool up = truth[i + 1] > truth[i];
        if (!edge_stands(truth, n, i, beside) || !edge_slope(truth, next, n, i, &slope) ||
            fabs(slope) > edge_aslant_max)
            continue;
        if (!edge_crossing(height, w, x, 0.5 * ((double)truth[i] + (double)truth[i + 1]), up,
                           &at)) {
            l->missing++;
            continue;
        }
        /* Along the line, then across the wall; outwards is towards the lower side. */
        enum err_code rc = edge_add(l, (up ? x - at : at - x) / hypot(1, slope), e);
        if (rc)
            return rc;
    }
    return ERR_OK;
}

void edge_free(struct edge_list *l)
{
    mem_free(l->offset_px);
    *l = (struct edge_list){0};
}

enum err_code edge_tell(struct edge_list *l, struct edge_score *out, struct err *e)
{
    size_t near = 0;
    *out = (struct edge_score){(double)NAN, (double)NAN, (double)NAN, (double)NAN};
    if (!l->n)
        return ERR_OK;
    double *far = mem_array(l->n, sizeof *far);
    if (!far)
        return err_set(e, ERR_MEM, "out of memory for %zu edges", l->n);
    for (size_t i = 0; i < l->n; i++) {
        far[i] = fabs(l->offset_px[i]);
        near += far[i] <= 2;
    }
    out->median_px = sort_median(far, l->n); /* sorts */
    out->most_px = far[(l->n - 1) * 95 / 100];
    out->within_2_px = (double)near / (double)(l->n + l->missing);
    out->out_px = sort_median(l->offset_px, l->n);
    mem_free(far);
    return ERR_OK;
}
