/* Fewer Gaussians of the same appearance, for levels that were not trained.
 *
 * It merges pairs in rounds. In each round the clusters are sorted along another Morton curve
 * (shifted, Chan 1998), and each finds its cheapest neighbour within a window of the curve. The
 * cheapest pairs are merged if both partners are free, until `target` are left. A round removes at
 * most 0.3 of the clusters, so that later choices see earlier mergers. Radix sort and vector costs
 * make a round linear in time.
 *
 * A merger has the pair's mean, covariance (with the spread of the means) and colour, all weighted
 * by coverage = opacity times projected area. Its coverage is the sum of the pair's less what the
 * two hid of each other. If that needs more than full opacity, the splat is made larger instead, so
 * opaque surfaces do not thin out. SH and embeddings are mixed once at the end, with the weights of
 * the mergers.
 *
 * It is deterministic and uses one thread, because the pyramid makes many tiles at once.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/make/simplify.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "core/math/simd.h"
#include "core/math/sort.h"
#include "core/splat/camera.h"
#include "core/splat/gauss.h"
#include "lod/make/simplify_cost.h"

enum {
    SIMPLIFY_JACOBI = 12, /* sweeps; 3x3 matrices need 4 to 6 */
    SIMPLIFY_SOON = 8,    /* rows */
};

#define SIMPLIFY_TAKEN (UINT32_MAX - 1)
#define SIMPLIFY_FREE UINT32_MAX
#define SIMPLIFY_OPACITY_MAX 0.99 /* the renderer's own ceiling */
#define SIMPLIFY_BLUR 0.5 /* of the median sigma: thinner than this is not worth keeping apart */
#define SIMPLIFY_SCALE_LOG_MAX                                                                     \
    11.0f                    /* 60 km: squares and their determinants fit single precision */
#define SIMPLIFY_A_ROUND 0.3 /* of the clusters */

struct simplify_join { /* rows of the input; a lives on */
    uint32_t a, b;
    float share_b;
};

struct simplify {
    struct simplify_set set, spare; /* spare: where the next order is put together */
    struct simplify_join *join;
    size_t n_join;
    float *cost, *scratch;
    uint32_t *who;
    uint64_t *words, *words_spare; /* sorted: a key of 32 bits, a cluster's place */
    uint32_t *partner; /* of a cluster in the last round, SIMPLIFY_FREE or SIMPLIFY_TAKEN */
    size_t n_left;     /* living clusters: the set less those taken in the last round */
    double blur2;
    unsigned round;
};

/* Eigenvalues (descending) and vectors (columns of v, right-handed) of a symmetric 3x3 by cyclic
 * Jacobi. */
void simplify_eigen(const double cov[6], double value[3], double v[9])
{
    double a[3][3] = {{cov[0], cov[1], cov[2]}, {cov[1], cov[3], cov[4]}, {cov[2], cov[4], cov[5]}};
    double q[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int sweep = 0; sweep < SIMPLIFY_JACOBI; sweep++) {
        double off = fabs(a[0][1]) + fabs(a[0][2]) + fabs(a[1][2]);
        if (!(off > 1e-12 * (fabs(a[0][0]) + fabs(a[1][1]) + fabs(a[2][2]))))
            break;
        for (int r = 0; r < 2; r++)
            for (int c = r + 1; c < 3; c++) {
                if (a[r][c] == 0.0)
                    continue;
                double theta = (a[c][c] - a[r][r]) / (2.0 * a[r][c]);
                double t = copysign(1.0, theta) / (fabs(theta) + sqrt(theta * theta + 1.0));
                double cs = 1.0 / sqrt(t * t + 1.0), sn = t * cs;
                for (int k = 0; k < 3; k++) {
                    double x = a[k][r], y = a[k][c];
                    a[k][r] = cs * x - sn * y;
                    a[k][c] = sn * x + cs * y;
                }
                for (int k = 0; k < 3; k++) {
                    double x = a[r][k], y = a[c][k], p = q[k][r], s = q[k][c];
                    a[r][k] = cs * x - sn * y;
                    a[c][k] = sn * x + cs * y;
                    q[k][r] = cs * p - sn * s;
                    q[k][c] = sn * p + cs * s;
                }
            }
    }
    int order[3] = {0, 1, 2};
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2 - i; j++)
            if (a[order[j]][order[j]] < a[order[j + 1]][order[j + 1]]) {
                int swap = order[j];
                order[j] = order[j + 1];
                order[j + 1] = swap;
            }
    for (int c = 0; c < 3; c++) {
        value[c] = a[order[c]][order[c]];
        for (int k = 0; k < 3; k++)
            v[3 * k + c] = q[k][order[c]];
    }
    double det = v[0] * (v[4] * v[8] - v[5] * v[7]) - v[1] * (v[3] * v[8] - v[5] * v[6]) +
                 v[2] * (v[3] * v[7] - v[4] * v[6]);
    for (int k = 0; det < 0.0 && k < 3; k++)
        v[3 * k + 2] = -v[3 * k + 2];
}

