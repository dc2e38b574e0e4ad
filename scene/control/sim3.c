/* Similarities between camera centres and GPS positions.
 *
 * The closed form is Horn's (1987). The rotation is the quaternion of the largest eigenvalue of a
 * 4x4 matrix, which Jacobi's method finds. The refinement minimises, over rotation, scale, shift
 * and one height offset a flight:
 *
 *     sum_i w_i |y_i - s R x_i - t - o_flight(i) e_z|^2    GPS positions
 *     + mean_i (e_z . R right_i)^2 / sigma_level^2         cameras are level except for their roll
 *     + |R normal - e_z|_xy^2 / sigma_ground^2             the ground is roughly horizontal
 *
 * Weights are robust (Huber, then cut). Places and heights have separate ones, with errors
 * estimated from residuals. Errors of receivers drift, so neighbours in time have similar errors. n
 * positions therefore count as n (1 - rho) / (1 + rho) independent ones, with rho the correlation
 * of neighbours. Without this, a height that drifts by 100 m in one flight would tilt the scene by
 * 45 degrees and look certain. With it, the two weak terms win in such a case, and GPS wins where
 * it is reliable. sigma_level is how far the cameras are from being level with each other. The term
 * is a mean and not a sum, because rolls of one flight (wind, a crooked mount) are not independent
 * either.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/sim3.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/cholesky.h"
#include "core/math/sort.h"
#include "core/splat/camera.h"

enum { UNKNOWNS = 7 + SIM3_GROUPS_MAX - 1, REFINE_MAX = 30, JACOBI_SWEEPS = 40 };
static const double sigma_floor_m = 0.01, sigma_ground = 0.2, level_floor = 0.02;
static const double median_2d = 1.1774,
                    median_1d = 0.6745; /* of |r| over sigma per axis: Rayleigh, half normal */
static const double huber_k = 3,
                    cut_k = 6; /* of |r| over sigma, three axes: 97 % are below huber_k */
static const double share_min = 0.005, height_weight_ratio = 2;
enum {
    FREEZE_STEP = 12
}; /* from here on the error estimates stay, so that the iteration can settle */

void sim3_apply(const struct sim3 *s, const double x[3], double y[3])
{
    for (int i = 0; i < 3; i++)
        y[i] = s->scale *
                   (s->rot[3 * i] * x[0] + s->rot[3 * i + 1] * x[1] + s->rot[3 * i + 2] * x[2]) +
               s->trans[i];
}

static void sim3_rotate(const double r[9], const double x[3], double y[3])
{
    for (int i = 0; i < 3; i++)
        y[i] = r[3 * i] * x[0] + r[3 * i + 1] * x[1] + r[3 * i + 2] * x[2];
}

/* ---- eigenvectors ---- */

/* One Jacobi rotation that clears a[p][q]. */
static void sim3_jacobi_turn(double *a, double *v, size_t n, size_t p, size_t q)
{
    double apq = a[p * n + q];
    if (apq == 0)
        return;
    double theta = (a[q * n + q] - a[p * n + p]) / (2 * apq);
    double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
    double c = 1 / sqrt(t * t + 1), s = t * c;
    for (size_t k = 0; k < n; k++) {
        double x = a[k * n + p], y = a[k * n + q];
        a[k * n + p] = c * x - s * y;
        a[k * n + q] = s * x + c * y;
    }
    for (size_t k = 0; k < n; k++) {
        double x = a[p * n + k], y = a[q * n + k];
        a[p * n + k] = c * x - s * y;
        a[q * n + k] = s * x + c * y;
        x = v[p * n + k];
        y = v[q * n + k];
        v[p * n + k] = c * x - s * y;
        v[q * n + k] = s * x + c * y;
    }
}

void sim3_eigen(const double *matrix, size_t n, double *values, double *vectors)
{
    double a[16];
    memcpy(a, matrix, n * n * sizeof *a);
    for (size_t i = 0; i < n * n; i++)
        vectors[i] = i % (n + 1) == 0;
    for (int sweep = 0; sweep < JACOBI_SWEEPS; sweep++) {
        double off = 0, diag = 0;
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++)
                *(i == j ? &diag : &off) += a[i * n + j] * a[i * n + j];
        if (off <= 1e-30 * diag)
            break;
        for (size_t p = 0; p + 1 < n; p++)
            for (size_t q = p + 1; q < n; q++)
                sim3_jacobi_turn(a, vectors, n, p, q);
    }
    for (size_t i = 0; i < n; i++)
        values[i] = a[i * n + i];
    for (size_t i = 0; i < n; i++) /* ascending */
        for (size_t j = i + 1; j < n; j++)
            if (values[j] < values[i]) {
                double t = values[i];
                values[i] = values[j];
                values[j] = t;
                for (size_t k = 0; k < n; k++) {
                    t = vectors[i * n + k];
                    vectors[i * n + k] = vectors[j * n + k];
                    vectors[j * n + k] = t;
                }
            }
}

