/* Fewer Gaussians of the same look, for the levels that no training made.
 *
 * Rounds of pairwise merging: every Gaussian finds its cheapest neighbour, pairs that chose each
 * other are merged, cheapest first, until `target` are left. Neighbours are looked for in windows
 * of three Morton curves, shifted by thirds of the box (Chan 1998), which together miss few near
 * pairs. The cost of a pair is Runnalls' upper bound of the Kullback-Leibler divergence between the
 * two and their merger (Runnalls 2007), weighted by coverage, plus the difference in colour: it
 * keeps walls from melting into roofs and edges of colour sharp.
 *
 * A merger has the pair's mean, covariance (including the spread of the means) and colour, all
 * weighted by coverage = opacity times projected area. Its coverage is the pair's sum less what the
 * two hid of each other; where that asks for more than full opacity the splat is made larger
 * instead, so opaque surfaces do not thin out.
 *
 * Deterministic: ties are broken by row, and threads only fill their own rows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/simplify.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/camera.h"
#include "core/pool.h"

enum {
    SIMPLIFY_CURVES = 3,
    SIMPLIFY_WINDOW = 4,   /* rows each side of a curve; 12 gives the same pictures */
    SIMPLIFY_CHUNK = 2048, /* rows per unit of parallel work */
    SIMPLIFY_JACOBI = 12,  /* sweeps; 3x3 matrices need 4 to 6 */
};

#define SIMPLIFY_OPACITY_MAX 0.99 /* the renderer's own ceiling */
#define SIMPLIFY_BLUR 0.5 /* of the median sigma: thinner than this is not worth keeping apart */
#define SIMPLIFY_COLOR_WEIGHT 4.0 /* a colour step of 0.2 counts like a distance of one sigma */
#define SIMPLIFY_SCALE_LOG_MAX                                                                     \
    40.0 /* of ln(sigma / m): squares and their determinants stay finite */
#define SIMPLIFY_PAIRS_A_ROUND 0.75 /* of the mutual pairs: later choices see earlier mergers */

struct simplify_cluster {
    double mean[3], cov[6]; /* xx xy xz yy yz zz, metres^2 */
    double coverage;        /* opacity x mean projected area, metres^2 */
    double log_det;         /* of the blurred covariance */
    double opacity, area;
    float color[3]; /* 0..1 scale */
};

struct simplify_pair {
    double cost;
    uint32_t a, b; /* a < b */
};

struct simplify_code {
    uint64_t code;
    uint32_t row;
};

struct simplify {
    struct gauss *g; /* row i holds the merged attributes of cluster i */
    struct simplify_cluster *cluster;
    uint32_t *alive; /* rows of living clusters, ascending */
    size_t n_alive;
    struct simplify_code *codes;      /* scratch */
    uint32_t *curve[SIMPLIFY_CURVES]; /* rows along each curve */
    uint32_t *place[SIMPLIFY_CURVES]; /* row -> position along each curve */
    struct simplify_pair *best;       /* [n], by row */
    double blur2;
    double reach; /* coverage hidden in overlaps counts this much, 0..1 */
};

/* Eigenvalues (descending) and vectors (columns of v, right-handed) of a symmetric 3x3 by cyclic
 * Jacobi. */