/* Third root of a positive number: a third of its logarithm's bits, then Halley's step, which
 * leaves 3e-5: the area is not known better. */
static inline double simplify_root3(double m)
{
    uint64_t bits;
    double y;
    memcpy(&bits, &m, sizeof bits);
    bits = bits / 3 + UINT64_C(0x2a9f7893782da1ce);
    memcpy(&y, &bits, sizeof y);
    double cube = y * y * y;
    return m > 0.0 ? y * (cube + 2.0 * m) / (2.0 * cube + m) : 0.0;
}

/* Over pi: a quarter of the surface (Cauchy), and the surface as Thomsen's means of powers, 4/5 of
 * the one with p = 3/2 and 1/5 of that with p = 2: exact for spheres and thin discs, within 1.5 %
 * between, and no power to compute. */
double simplify_area(const double s[3])
{
    double ab = s[0] * s[1], ac = s[0] * s[2], bc = s[1] * s[2];
    double m = (ab * sqrt(ab) + ac * sqrt(ac) + bc * sqrt(bc)) / 3.0, root = simplify_root3(m);
    return 0.8 * root * root + 0.2 * sqrt((ab * ab + ac * ac + bc * bc) / 3.0);
}

/* ---- clusters ---- */

static bool simplify_set_alloc(struct simplify_set *s, size_t n)
{
    float *all = mem_uninit(n, SIMPLIFY_FIELDS * sizeof *all);
    s->root = mem_uninit(n, sizeof *s->root);
    for (size_t k = 0; k < SIMPLIFY_FIELDS; k++)
        s->f[k] = all ? all + k * n : NULL;
    return all && s->root;
}

static void simplify_set_free(struct simplify_set *s)
{
    mem_free(s->f[0]);
    mem_free(s->root);
}

static void simplify_weigh(struct simplify_set *s, size_t i, double blur2)
{
    float cov[6];
    for (size_t m = 0; m < 6; m++)
        cov[m] = s->f[SIMPLIFY_CXX + m][i];
    s->f[SIMPLIFY_INFO][i] = s->f[SIMPLIFY_COVER][i] * simplify_log_det(cov, (float)blur2);
}

static void simplify_init(struct simplify *s, const struct gauss *g, size_t i)
{
    struct simplify_set *to = &s->set;
    double quat[4], rot[9], sigma[3];
    for (size_t k = 0; k < 4; k++)
        quat[k] = (double)g->quat_wxyz[4 * i + k];
    camera_quat_to_rot(quat, rot);
    size_t sh = 3 * gauss_sh_count(g->sh_degree) * i;
    for (size_t k = 0; k < 3; k++) {
        float l = g->scale_log[3 * i + k];
        l = l < SIMPLIFY_SCALE_LOG_MAX ? l : SIMPLIFY_SCALE_LOG_MAX;
        l = l > -SIMPLIFY_SCALE_LOG_MAX ? l : -SIMPLIFY_SCALE_LOG_MAX;
        sigma[k] = (double)expf(l);
        to->f[SIMPLIFY_X + k][i] = g->mean_m[3 * i + k];
        to->f[SIMPLIFY_RED + k][i] = (float)GAUSS_SH_C0 * g->sh[sh + k];
    }
    static const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (size_t m = 0; m < 6; m++) {
        double sum = 0.0;
        for (size_t k = 0; k < 3; k++)
            sum += rot[3 * at[m][0] + k] * rot[3 * at[m][1] + k] * sigma[k] * sigma[k];
        to->f[SIMPLIFY_CXX + m][i] = (float)sum;
    }
    double opacity = 1.0 / (1.0 + (double)expf(-g->opacity_logit[i]));
    to->f[SIMPLIFY_OPACITY][i] = (float)opacity;
    to->f[SIMPLIFY_COVER][i] = (float)fmax(opacity * simplify_area(sigma), 1e-24);
    to->root[i] = (uint32_t)i;
    simplify_weigh(to, i, s->blur2);
}