/* ---- closed form ---- */

/* Rotation that maximises sum y . R x, given h[3*a+b] = sum x_a y_b. */
static void sim3_rotation_from_moments(const double h[9], double rot[9])
{
    const double n[16] = {h[0] + h[4] + h[8],  h[5] - h[7], h[6] - h[2], h[1] - h[3], h[5] - h[7],
                          h[0] - h[4] - h[8],  h[1] + h[3], h[6] + h[2], h[6] - h[2], h[1] + h[3],
                          -h[0] + h[4] - h[8], h[5] + h[7], h[1] - h[3], h[6] + h[2], h[5] + h[7],
                          -h[0] - h[4] + h[8]};
    double values[4], vectors[16];
    sim3_eigen(n, 4, values, vectors);
    camera_quat_to_rot(vectors + 12, rot);
}

bool sim3_from_pairs(const double (*x)[3], const double (*y)[3], const uint32_t *index, size_t n,
                     const double up_x[3], struct sim3 *out)
{
    double mx[3] = {0}, my[3] = {0}, h[9] = {0}, xx = 0, yy = 0, yrx = 0, norm = 0;
    for (size_t k = 0; k < n; k++) {
        size_t i = index ? index[k] : k;
        for (int a = 0; a < 3; a++) {
            mx[a] += x[i][a] / (double)n;
            my[a] += y[i][a] / (double)n;
        }
    }
    for (size_t k = 0; k < n; k++) {
        size_t i = index ? index[k] : k;
        for (int a = 0; a < 3; a++) {
            xx += (x[i][a] - mx[a]) * (x[i][a] - mx[a]);
            yy += (y[i][a] - my[a]) * (y[i][a] - my[a]);
            for (int b = 0; b < 3; b++)
                h[3 * a + b] += (x[i][a] - mx[a]) * (y[i][b] - my[b]);
        }
    }
    if (!(xx > 0 && yy > 0))
        return false;
    double up_h[9];
    for (int i = 0; i < 9; i++)
        norm += h[i] * h[i];
    memcpy(up_h, h, sizeof up_h);
    for (int a = 0; a < 3; a++) /* a pair (up_x, e_z) of a hundredth of the weight */
        up_h[3 * a + 2] += 0.01 * sqrt(norm) * up_x[a];
    sim3_rotation_from_moments(up_h, out->rot);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            yrx += out->rot[3 * b + a] * h[3 * a + b];
    out->scale = yrx / xx;
    if (!(out->scale > 0))
        return false;
    double rm[3];
    sim3_rotate(out->rot, mx, rm);
    for (int a = 0; a < 3; a++)
        out->trans[a] = my[a] - out->scale * rm[a];
    return true;
}

