/* The plane sweep in double, pixel by pixel, without tiles: the twin of sweep.cl.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "scene/stereo/sweep.h"

static double sweep_ref_grey(const struct sweep_view *v, int x, int y)
{
    int w = (int)v->cam.width_px, h = (int)v->cam.height_px;
    x = x < 0 ? 0 : x >= w ? w - 1 : x;
    y = y < 0 ? 0 : y >= h ? h - 1 : y;
    return v->grey[y * w + x] / 255.0;
}

static double sweep_ref_bilinear(const struct sweep_view *v, double u, double w)
{
    u = fmin(fmax(u - 0.5, 0.0), v->cam.width_px - 1.001);
    w = fmin(fmax(w - 0.5, 0.0), v->cam.height_px - 1.001);
    int i = (int)u, j = (int)w;
    double fu = u - i, fw = w - j;
    double top = (1.0 - fu) * sweep_ref_grey(v, i, j) + fu * sweep_ref_grey(v, i + 1, j);
    double low = (1.0 - fu) * sweep_ref_grey(v, i, j + 1) + fu * sweep_ref_grey(v, i + 1, j + 1);
    return (1.0 - fw) * top + fw * low;
}

/* Correlation of the windows about pixel (x, y); -2: the neighbour does not show the place. */
static double sweep_ref_correlation(const struct sweep_input *in, size_t k, const double h[9],
                                    int x, int y)
{
    double n = 0.0, a1 = 0.0, a2 = 0.0, b1 = 0.0, b2 = 0.0, ab = 0.0;
    const struct sweep_view *near = &in->near[k];
    double middle = sweep_ref_grey(&in->ref, x, y);
    for (int j = -SWEEP_RADIUS; j <= SWEEP_RADIUS; j++)
        for (int i = -SWEEP_RADIUS; i <= SWEEP_RADIUS; i++) {
            double px = x + i + 0.5, py = y + j + 0.5, q = h[6] * px + h[7] * py + h[8];
            double u = (h[0] * px + h[1] * py + h[2]) / q, v = (h[3] * px + h[4] * py + h[5]) / q;
            if (!i && !j &&
                !(q > 0.0 && u >= 1.0 && v >= 1.0 && u <= near->cam.width_px - 1.0 &&
                  v <= near->cam.height_px - 1.0))
                return -2.0;
            if ((i + j) % 2)
                continue;
            double a = sweep_ref_grey(&in->ref, x + i, y + j), b = sweep_ref_bilinear(near, u, v);
            double r = (a - middle) / SWEEP_LIKE, w = 1.0 / ((1.0 + r * r) * (1.0 + r * r));
            n += w;
            a1 += w * a;
            a2 += w * a * a;
            b1 += w * b;
            b2 += w * b * b;
            ab += w * a * b;
        }
    double ma = a1 / n, mb = b1 / n;
    double va = fmax(a2 / n - ma * ma, 0.0) + SWEEP_NOISE,
           vb = fmax(b2 / n - mb * mb, 0.0) + SWEEP_NOISE;
    return (ab / n - ma * mb) / sqrt(va * vb);
}

/* Of pixel (x, y) in a plane with these maps to the neighbours. */
static double sweep_ref_cost_of(const struct sweep_input *in, const double (*h)[9], int x, int y)
{
    double best[3] = {-2.0, -2.0, -2.0};
    size_t want = in->n_near > 4 ? 3 : in->n_near > 1 ? 2 : 1, m = 1;
    for (size_t k = 0; k < in->n_near; k++) {
        double c = sweep_ref_correlation(in, k, h[k], x, y);
        for (int b = 0; b < 3; b++) {
            double was = best[b];
            best[b] = fmax(was, c);
            c = fmin(was, c);
        }
    }
    double sum = best[0];
    while (m < want && best[m] > -1.5)
        sum += best[m++];
    return SWEEP_COST_MOST * fmax(fmin(1.0 - sum / (double)m, 1.0), 0.0);
}

static double sweep_ref_plane(const struct sweep_input *in, const struct sweep_plane *plane, int x,
                              int y)
{
    double h[SWEEP_NEAR_MAX][9];
    for (size_t k = 0; k < in->n_near; k++)
        sweep_homography(in, k, plane, h[k]);
    return sweep_ref_cost_of(in, (const double(*)[9])h, x, y);
}