/* Key along a Morton curve: 11 bits of x less the last, 11 of y, 11 of z. */
static inline uint64_t simplify_key(const struct simplify_set *s, size_t i, const float lo[3],
                                    float scale, float by)
{
    uint64_t key = 0;
    for (size_t k = 0; k < 3; k++) {
        float at = (s->f[SIMPLIFY_X + k][i] - lo[k]) * scale + by;
        key |= sort_spread3(at >= 0.0f && at < 2048.0f ? (uint64_t)at : 0) << k;
    }
    return key >> 1;
}

/* Let those that were not taken in the last round stand along a Morton curve over a cube four times
 * the box, the box shifted differently each round: what one curve separates another keeps together.
 */
static void simplify_walk(struct simplify *s)
{
    struct simplify_set *from = &s->set, *to = &s->spare;
    float lo[3], span = 0.0f;
    for (size_t k = 0; k < 3; k++) {
        const float *x = from->f[SIMPLIFY_X + k];
        float hi = x[0];
        lo[k] = x[0];
        for (size_t i = 0; i < from->n; i++) {
            lo[k] = x[i] < lo[k] ? x[i] : lo[k];
            hi = x[i] > hi ? x[i] : hi;
        }
        span = hi - lo[k] > span ? hi - lo[k] : span;
    }
    static const float shift[4] = {0.0f, 0.29f, 0.57f, 0.83f};
    float scale = span > 0.0f ? 1023.0f / span : 0.0f, by = 1024.0f * shift[s->round % 4];
    size_t n = 0;
    for (size_t i = 0; i < from->n; i++)
        if (s->partner[i] != SIMPLIFY_TAKEN)
            s->words[n++] = simplify_key(from, i, lo, scale, by) << 32 | i;
    sort_words(s->words, s->words_spare, n);
    for (size_t i = 0; i < n; i++)
        s->who[i] = (uint32_t)s->words[i];
    for (size_t k = 0; k < SIMPLIFY_FIELDS; k++)
        for (size_t i = 0; i < n; i++)
            to->f[k][i] = from->f[k][s->who[i]];
    for (size_t i = 0; i < n; i++)
        to->root[i] = from->root[s->who[i]];
    to->n = n;
    struct simplify_set swap = s->set;
    s->set = s->spare;
    s->spare = swap;
}

/* ---- merging ---- */

/* cos(acos(q) / 3) within 6e-10: smooth in cos(acos(q) / 2), so a polynomial of that (interpolated
 * at the Chebyshev nodes of [0, 1]). */
static inline double simplify_third(double q)
{
    static const double c[10] = {0.5000000005459,   0.5773501595549,   -0.1111074176714,
                                 0.05340919389974,  -0.03258147098606, 0.02146796467582,
                                 -0.01336776865959, 0.006717273040461, -0.002244766676011,
                                 0.0003568325769713};
    q = q < 1.0 ? q : 1.0;
    double t = sqrt(0.5 + 0.5 * (q > -1.0 ? q : -1.0)), sum = c[9];
    for (int i = 8; i >= 0; i--)
        sum = sum * t + c[i];
    return sum;
}