bool sim3_from_plan(const double (*x)[3], const double (*y)[3], const uint32_t *index, size_t n,
                    const double up_x[3], double *scratch, struct sim3 *out)
{
    /* Level axes in the frame of x: any east at right angles to up, and north. */
    double east[3], north[3], len = 0, c[2] = {0}, mean[4] = {0}, uu = 0;
    int k0 = fabs(up_x[0]) < 0.8 ? 0 : 1;
    for (int a = 0; a < 3; a++) {
        east[a] = (a == k0) - up_x[k0] * up_x[a];
        len += east[a] * east[a];
    }
    for (int a = 0; a < 3; a++)
        east[a] /= sqrt(len);
    north[0] = up_x[1] * east[2] - up_x[2] * east[1];
    north[1] = up_x[2] * east[0] - up_x[0] * east[2];
    north[2] = up_x[0] * east[1] - up_x[1] * east[0];
    for (int pass = 0; pass < 2; pass++)
        for (size_t k = 0; k < n; k++) {
            size_t i = index ? index[k] : k;
            const double v[4] = {x[i][0] * east[0] + x[i][1] * east[1] + x[i][2] * east[2],
                                 x[i][0] * north[0] + x[i][1] * north[1] + x[i][2] * north[2],
                                 y[i][0], y[i][1]};
            for (int a = 0; a < 4; a++)
                mean[a] += pass ? 0 : v[a] / (double)n;
            const double p[4] = {v[0] - mean[0], v[1] - mean[1], v[2] - mean[2], v[3] - mean[3]};
            if (pass) { /* y = (re + i im) x as complex numbers */
                c[0] += p[0] * p[2] + p[1] * p[3];
                c[1] += p[0] * p[3] - p[1] * p[2];
                uu += p[0] * p[0] + p[1] * p[1];
            }
        }
    if (!(uu > 0))
        return false;
    double re = c[0] / uu, im = c[1] / uu;
    out->scale = hypot(re, im);
    if (!(out->scale > 0))
        return false;
    for (int a = 0; a < 3; a++) {
        out->rot[a] = (re * east[a] - im * north[a]) / out->scale;
        out->rot[3 + a] = (im * east[a] + re * north[a]) / out->scale;
        out->rot[6 + a] = up_x[a];
    }
    out->trans[0] = mean[2] - (re * mean[0] - im * mean[1]);
    out->trans[1] = mean[3] - (im * mean[0] + re * mean[1]);
    out->trans[2] = 0;
    for (size_t k = 0; k < n; k++) {
        size_t i = index ? index[k] : k;
        double at[3];
        sim3_apply(out, x[i], at);
        scratch[k] = y[i][2] - at[2];
    }
    out->trans[2] = sort_median(scratch, n);
    return true;
}

/* ---- refinement ---- */

static void sim3_residual_at(const struct sim3_problem *p, const struct sim3_fit *f, size_t i,
                             double r[3])
{
    double y[3];
    sim3_apply(&f->sim, p->x[i], y);
    y[2] += f->offset_m[p->group[i]];
    for (int a = 0; a < 3; a++)
        r[a] = p->y[i][a] - y[a];
}

/* The same in units of the errors of a middle pair. */
static void sim3_residual_even(const struct sim3_problem *p, const struct sim3_fit *f, size_t i,
                               double r[3])
{
    sim3_residual_at(p, f, i, r);
    for (int a = 0; p->ratio && a < 3; a++)
        r[a] /= p->ratio[i][a == 2];
}

double sim3_residual(const struct sim3_problem *p, const struct sim3_fit *fit, size_t i)
{
    double r[3], trust = 1;
    sim3_residual_at(p, fit, i, r);
    if (fit->sigma_v_m > height_weight_ratio * fit->sigma_h_m && fit->sigma_h_m > 0)
        trust = height_weight_ratio * fit->sigma_h_m / fit->sigma_v_m;
    return sqrt(r[0] * r[0] + r[1] * r[1] + trust * r[2] * trust * r[2]);
}

struct normal_eq { /* upper triangle not mirrored until solved; unknowns: rotation, log scale,
                      shift, offsets */
    double a[UNKNOWNS][UNKNOWNS], b[UNKNOWNS];
    size_t n;
};

static void sim3_eq_add(struct normal_eq *q, const double *row, double residual, double weight)
{
    for (size_t i = 0; i < q->n; i++) {
        if (row[i] == 0)
            continue;
        q->b[i] += weight * row[i] * residual;
        for (size_t j = 0; j < q->n; j++)
            q->a[i][j] += weight * row[i] * row[j];
    }
}

/* Robust weight from the residual in units of its errors; pairs within cut_m are never cut. */
static double sim3_weight_at(const struct sim3_problem *p, const struct sim3_fit *f, size_t i,
                             const double r[3])
{
    double h2 = (r[0] * r[0] + r[1] * r[1]) / (f->sigma_h_m * f->sigma_h_m);
    double d = sqrt(h2 + r[2] * r[2] / (f->sigma_v_m * f->sigma_v_m));
    if (!(d <= cut_k) && !(sim3_residual(p, f, i) <= p->cut_m))
        return 0;
    return d <= huber_k ? 1 : huber_k / d;
}