void simplify_eigen(const double cov[6], double value[3], double v[9])
{
    double a[3][3] = {{cov[0], cov[1], cov[2]}, {cov[1], cov[3], cov[4]}, {cov[2], cov[4], cov[5]}};
    double q[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int sweep = 0; sweep < SIMPLIFY_JACOBI; sweep++) {
        double off = fabs(a[0][1]) + fabs(a[0][2]) + fabs(a[1][2]);
        if (!(off > 1e-15 * (fabs(a[0][0]) + fabs(a[1][1]) + fabs(a[2][2]))))
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

/* Mean projected area of an ellipsoid of these half axes, over pi: a quarter of its surface
 * (Cauchy), the surface by Thomsen's formula (within 1.1 %). */
double simplify_area(const double s[3])
{
    const double p = 1.6075;
    double ab = pow(s[0] * s[1], p), ac = pow(s[0] * s[2], p), bc = pow(s[1] * s[2], p);
    return pow((ab + ac + bc) / 3.0, 1.0 / p);
}

static double simplify_log_det(const double c[6], double blur2)
{
    double xx = c[0] + blur2, yy = c[3] + blur2, zz = c[5] + blur2;
    double det = xx * (yy * zz - c[4] * c[4]) - c[1] * (c[1] * zz - c[4] * c[2]) +
                 c[2] * (c[1] * c[4] - yy * c[2]);
    return log(fmax(det, 1e-300));
}

/* Sigma as it is reckoned with. Files hold any finite logarithm; one cost that is no number would
 * be nobody's cheapest, and merging would never end. */
static double simplify_sigma(float scale_log)
{
    return exp(fmin(fmax((double)scale_log, -SIMPLIFY_SCALE_LOG_MAX), SIMPLIFY_SCALE_LOG_MAX));
}

static void simplify_init(struct simplify *s, size_t i)
{
    const struct gauss *g = s->g;
    struct simplify_cluster *c = &s->cluster[i];
    double quat[4], rot[9], sigma[3];
    for (size_t k = 0; k < 4; k++)
        quat[k] = (double)g->quat_wxyz[4 * i + k];
    camera_quat_to_rot(quat, rot);
    for (size_t k = 0; k < 3; k++) {
        sigma[k] = simplify_sigma(g->scale_log[3 * i + k]);
        c->mean[k] = (double)g->mean_m[3 * i + k];
        c->color[k] =
            (float)(GAUSS_SH_C0 * (double)g->sh[3 * gauss_sh_count(g->sh_degree) * i + k]);
    }
    static const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (size_t m = 0; m < 6; m++)
        for (size_t k = 0; k < 3; k++)
            c->cov[m] += rot[3 * at[m][0] + k] * rot[3 * at[m][1] + k] * sigma[k] * sigma[k];
    c->opacity = 1.0 / (1.0 + exp(-(double)g->opacity_logit[i]));
    c->area = simplify_area(sigma);
    c->coverage = fmax(c->opacity * c->area, 1e-30);
    c->log_det = simplify_log_det(c->cov, s->blur2);
}

/* ---- choosing pairs ---- */

/* Moments of the pair's mixture. */
static void simplify_moments(const struct simplify_cluster *a, const struct simplify_cluster *b,
                             double mean[3], double cov[6])
{
    double w = a->coverage + b->coverage, wa = a->coverage / w, wb = b->coverage / w;
    double d[3] = {b->mean[0] - a->mean[0], b->mean[1] - a->mean[1], b->mean[2] - a->mean[2]};
    static const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (size_t k = 0; k < 3; k++)
        mean[k] = a->mean[k] + wb * d[k];
    for (size_t m = 0; m < 6; m++)
        cov[m] = wa * a->cov[m] + wb * b->cov[m] + wa * wb * d[at[m][0]] * d[at[m][1]];
}

static double simplify_cost(const struct simplify *s, uint32_t ra, uint32_t rb)
{
    const struct simplify_cluster *a = &s->cluster[ra], *b = &s->cluster[rb];
    double mean[3], cov[6], step = 0.0;
    simplify_moments(a, b, mean, cov);
    for (size_t k = 0; k < 3; k++) {
        double d = (double)a->color[k] - (double)b->color[k];
        step += d * d;
    }
    double w = a->coverage + b->coverage;
    return 0.5 * (w * simplify_log_det(cov, s->blur2) - a->coverage * a->log_det -
                  b->coverage * b->log_det) +
           SIMPLIFY_COLOR_WEIGHT * a->coverage * b->coverage / w * step;
}

static bool simplify_better(const struct simplify_pair *x, const struct simplify_pair *y)
{
    if (x->cost != y->cost)
        return x->cost < y->cost;
    return x->a != y->a ? x->a < y->a : x->b < y->b;
}

static int simplify_pair_compare(const void *x, const void *y)
{
    return simplify_better(x, y) ? -1 : simplify_better(y, x);
}

static enum err_code simplify_search(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct simplify *s = user;
    size_t from = chunk * SIMPLIFY_CHUNK, to = from + SIMPLIFY_CHUNK;
    for (size_t i = from; i < to && i < s->n_alive; i++) {
        uint32_t row = s->alive[i];
        struct simplify_pair best = {.cost = HUGE_VAL, .a = UINT32_MAX, .b = UINT32_MAX};
        for (size_t c = 0; c < SIMPLIFY_CURVES; c++) {
            size_t p = s->place[c][row];
            size_t first = p > SIMPLIFY_WINDOW ? p - SIMPLIFY_WINDOW : 0;
            for (size_t q = first; q <= p + SIMPLIFY_WINDOW && q < s->n_alive; q++) {
                uint32_t other = s->curve[c][q];
                if (other == row)
                    continue;
                struct simplify_pair t = {.a = row < other ? row : other,
                                          .b = row < other ? other : row};
                t.cost = simplify_cost(s, t.a, t.b);
                if (simplify_better(&t, &best))
                    best = t;
            }
        }
        s->best[row] = best;
    }
    return ERR_OK;
}

static uint64_t simplify_spread(uint64_t x)
{
    x &= 0x1fffff;
    x = (x | x << 32) & UINT64_C(0x1f00000000ffff);
    x = (x | x << 16) & UINT64_C(0x1f0000ff0000ff);
    x = (x | x << 8) & UINT64_C(0x100f00f00f00f00f);
    x = (x | x << 4) & UINT64_C(0x10c30c30c30c30c3);
    return (x | x << 2) & UINT64_C(0x1249249249249249);
}

static int simplify_code_compare(const void *a, const void *b)
{
    const struct simplify_code *x = a, *y = b;
    if (x->code != y->code)
        return x->code < y->code ? -1 : 1;
    return x->row < y->row ? -1 : x->row > y->row;
}

/* Curve c: the living rows along a Morton curve over a cube twice the box, the box shifted by c/3
 * of it. */
static void simplify_walk(struct simplify *s, size_t c)
{
    double lo[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, span = 0.0;
    for (size_t i = 0; i < s->n_alive; i++)
        for (size_t k = 0; k < 3; k++)
            lo[k] = fmin(lo[k], s->cluster[s->alive[i]].mean[k]);
    for (size_t i = 0; i < s->n_alive; i++)
        for (size_t k = 0; k < 3; k++)
            span = fmax(span, s->cluster[s->alive[i]].mean[k] - lo[k]);
    double scale = span > 0.0 ? (double)((1 << 20) - 1) / span : 0.0;
    double shift = (double)(1 << 20) * (double)c / 3.0;
    for (size_t i = 0; i < s->n_alive; i++) {
        uint32_t row = s->alive[i];
        uint64_t code = 0;
        for (size_t k = 0; k < 3; k++)
            code |= simplify_spread((uint64_t)((s->cluster[row].mean[k] - lo[k]) * scale + shift))
                    << k;
        s->codes[i] = (struct simplify_code){code, row};
    }
    qsort(s->codes, s->n_alive, sizeof *s->codes, simplify_code_compare);
    for (size_t i = 0; i < s->n_alive; i++) {
        s->curve[c][i] = s->codes[i].row;
        s->place[c][s->codes[i].row] = (uint32_t)i;
    }
}

/* ---- merging ---- */

/* Share of the pair's coverage that one hides of the other, seen along the merger's thinnest axis
 * n: the integral of the product of two projected Gaussians over the sum of their integrals. */
static double simplify_hidden(const struct simplify_cluster *a, const struct simplify_cluster *b,
                              const double v[9])
{
    double s1[3] = {0}, s2[3] = {0}, d[2] = {0}; /* projected covariances xx xy yy, offset */
    static const int at[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) {
            double xx = v[3 * r] * v[3 * c], xy = v[3 * r] * v[3 * c + 1],
                   yy = v[3 * r + 1] * v[3 * c + 1];
            double ca = a->cov[at[r][c]], cb = b->cov[at[r][c]];
            s1[0] += xx * ca;
            s1[1] += xy * ca;
            s1[2] += yy * ca;
            s2[0] += xx * cb;
            s2[1] += xy * cb;
            s2[2] += yy * cb;
        }
        d[0] += v[3 * r] * (b->mean[r] - a->mean[r]);
        d[1] += v[3 * r + 1] * (b->mean[r] - a->mean[r]);
    }
    double d1 = s1[0] * s1[2] - s1[1] * s1[1], d2 = s2[0] * s2[2] - s2[1] * s2[1];
    double t[3] = {s1[0] + s2[0], s1[1] + s2[1], s1[2] + s2[2]};
    double dt = t[0] * t[2] - t[1] * t[1];
    double sum = a->opacity * sqrt(fmax(d1, 0.0)) + b->opacity * sqrt(fmax(d2, 0.0));
    if (!(d1 > 0.0 && d2 > 0.0 && dt > 0.0 && sum > 0.0))
        return 0.0;
    double maha = (t[2] * d[0] * d[0] - 2.0 * t[1] * d[0] * d[1] + t[0] * d[1] * d[1]) / dt;
    double both = a->opacity * b->opacity * sqrt(d1 * d2 / dt) * exp(-0.5 * maha);
    return fmin(both / sum, 0.5);
}

/* Attributes of row b into row a by weights; quaternion, scale and opacity come from the merged
 * moments. */
static void simplify_mix_row(struct gauss *g, size_t a, size_t b, double wa, double wb)
{
    size_t k = 3 * gauss_sh_count(g->sh_degree);
    for (size_t j = 0; j < k; j++)
        g->sh[k * a + j] = (float)(wa * (double)g->sh[k * a + j] + wb * (double)g->sh[k * b + j]);
    for (size_t j = 0; j < g->embed_len; j++) {
        float *x = &g->embed[g->embed_len * a + j];
        *x = (float)(wa * (double)*x + wb * (double)g->embed[g->embed_len * b + j]);
    }
}

static void simplify_write_row(struct gauss *g, size_t i, const struct simplify_cluster *c,
                               const double value[3], const double v[9])
{
    double quat[4];
    camera_rot_to_quat(v, quat);
    for (size_t k = 0; k < 3; k++) {
        g->mean_m[3 * i + k] = (float)c->mean[k];
        g->scale_log[3 * i + k] = (float)(0.5 * log(fmax(value[k], 1e-12)));
    }
    for (size_t k = 0; k < 4; k++)
        g->quat_wxyz[4 * i + k] = (float)quat[k];
    double o = fmin(fmax(c->opacity, 1e-6), SIMPLIFY_OPACITY_MAX);
    g->opacity_logit[i] = (float)log(o / (1.0 - o));
}

static void simplify_merge(struct simplify *s, uint32_t ra, uint32_t rb)
{
    struct simplify_cluster *a = &s->cluster[ra];
    const struct simplify_cluster *b = &s->cluster[rb];
    struct simplify_cluster m = {0};
    double value[3], v[9], sigma[3];
    double w = a->coverage + b->coverage, wa = a->coverage / w, wb = b->coverage / w;
    simplify_moments(a, b, m.mean, m.cov);
    simplify_eigen(m.cov, value, v);
    m.coverage = w * (1.0 - s->reach * simplify_hidden(a, b, v));
    for (size_t k = 0; k < 3; k++) {
        sigma[k] = sqrt(fmax(value[k], 1e-12));
        m.color[k] = (float)(wa * (double)a->color[k] + wb * (double)b->color[k]);
    }
    m.area = simplify_area(sigma);
    m.opacity = m.coverage / m.area;
    if (m.opacity > SIMPLIFY_OPACITY_MAX) {
        double grow = m.opacity / SIMPLIFY_OPACITY_MAX;
        for (size_t k = 0; k < 6; k++)
            m.cov[k] *= grow;
        for (size_t k = 0; k < 3; k++)
            value[k] *= grow;
        m.area *= grow;
        m.opacity = SIMPLIFY_OPACITY_MAX;
    }
    m.log_det = simplify_log_det(m.cov, s->blur2);
    simplify_mix_row(s->g, ra, rb, wa, wb);
    simplify_write_row(s->g, ra, &m, value, v);
    *a = m;
    s->cluster[rb].coverage = 0.0; /* dead */
}

/* One round; returns how many pairs were merged. */
static enum err_code simplify_round(struct simplify *s, size_t target, struct err *e)
{
    for (size_t c = 0; c < SIMPLIFY_CURVES; c++)
        simplify_walk(s, c);
    size_t chunks = (s->n_alive + SIMPLIFY_CHUNK - 1) / SIMPLIFY_CHUNK;
    enum err_code rc = pool_for(chunks, 0, simplify_search, s, e);
    if (rc)
        return rc;
    /* Pairs that chose each other, packed to the front of best[]: pair i is never behind row i. The
     * cheapest of all pairs is always among them, so every round makes progress. */
    size_t n_pairs = 0;
    for (size_t i = 0; i < s->n_alive; i++) {
        uint32_t row = s->alive[i];
        struct simplify_pair p = s->best[row];
        if (p.b != row && p.b != UINT32_MAX && s->best[p.b].a == p.a && s->best[p.b].b == p.b)
            s->best[n_pairs++] = p;
    }
    if (!n_pairs)
        return err_set(e, ERR_DATA, "simplify: %zu Gaussians cannot be compared", s->n_alive);
    qsort(s->best, n_pairs, sizeof *s->best, simplify_pair_compare);
    size_t need = s->n_alive - target;
    size_t some = (size_t)ceil(SIMPLIFY_PAIRS_A_ROUND * (double)n_pairs);
    for (size_t i = 0; i < some && i < need; i++)
        simplify_merge(s, s->best[i].a, s->best[i].b);
    size_t alive = 0;
    for (size_t i = 0; i < s->n_alive; i++)
        if (s->cluster[s->alive[i]].coverage > 0.0)
            s->alive[alive++] = s->alive[i];
    s->n_alive = alive;
    return ERR_OK;
}

static int simplify_float_compare(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return x < y ? -1 : x > y;
}

static enum err_code simplify_open(struct simplify *s, struct gauss *work, struct err *e)
{
    size_t n = work->n;
    s->g = work;
    s->cluster = mem_array(n, sizeof *s->cluster);
    s->alive = mem_array(n, sizeof *s->alive);
    s->codes = mem_array(n, sizeof *s->codes);
    s->best = mem_array(n, sizeof *s->best);
    bool ok = s->cluster && s->alive && s->codes && s->best;
    for (size_t c = 0; c < SIMPLIFY_CURVES; c++) {
        s->curve[c] = mem_array(n, sizeof **s->curve);
        s->place[c] = mem_array(n, sizeof **s->place);
        ok = ok && s->curve[c] && s->place[c];
    }
    float *sigma = mem_array(n, sizeof *sigma);
    if (!ok || !sigma) {
        mem_free(sigma);
        return err_set(e, ERR_MEM, "out of memory to simplify %zu Gaussians", n);
    }
    for (size_t i = 0; i < n; i++)
        sigma[i] = fmaxf(work->scale_log[3 * i],
                         fmaxf(work->scale_log[3 * i + 1], work->scale_log[3 * i + 2]));
    qsort(sigma, n, sizeof *sigma, simplify_float_compare);
    double blur = SIMPLIFY_BLUR * simplify_sigma(sigma[n / 2]);
    s->blur2 = blur * blur;
    mem_free(sigma);
    for (size_t i = 0; i < n; i++) {
        simplify_init(s, i);
        s->alive[i] = (uint32_t)i;
    }
    s->n_alive = n;
    return ERR_OK;
}

static void simplify_close(struct simplify *s)
{
    mem_free(s->cluster);
    mem_free(s->alive);
    mem_free(s->codes);
    mem_free(s->best);
    for (size_t c = 0; c < SIMPLIFY_CURVES; c++) {
        mem_free(s->curve[c]);
        mem_free(s->place[c]);
    }
}

enum err_code simplify_gauss(const struct gauss *in, size_t target, struct gauss *out,
                             struct err *e)
{
    struct simplify s = {.reach = SIMPLIFY_HIDDEN_SHARE};
    struct gauss work = {0};
    uint32_t *order = NULL;
    *out = (struct gauss){0};
    if (target == 0 && in->n > 0)
        return err_set(e, ERR_ARG, "simplify: at least 1 Gaussian must remain");
    if (in->n >= UINT32_MAX)
        return err_set(e, ERR_LIMIT, "simplify: %zu Gaussians at once, at most 2^32 - 2", in->n);
    enum err_code rc = gauss_alloc(&work, in->n, in->sh_degree, in->embed_len, e);
    if (rc)
        return rc;
    memcpy(work.origin_enu_m, in->origin_enu_m, sizeof work.origin_enu_m);
    work.antialiased = in->antialiased;
    if (in->n > target) { /* neighbours near each other in memory: a third of the time on rows in
                             random order */
        order = mem_array(in->n, sizeof *order);
        rc = order ? gauss_morton_order(in, order, e)
                   : err_set(e, ERR_MEM, "out of memory to simplify %zu Gaussians", in->n);
    }
    if (!rc)
        rc = gauss_append(&work, in, order, in->n, e);
    mem_free(order);
    if (!rc && in->n > target) {
        rc = simplify_open(&s, &work, e);
        while (!rc && s.n_alive > target)
            rc = simplify_round(&s, target, e);
        /* Living rows ascend, so each moves forward onto one that is no longer needed. */
        for (size_t i = 0; !rc && i < s.n_alive; i++)
            if (s.alive[i] != i)
                gauss_copy_row(&work, i, &work, s.alive[i]);
        if (!rc)
            work.n = s.n_alive;
    }
    simplify_close(&s);
    if (rc)
        gauss_free(&work);
    else
        *out = work;
    return rc;
}