/* Eigenvalues, descending, in closed form (Smith 1961), and the direction of the smallest one. */
static void simplify_thin_axis(const double c[6], double value[3], double axis[3])
{
    double mean = (c[0] + c[3] + c[5]) / 3.0;
    double a = c[0] - mean, b = c[3] - mean, d = c[5] - mean;
    double off = c[1] * c[1] + c[2] * c[2] + c[4] * c[4];
    double p = sqrt((a * a + b * b + d * d + 2.0 * off) / 6.0);
    axis[0] = axis[1] = 0.0;
    axis[2] = 1.0;
    value[0] = value[1] = value[2] = mean;
    if (!(p > 1e-12 * mean))
        return;
    double det = a * (b * d - c[4] * c[4]) - c[1] * (c[1] * d - c[4] * c[2]) +
                 c[2] * (c[1] * c[4] - b * c[2]);
    double cosine = simplify_third(det / (2.0 * p * p * p));
    double sine = cosine < 1.0 ? sqrt(1.0 - cosine * cosine) : 0.0;
    value[0] = mean + 2.0 * p * cosine; /* angle is within 0 and pi / 3 */
    value[2] = mean - p * (cosine + 1.7320508075688772 * sine);
    value[1] = 3.0 * mean - value[0] - value[2];
    /* Rows of C - value[2] I span the plane across the axis: the largest of their products. */
    double x = c[0] - value[2], y = c[3] - value[2], z = c[5] - value[2];
    const double n[3][3] = {{c[1] * c[4] - c[2] * y, c[2] * c[1] - x * c[4], x * y - c[1] * c[1]},
                            {c[1] * z - c[2] * c[4], c[2] * c[2] - x * z, x * c[4] - c[1] * c[2]},
                            {y * z - c[4] * c[4], c[4] * c[2] - c[1] * z, c[1] * c[4] - y * c[2]}};
    double best = 0.0;
    size_t which = 0;
    for (size_t i = 0; i < 3; i++) {
        double len = n[i][0] * n[i][0] + n[i][1] * n[i][1] + n[i][2] * n[i][2];
        which = len > best ? i : which;
        best = len > best ? len : best;
    }
    for (size_t k = 0; best > 0.0 && k < 3; k++)
        axis[k] = n[which][k] / sqrt(best);
}

/* Two unit vectors across `n` (Duff et al. 2017). */
static void simplify_across(const double n[3], double u[3], double v[3])
{
    double sign = copysign(1.0, n[2]), a = -1.0 / (sign + n[2]), b = n[0] * n[1] * a;
    u[0] = 1.0 + sign * n[0] * n[0] * a;
    u[1] = sign * b;
    u[2] = -sign * n[0];
    v[0] = b;
    v[1] = sign + n[1] * n[1] * a;
    v[2] = -n[1];
}

/* Covariance of cluster i projected on u and v: uu uv vv. */
static void simplify_project(const struct simplify_set *s, size_t i, const double u[3],
                             const double v[3], double out[3])
{
    double c[6];
    for (size_t m = 0; m < 6; m++)
        c[m] = (double)s->f[SIMPLIFY_CXX + m][i];
    const double cu[3] = {c[0] * u[0] + c[1] * u[1] + c[2] * u[2],
                          c[1] * u[0] + c[3] * u[1] + c[4] * u[2],
                          c[2] * u[0] + c[4] * u[1] + c[5] * u[2]};
    const double cv[3] = {c[0] * v[0] + c[1] * v[1] + c[2] * v[2],
                          c[1] * v[0] + c[3] * v[1] + c[4] * v[2],
                          c[2] * v[0] + c[4] * v[1] + c[5] * v[2]};
    out[0] = u[0] * cu[0] + u[1] * cu[1] + u[2] * cu[2];
    out[1] = v[0] * cu[0] + v[1] * cu[1] + v[2] * cu[2];
    out[2] = v[0] * cv[0] + v[1] * cv[1] + v[2] * cv[2];
}

/* Share of the pair's coverage that one hides of the other, seen along the merger's thinnest axis:
 * the integral of the product of two projected Gaussians over the sum of their integrals. */