/* Rows of the GPS positions; center is the mean of s R x + t, about which the rotation turns. */
static void sim3_add_positions(const struct sim3_problem *p, const struct sim3_fit *f,
                               const double center[3], struct normal_eq *q)
{
    double wh = f->share_h / (f->sigma_h_m * f->sigma_h_m),
           wv = f->share_v / (f->sigma_v_m * f->sigma_v_m);
    for (size_t i = 0; i < p->n; i++) {
        double r[3], y[3];
        if (!p->use[i])
            continue;
        sim3_residual_even(p, f, i, r);
        double w = sim3_weight_at(p, f, i, r);
        if (w == 0)
            continue;
        double even[2] = {p->ratio ? p->ratio[i][0] : 1, p->ratio ? p->ratio[i][1] : 1};
        sim3_residual_at(p, f, i, r);
        sim3_apply(&f->sim, p->x[i], y);
        for (int a = 0; a < 3; a++)
            y[a] -= center[a];
        /* d(s R x) = omega x y + y dlog s */
        const double turn[3][3] = {{0, y[2], -y[1]}, {-y[2], 0, y[0]}, {y[1], -y[0], 0}};
        for (int a = 0; a < 3; a++) {
            double row[UNKNOWNS] = {turn[a][0], turn[a][1], turn[a][2], y[a]};
            row[4 + a] = 1;
            if (a == 2 && p->group[i])
                row[6 + p->group[i]] = 1;
            sim3_eq_add(q, row, r[a], w * (a == 2 ? wv : wh) / (even[a == 2] * even[a == 2]));
        }
    }
}

/* Rows of the two weak terms; returns what they cost. */
static double sim3_add_level(const struct sim3_problem *p, const struct sim3_fit *f,
                             struct normal_eq *q)
{
    double v[3], cost = 0;
    size_t n = 0;
    for (size_t i = 0; i < p->n; i++)
        n += p->use[i];
    double sigma2 = fmax(level_floor * level_floor, p->level_sigma * p->level_sigma) * (double)n;
    for (size_t i = 0; i < p->n; i++) {
        if (!p->use[i])
            continue;
        sim3_rotate(f->sim.rot, p->right[i], v); /* e_z . (omega x v) = omega . (v x e_z) */
        double row[UNKNOWNS] = {v[1], -v[0], 0};
        sim3_eq_add(q, row, -v[2], 1 / sigma2);
        cost += v[2] * v[2] / sigma2;
    }
    sim3_rotate(f->sim.rot, p->normal, v);
    if (v[0] == 0 && v[1] == 0 && v[2] == 0)
        return cost;
    double s = p->normal_sigma > 0 ? p->normal_sigma : sigma_ground;
    cost += (v[0] * v[0] + v[1] * v[1] + (v[2] < 0 ? 4 : 0)) / (s * s);
    double row_x[UNKNOWNS] = {0, v[2], -v[1]}, row_y[UNKNOWNS] = {-v[2], 0, v[0]};
    sim3_eq_add(q, row_x, -v[0], 1 / (s * s));
    sim3_eq_add(q, row_y, -v[1], 1 / (s * s));
    return cost;
}

void sim3_step(struct sim3 *s, const double d[7], const double center[3])
{
    double angle = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]),
           half = angle > 1e-12 ? sin(0.5 * angle) / angle : 0.5;
    double quat[4] = {cos(0.5 * angle), d[0] * half, d[1] * half, d[2] * half}, turn[9], rot[9],
           v[3];
    double grow = exp(fmin(1, fmax(-1, d[3])));
    camera_quat_to_rot(quat, turn);
    for (int i = 0; i < 3; i++)
        v[i] = s->trans[i] - center[i];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            rot[3 * i + j] = turn[3 * i] * s->rot[j] + turn[3 * i + 1] * s->rot[3 + j] +
                             turn[3 * i + 2] * s->rot[6 + j];
        s->trans[i] =
            center[i] +
            grow * (turn[3 * i] * v[0] + turn[3 * i + 1] * v[1] + turn[3 * i + 2] * v[2]) +
            d[4 + i];
    }
    s->scale *= grow;
    camera_rot_to_quat(rot, quat);
    camera_quat_to_rot(quat, s->rot);
}

static void sim3_fit_step(struct sim3_fit *f, const double *d, const double center[3],
                          size_t n_groups)
{
    sim3_step(&f->sim, d, center);
    for (size_t g = 1; g < n_groups; g++)
        f->offset_m[g] += d[6 + g];
}