/* Lowers the costs of pixel (x, y) to those of upright planes. */
static void sweep_ref_walls(const struct sweep_input *in, int x, int y, double *cost)
{
    double d[3], c[3];
    struct sweep_wall w;
    sweep_ray(in, x + 0.5, y + 0.5, d);
    camera_center(&in->ref.cam, c);
    if (!sweep_wall(in, (uint32_t)x / SWEEP_TILE_W * SWEEP_TILE_W,
                    (uint32_t)y / SWEEP_TILE_H * SWEEP_TILE_H, &w))
        return;
    double scale = (w.direction[0] * d[0] + w.direction[1] * d[1]) / d[2] / w.rho;
    if (!(d[2] < -SWEEP_DOWN && scale > 0.0))
        return;
    for (uint32_t p = 0; p < in->planes; p++) {
        double z_m = in->low_m + in->step_m * p;
        double to = (c[2] - in->low_m + (z_m - c[2]) * scale) / in->step_m / SWEEP_WALL_EVERY;
        int low = (int)floor(to);
        if (low < w.first || low + 1 >= w.end)
            continue;
        struct sweep_plane a = sweep_upright(in, &w, low), b = sweep_upright(in, &w, low + 1);
        double ca = sweep_ref_plane(in, &a, x, y), cb = sweep_ref_plane(in, &b, x, y);
        cost[p] = fmin(cost[p], ca + (to - low) * (cb - ca) + SWEEP_WALL_COST);
    }
}

/* cost [h][w][planes] */
static void sweep_ref_cost(const struct sweep_input *in, double *cost)
{
    size_t w = in->ref.cam.width_px, n = w * in->ref.cam.height_px;
    for (size_t i = 0; i < n; i++) {
        int x = (int)(i % w), y = (int)(i / w);
        for (uint32_t p = 0; p < in->planes; p++) {
            struct sweep_plane level = sweep_level(in->low_m + in->step_m * p);
            cost[i * in->planes + p] = sweep_ref_plane(in, &level, x, y);
        }
        sweep_ref_walls(in, x, y, cost + i * in->planes);
    }
}

/* Adds the costs of the paths along one line of pixels. */
static void sweep_ref_path(const struct sweep_input *in, const double *cost, double *sum,
                           size_t first, ptrdiff_t step, size_t count, double *before, double *now)
{
    size_t planes = in->planes, at = first;
    double least = 0.0, grey = in->ref.grey[first] / 255.0;
    memset(before, 0, planes * sizeof *before);
    for (size_t i = 0; i < count; i++, at += (size_t)step) {
        double change = fabs(in->ref.grey[at] / 255.0 - grey) * SWEEP_EDGE, next = (double)INFINITY;
        double jump = SWEEP_JUMP_LOW + (SWEEP_JUMP_HIGH - SWEEP_JUMP_LOW) / (1.0 + change);
        grey = in->ref.grey[at] / 255.0;
        for (size_t p = 0; p < planes; p++) {
            double m = fmin(before[p], least + jump);
            if (p)
                m = fmin(m, before[p - 1] + SWEEP_STEP_COST);
            if (p + 1 < planes)
                m = fmin(m, before[p + 1] + SWEEP_STEP_COST);
            now[p] = m - least + cost[at * planes + p];
            next = fmin(next, now[p]);
            sum[at * planes + p] += now[p];
        }
        least = next;
        memcpy(before, now, planes * sizeof *before);
    }
}

static void sweep_ref_pick(const struct sweep_input *in, const double *cost, const double *sum,
                           double *plane, double *score)
{
    size_t n = (size_t)in->ref.cam.width_px * in->ref.cam.height_px, planes = in->planes;
    for (size_t i = 0; i < n; i++) {
        const double *s = sum + i * planes;
        size_t best = 0;
        for (size_t p = 1; p < planes; p++)
            best = s[p] < s[best] ? p : best;
        plane[i] = (double)best;
        if (best > 0 && best + 1 < planes) {
            double bend = s[best - 1] - 2.0 * s[best] + s[best + 1];
            plane[i] += bend > 0.0 ? 0.5 * (s[best - 1] - s[best + 1]) / bend : 0.0;
        }
        score[i] = 1.0 - cost[i * planes + best] / SWEEP_COST_MOST;
    }
}

enum err_code sweep_ref_run(const struct sweep_input *in, double *plane, double *score,
                            struct err *e)
{
    size_t w = in->ref.cam.width_px, h = in->ref.cam.height_px, n = w * h * in->planes;
    double *cost = mem_array(n, sizeof *cost), *sum = mem_array(n, sizeof *sum),
           *lines = mem_array(2 * (size_t)in->planes, sizeof *lines);
    enum err_code rc = cost && sum && lines
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "sweep: out of memory for %zu costs", n);
    if (!rc) {
        double *before = lines, *now = lines + in->planes;
        ptrdiff_t down = (ptrdiff_t)w;
        sweep_ref_cost(in, cost);
        for (size_t y = 0; y < h; y++) {
            sweep_ref_path(in, cost, sum, y * w, 1, w, before, now);
            sweep_ref_path(in, cost, sum, y * w + w - 1, -1, w, before, now);
        }
        for (size_t x = 0; x < w; x++) {
            sweep_ref_path(in, cost, sum, x, down, h, before, now);
            sweep_ref_path(in, cost, sum, (h - 1) * w + x, -down, h, before, now);
        }
        sweep_ref_pick(in, cost, sum, plane, score);
    }
    mem_free(cost);
    mem_free(sum);
    mem_free(lines);
    return rc;
}