static double simplify_hidden(const struct simplify_set *s, size_t a, size_t b, const double d[3],
                              const double axis[3])
{
    double u[3], v[3], s1[3], s2[3];
    simplify_across(axis, u, v);
    simplify_project(s, a, u, v, s1);
    simplify_project(s, b, u, v, s2);
    double du = u[0] * d[0] + u[1] * d[1] + u[2] * d[2];
    double dv = v[0] * d[0] + v[1] * d[1] + v[2] * d[2];
    double oa = (double)s->f[SIMPLIFY_OPACITY][a], ob = (double)s->f[SIMPLIFY_OPACITY][b];
    double d1 = s1[0] * s1[2] - s1[1] * s1[1], d2 = s2[0] * s2[2] - s2[1] * s2[1];
    double t[3] = {s1[0] + s2[0], s1[1] + s2[1], s1[2] + s2[2]};
    double dt = t[0] * t[2] - t[1] * t[1];
    double sum = oa * sqrt(d1 > 0.0 ? d1 : 0.0) + ob * sqrt(d2 > 0.0 ? d2 : 0.0);
    if (!(d1 > 0.0 && d2 > 0.0 && dt > 0.0 && sum > 0.0))
        return 0.0;
    double maha = (t[2] * du * du - 2.0 * t[1] * du * dv + t[0] * dv * dv) / dt;
    double both = oa * ob * sqrt(d1 * d2 / dt) * (double)expf(-0.5f * (float)maha);
    return both < 0.5 * sum ? both / sum : 0.5;
}

/* Cluster b into a. */
static void simplify_merge(struct simplify *s, size_t a, size_t b)
{
    struct simplify_set *t = &s->set;
    double wa = (double)t->f[SIMPLIFY_COVER][a], wb = (double)t->f[SIMPLIFY_COVER][b], w = wa + wb;
    double d[3], cov[6], value[3], axis[3], sigma[3];
    wa /= w;
    wb /= w;
    for (size_t k = 0; k < 3; k++)
        d[k] = (double)t->f[SIMPLIFY_X + k][b] - (double)t->f[SIMPLIFY_X + k][a];
    static const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (size_t m = 0; m < 6; m++)
        cov[m] = wa * (double)t->f[SIMPLIFY_CXX + m][a] + wb * (double)t->f[SIMPLIFY_CXX + m][b] +
                 wa * wb * d[at[m][0]] * d[at[m][1]];
    simplify_thin_axis(cov, value, axis);
    double cover = w * (1.0 - SIMPLIFY_HIDDEN_SHARE * simplify_hidden(t, a, b, d, axis));
    for (size_t k = 0; k < 3; k++)
        sigma[k] = sqrt(value[k] > 1e-12 ? value[k] : 1e-12);
    double opacity = cover / simplify_area(sigma), grow = 1.0;
    if (opacity > SIMPLIFY_OPACITY_MAX) {
        grow = opacity / SIMPLIFY_OPACITY_MAX;
        opacity = SIMPLIFY_OPACITY_MAX;
    }
    for (size_t m = 0; m < 6; m++)
        t->f[SIMPLIFY_CXX + m][a] = (float)(grow * cov[m]);
    for (size_t k = 0; k < 3; k++) {
        float *color = t->f[SIMPLIFY_RED + k], *x = t->f[SIMPLIFY_X + k];
        x[a] = (float)((double)x[a] + wb * d[k]);
        color[a] = (float)(wa * (double)color[a] + wb * (double)color[b]);
    }
    t->f[SIMPLIFY_COVER][a] = (float)cover;
    t->f[SIMPLIFY_OPACITY][a] = (float)opacity;
    simplify_weigh(t, a, s->blur2);
    s->join[s->n_join++] = (struct simplify_join){t->root[a], t->root[b], (float)wb};
}

/* The cheapest pairs whose halves are free, at most `most`: the later one's place goes into
 * partner[] of the earlier one, and the later one is marked as taken. */
static void simplify_choose(struct simplify *s, size_t most)
{
    const size_t n = s->set.n;
    for (size_t i = 0; i < n; i++) {
        s->words[i] = sort_key_float(s->cost[i]) << 32 | i;
        s->partner[i] = SIMPLIFY_FREE;
    }
    sort_words(s->words, s->words_spare, n);
    size_t done = 0;
    for (size_t i = 0; i < n && done < most; i++) {
        uint32_t a = (uint32_t)s->words[i], b = s->who[a];
        if (s->partner[a] != SIMPLIFY_FREE || s->partner[b] != SIMPLIFY_FREE)
            continue;
        s->partner[a < b ? a : b] = a < b ? b : a;
        s->partner[a < b ? b : a] = SIMPLIFY_TAKEN;
        done++;
    }
    s->n_left = n - done;
}