static void sim3_standard_errors(const struct normal_eq *q, struct sim3_fit *f)
{
    double var[7];
    for (size_t i = 0; i < 7; i++) {
        double unit[UNKNOWNS] = {0}, column[UNKNOWNS];
        unit[i] = 1;
        cholesky_solve(&q->a[0][0], q->n, UNKNOWNS, unit, column);
        var[i] = column[i];
    }
    f->tilt_rad = sqrt(fmax(var[0], var[1]));
    f->heading_rad = sqrt(var[2]);
    f->scale_rel = sqrt(var[3]);
    f->place_m = sqrt(fmax(var[4], fmax(var[5], var[6])));
}

/* Share of the residuals that is independent, from the correlation of neighbours among the pairs in
 * use; residuals beyond three sigma are clipped. */
static double sim3_independent_share(const struct sim3_problem *p, const struct sim3_fit *f,
                                     int first, int last, double sigma)
{
    double last_r[3] = {0}, product = 0, square = 0;
    size_t n = 0;
    for (size_t i = 0; i < p->n; i++) {
        double r[3];
        if (!p->use[i])
            continue;
        sim3_residual_even(p, f, i, r);
        for (int a = first; a <= last; a++) {
            r[a] = fmax(-3 * sigma, fmin(3 * sigma, r[a]));
            product += n ? r[a] * last_r[a] : 0;
            square += r[a] * r[a];
            last_r[a] = r[a];
        }
        n++;
    }
    double rho = square > 0 ? product / square : 0;
    if (n < 10 || rho < 2.5 / sqrt((double)n)) /* not distinguishable from none */
        return 1;
    return fmax(share_min, (1 - rho) / (1 + rho));
}

/* Mean of the fitted places; unless frozen, errors of places and heights from the medians of the
 * residuals. */
static void sim3_spread_at(const struct sim3_problem *p, struct sim3_fit *f, bool frozen,
                           double *scratch, double center[3])
{
    size_t n = 0;
    double *heights = scratch + p->n;
    memset(center, 0, 3 * sizeof *center);
    for (size_t i = 0; i < p->n; i++) {
        double y[3], r[3];
        if (!p->use[i])
            continue;
        sim3_apply(&f->sim, p->x[i], y);
        for (int a = 0; a < 3; a++)
            center[a] += y[a];
        sim3_residual_even(p, f, i, r);
        scratch[n] = sqrt(r[0] * r[0] + r[1] * r[1]);
        heights[n++] = fabs(r[2]);
    }
    for (int a = 0; a < 3; a++)
        center[a] /= (double)(n ? n : 1);
    if (frozen)
        return;
    f->sigma_h_m = fmax(sigma_floor_m, sort_median(scratch, n) / median_2d);
    f->sigma_v_m =
        fmax(0.5 * f->sigma_h_m, fmax(sigma_floor_m, sort_median(heights, n) / median_1d));
    f->share_h = sim3_independent_share(p, f, 0, 1, f->sigma_h_m);
    f->share_v = sim3_independent_share(p, f, 2, 2, f->sigma_v_m);
    f->objective = (double)n * (2 * log(f->sigma_h_m) + log(f->sigma_v_m));
}

enum err_code sim3_refine(const struct sim3_problem *p, struct sim3_fit *fit, struct err *e)
{
    double *scratch = mem_array(p->n, 2 * sizeof *scratch), center[3], d[UNKNOWNS], weak = 0;
    struct normal_eq q;
    enum err_code rc = ERR_OK;
    if (!scratch)
        return err_set(e, ERR_MEM, "georeferencing: out of memory for %zu photographs", p->n);
    for (int step = 0; step < REFINE_MAX; step++) {
        sim3_spread_at(p, fit, step >= FREEZE_STEP, scratch, center);
        memset(&q, 0, sizeof q);
        q.n = 6 + p->n_groups;
        sim3_add_positions(p, fit, center, &q);
        weak = sim3_add_level(p, fit, &q);
        if (!cholesky_factor(&q.a[0][0], q.n, UNKNOWNS)) {
            rc = err_set(
                e, ERR_DATA,
                "the GPS positions do not determine where the scene lies (all at one place?)");
            break;
        }
        cholesky_solve(&q.a[0][0], q.n, UNKNOWNS, q.b, d);
        sim3_fit_step(fit, d, center, p->n_groups);
        double size = 0;
        for (size_t k = 0; k < q.n; k++)
            size = fmax(size, fabs(d[k]));
        if (size < 1e-10)
            break;
    }
    if (!rc) {
        sim3_spread_at(p, fit, false, scratch, center);
        fit->objective += 0.5 * weak;
        sim3_standard_errors(&q, fit);
    }
    mem_free(scratch);
    return rc;
}