/* One round. Pairs are disjoint, so they are merged in the order of memory. */
static void simplify_round(struct simplify *s, size_t target)
{
    struct simplify_set *t = &s->set;
    simplify_walk(s);
    simplify_cost(t, (float)s->blur2, s->cost, s->who, s->scratch);
    size_t need = t->n - target, most = 1 + (size_t)(SIMPLIFY_A_ROUND * (double)t->n);
    simplify_choose(s, need < most ? need : most);
    for (size_t i = 0; i < t->n; i++)
        if (s->partner[i] < SIMPLIFY_TAKEN)
            simplify_merge(s, i, s->partner[i]);
    s->round++;
}

/* Close the gaps that the last round left. */
static void simplify_compact(struct simplify *s)
{
    struct simplify_set *t = &s->set;
    size_t n = 0;
    for (size_t i = 0; i < t->n; i++)
        if (s->partner[i] != SIMPLIFY_TAKEN)
            s->who[n++] = (uint32_t)i;
    for (size_t k = 0; k < SIMPLIFY_FIELDS; k++)
        for (size_t i = 0; i < n; i++)
            t->f[k][i] = t->f[k][s->who[i]];
    for (size_t i = 0; i < n; i++)
        t->root[i] = t->root[s->who[i]];
    t->n = n;
}

/* ---- all of it ---- */

/* sigma^2 below which thickness does not matter. */
static double simplify_blur2(const struct gauss *g, float *big)
{
    const double max = (double)SIMPLIFY_SCALE_LOG_MAX;
    for (size_t i = 0; i < g->n; i++) {
        const float *l = &g->scale_log[3 * i];
        big[i] = l[0] > l[1] ? l[0] : l[1];
        big[i] = big[i] > l[2] ? big[i] : l[2];
    }
    double mid = (double)sort_select(big, g->n, g->n / 2);
    double blur = SIMPLIFY_BLUR * exp(fmin(fmax(mid, -max), max));
    return blur * blur;
}

static enum err_code simplify_open(struct simplify *s, const struct gauss *g, struct err *e)
{
    size_t n = g->n;
    bool ok = simplify_set_alloc(&s->set, n) && simplify_set_alloc(&s->spare, n);
    s->join = mem_uninit(n, sizeof *s->join);
    s->cost = mem_uninit(n, sizeof *s->cost);
    s->scratch = mem_uninit(n, sizeof *s->scratch);
    s->who = mem_uninit(n, sizeof *s->who);
    s->words = mem_uninit(n, sizeof *s->words);
    s->words_spare = mem_uninit(n, sizeof *s->words);
    s->partner = mem_array(n, sizeof *s->partner);
    if (!ok || !s->join || !s->cost || !s->scratch || !s->who || !s->words || !s->words_spare ||
        !s->partner)
        return err_set(e, ERR_MEM, "out of memory to simplify %zu Gaussians", n);
    s->blur2 = simplify_blur2(g, s->scratch);
    for (size_t i = 0; i < n; i++)
        simplify_init(s, g, i);
    s->set.n = s->n_left = n;
    return ERR_OK;
}

static void simplify_close(struct simplify *s)
{
    simplify_set_free(&s->set);
    simplify_set_free(&s->spare);
    mem_free(s->join);
    mem_free(s->cost);
    mem_free(s->scratch);
    mem_free(s->who);
    mem_free(s->words);
    mem_free(s->words_spare);
    mem_free(s->partner);
}

/* Shape and opacity of a merger, from its moments. */
static void simplify_write_row(const struct simplify_set *s, size_t i, struct gauss *g, size_t to)
{
    double cov[6], value[3], v[9], quat[4];
    for (size_t m = 0; m < 6; m++)
        cov[m] = (double)s->f[SIMPLIFY_CXX + m][i];
    simplify_eigen(cov, value, v);
    camera_rot_to_quat(v, quat);
    for (size_t k = 0; k < 3; k++) {
        g->mean_m[3 * to + k] = s->f[SIMPLIFY_X + k][i];
        g->scale_log[3 * to + k] = (float)(0.5 * log(fmax(value[k], 1e-12)));
    }
    for (size_t k = 0; k < 4; k++)
        g->quat_wxyz[4 * to + k] = (float)quat[k];
    double o = fmin(fmax((double)s->f[SIMPLIFY_OPACITY][i], 1e-6), SIMPLIFY_OPACITY_MAX);
    g->opacity_logit[to] = (float)log(o / (1.0 - o));
}

/* Rows of the input into `out` by the weights that the mergers left them: the last merger's pair
 * shares a weight of 1, and backwards from there. */
static enum err_code simplify_collect(struct simplify *s, const struct gauss *in, struct gauss *out,
                                      struct err *e)
{
    size_t n_sh = 3 * gauss_sh_count(in->sh_degree), n_embed = in->embed_len;
    float *weight = mem_array(in->n, sizeof *weight);
    uint32_t *owner = mem_array(in->n, sizeof *owner);
    bool *merged = mem_array(in->n, sizeof *merged);
    enum err_code rc = weight && owner && merged
                           ? gauss_alloc(out, s->set.n, in->sh_degree, in->embed_len, e)
                           : err_set(e, ERR_MEM, "out of memory to simplify");
    if (rc)
        goto out;
    for (size_t i = 0; i < s->n_join; i++)
        merged[s->join[i].a] = true;
    for (size_t i = 0; i < s->set.n; i++) {
        owner[s->set.root[i]] = (uint32_t)i;
        weight[s->set.root[i]] = 1.0f;
    }
    for (size_t i = s->n_join; i-- > 0;) {
        const struct simplify_join *j = &s->join[i];
        weight[j->b] = weight[j->a] * j->share_b;
        weight[j->a] -= weight[j->b];
        owner[j->b] = owner[j->a];
    }
    memcpy(out->origin_enu_m, in->origin_enu_m, sizeof out->origin_enu_m);
    out->antialiased = in->antialiased;
    out->n = s->set.n;
    for (size_t r = 0; r < in->n; r++) {
        if (r + SIMPLIFY_SOON < in->n)
            for (size_t k = 0; k < n_sh; k += 64 / sizeof(float))
                SIMD_SOON(out->sh + n_sh * owner[r + SIMPLIFY_SOON] + k);
        float w = weight[r], *sh = out->sh + n_sh * owner[r];
        const float *from = in->sh + n_sh * r;
        for (size_t k = 0; k < n_sh; k++)
            sh[k] += w * from[k];
        for (size_t k = 0; k < n_embed; k++)
            out->embed[n_embed * owner[r] + k] += w * in->embed[n_embed * r + k];
    }
    for (size_t i = 0; i < s->set.n; i++)
        if (merged[s->set.root[i]])
            simplify_write_row(&s->set, i, out, i);
        else
            gauss_copy_row(out, i, in, s->set.root[i]);
out:
    mem_free(weight);
    mem_free(owner);
    mem_free(merged);
    return rc;
}

enum err_code simplify_gauss(const struct gauss *in, size_t target, struct gauss *out,
                             struct err *e)
{
    struct simplify s = {0};
    *out = (struct gauss){0};
    if (target == 0 && in->n > 0)
        return err_set(e, ERR_ARG, "simplify: at least 1 Gaussian must remain");
    if (in->n >= UINT32_MAX)
        return err_set(e, ERR_LIMIT, "simplify: %zu Gaussians at once, at most 2^32 - 2", in->n);
    if (in->n <= target) {
        enum err_code rc = gauss_alloc(out, in->n, in->sh_degree, in->embed_len, e);
        memcpy(out->origin_enu_m, in->origin_enu_m, sizeof out->origin_enu_m);
        out->antialiased = in->antialiased;
        return rc ? rc : gauss_append(out, in, NULL, in->n, e);
    }
    enum err_code rc = simplify_open(&s, in, e);
    while (!rc && s.n_left > target)
        simplify_round(&s, target);
    if (!rc) {
        simplify_compact(&s);
        rc = simplify_collect(&s, in, out, e);
    }
    simplify_close(&s);
    if (rc)
        gauss_free(out);
    return rc;
}
