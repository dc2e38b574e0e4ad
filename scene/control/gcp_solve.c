/* Robust weighted similarity: see gcp_solve.h.
 *
 * The start is a similarity of three points: the one for which the median distance of all points,
 * in standard deviations, is least (least median of squares, Rousseeuw 1984). The rank is (n + 4) /
 * 2, because three distances are nearly 0 by construction. This distance also measures how much
 * larger errors are than stated, for example because a COLMAP model is bent. Gauss-Newton with
 * weights follows. A point has full weight up to three such standard deviations, less up to six,
 * and none beyond. With four points no rank finds the wrong one. There a point is left out if the
 * other three agree and no other three do.
 *
 * Errors of surveyed points do not depend on the direction of the horizontal axes. Errors of
 * located points come from their marks, rotated and scaled.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_solve.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/cholesky.h"
#include "core/math/sort.h"
#include "scene/control/gcp_locate.h"

enum { SOLVE_STEPS = 30, SOLVE_ALL_TRIPLES = 24, SOLVE_DRAWS = 2000 };
static const double solve_full = 3, solve_none = 6;
/* A distance of three axes is below this 95 times in 100: 7.81 = 2.8^2 by chi squared. */
static const double solve_usual = 2.8;
/* Of three points that fit by themselves, and of a fourth that does not belong to them. */
static const double solve_agree = 3, solve_apart = 6;

/* ---- residuals ---- */

void gcp_solve_residual(const struct sim3 *s, const struct gcp_tie *tie, double residual_m[3],
                        double cov[9])
{
    double half[9], at[3];
    for (size_t r = 0; r < 3; r++)
        for (size_t k = 0; k < 3; k++) {
            half[3 * r + k] = 0;
            for (size_t j = 0; j < 3; j++)
                half[3 * r + k] += s->scale * s->rot[3 * r + j] * tie->cov[3 * j + k];
        }
    for (size_t r = 0; r < 3; r++)
        for (size_t k = 0; k < 3; k++) {
            cov[3 * r + k] = r != k ? 0 : tie->var_m[r == 2];
            for (size_t j = 0; j < 3; j++)
                cov[3 * r + k] += half[3 * r + j] * s->scale * s->rot[3 * k + j];
        }
    sim3_apply(s, tie->x, at);
    for (size_t k = 0; k < 3; k++)
        residual_m[k] = at[k] - tie->y[k];
}

static double solve_square(const double r[3], const double inverse[9])
{
    double sum = 0;
    for (size_t a = 0; a < 3; a++)
        for (size_t b = 0; b < 3; b++)
            sum += r[a] * inverse[3 * a + b] * r[b];
    return sum;
}

double gcp_solve_sigmas(const double residual_m[3], const double cov[9])
{
    double inverse[9];
    return gcp_inverse(cov, inverse) ? sqrt(fmax(0, solve_square(residual_m, inverse))) : HUGE_VAL;
}

static double solve_distance(const struct sim3 *s, const struct gcp_tie *tie)
{
    double r[3], cov[9];
    gcp_solve_residual(s, tie, r, cov);
    return gcp_solve_sigmas(r, cov);
}

/* ---- where to begin ---- */

struct solve_work {
    struct gcp_tie *ties;
    size_t n;
    double (*x)[3], (*y)[3], *scratch;
    const double *up;
    double up_sigma;
};

static bool solve_of(const struct solve_work *w, const uint32_t *index, size_t n, struct sim3 *out)
{
    return sim3_from_pairs((const double(*)[3])w->x, (const double(*)[3])w->y, index, n, w->up,
                           out);
}

/* The distance of rank (n + 4) / 2. */
static double solve_rank(const struct solve_work *w, const struct sim3 *s)
{
    size_t rank = (w->n + 4) / 2;
    for (size_t i = 0; i < w->n; i++)
        w->scratch[i] = solve_distance(s, &w->ties[i]);
    sort_doubles(w->scratch, w->n);
    return w->scratch[(rank < w->n ? rank : w->n) - 1];
}

static void solve_try(const struct solve_work *w, const uint32_t pick[3], double *least,
                      struct sim3 *best)
{
    struct sim3 s;
    if (pick[0] == pick[1] || pick[1] == pick[2] || pick[0] == pick[2] || !solve_of(w, pick, 3, &s))
        return;
    double d = solve_rank(w, &s);
    if (!(d < *least))
        return;
    *least = d;
    *best = s;
}

static void solve_draw(const struct solve_work *w, double *least, struct sim3 *best)
{
    uint32_t n = (uint32_t)w->n;
    for (uint32_t i = 0; n <= SOLVE_ALL_TRIPLES && i < n; i++)
        for (uint32_t j = i + 1; j < n; j++)
            for (uint32_t k = j + 1; k < n; k++)
                solve_try(w, (const uint32_t[3]){i, j, k}, least, best);
    for (uint64_t draw = 0; n > SOLVE_ALL_TRIPLES && draw < SOLVE_DRAWS; draw++) {
        uint32_t pick[3];
        for (uint64_t k = 0; k < 3; k++)
            pick[k] = (uint32_t)(rng_u64(1, draw, k) % n);
        solve_try(w, pick, least, best);
    }
}

/* ---- least squares ---- */

static void solve_rows(const struct gcp_solution *s, const double y[3], double rows[3][7])
{
    const double c[3] = {y[0] - s->center_m[0], y[1] - s->center_m[1], y[2] - s->center_m[2]};
    const double turn[3][3] = {{0, c[2], -c[1]}, {-c[2], 0, c[0]}, {c[1], -c[0], 0}};
    memset(rows, 0, 21 * sizeof(double));
    for (size_t a = 0; a < 3; a++) {
        memcpy(rows[a], turn[a], sizeof turn[a]);
        rows[a][3] = c[a];
        rows[a][4 + a] = 1;
    }
}

/* Add a tie to the normal equations; by a weight of -1 it is taken out. */
static void solve_add(const struct gcp_solution *s, const struct gcp_tie *tie, double weight,
                      double a[49], double b[7])
{
    double r[3], cov[9], inverse[9], rows[3][7], at[3];
    gcp_solve_residual(&s->sim, tie, r, cov);
    if (weight == 0 || !gcp_inverse(cov, inverse))
        return;
    for (size_t k = 0; k < 3; k++)
        at[k] = tie->y[k] + r[k];
    solve_rows(s, at, rows);
    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++) {
            double w = weight * inverse[3 * p + q];
            for (size_t i = 0; i < 7; i++) {
                b[i] -= w * rows[p][i] * r[q];
                for (size_t j = 0; j < 7; j++)
                    a[7 * i + j] += w * rows[p][i] * rows[q][j];
            }
        }
}

/* Two rows: the ground's normal should point upwards. */
static void solve_add_up(const struct solve_work *w, const struct gcp_solution *s, double a[49],
                         double b[7])
{
    double v[3], weight = 1 / (w->up_sigma * w->up_sigma);
    if (!(w->up_sigma > 0))
        return;
    for (size_t r = 0; r < 3; r++)
        v[r] = s->sim.rot[3 * r] * w->up[0] + s->sim.rot[3 * r + 1] * w->up[1] +
               s->sim.rot[3 * r + 2] * w->up[2];
    const double rows[2][3] = {{0, v[2], -v[1]}, {-v[2], 0, v[0]}};
    for (size_t k = 0; k < 2; k++)
        for (size_t i = 0; i < 3; i++) {
            b[i] -= weight * rows[k][i] * v[k];
            for (size_t j = 0; j < 3; j++)
                a[7 * i + j] += weight * rows[k][i] * rows[k][j];
        }
}

static bool solve_normal(const double normal[49], const double b[7], double d[7])
{
    double l[49];
    memcpy(l, normal, sizeof l);
    if (!cholesky_factor(l, 7, 7))
        return false;
    cholesky_solve(l, 7, 7, b, d);
    return true;
}

static double solve_weight(double distance, double factor)
{
    double d = distance / factor;
    return d <= solve_full ? 1 : d <= solve_none ? solve_full / d : 0;
}

static bool solve_refine(const struct solve_work *w, bool robust, struct gcp_solution *s)
{
    for (size_t step = 0; step < SOLVE_STEPS; step++) {
        double b[7] = {0}, d[7], size = 0, sum = 0, at[3];
        memset(s->normal, 0, sizeof s->normal);
        memset(s->center_m, 0, sizeof s->center_m);
        for (size_t i = 0; i < w->n; i++) {
            struct gcp_tie *t = &w->ties[i];
            t->weight = robust ? solve_weight(solve_distance(&s->sim, t), s->factor) : 1;
            sum += t->weight;
            sim3_apply(&s->sim, t->x, at);
            for (size_t k = 0; k < 3; k++)
                s->center_m[k] += t->weight * at[k];
        }
        if (!(sum > 0))
            return false;
        for (size_t k = 0; k < 3; k++)
            s->center_m[k] /= sum;
        for (size_t i = 0; i < w->n; i++)
            solve_add(s, &w->ties[i], w->ties[i].weight, s->normal, b);
        solve_add_up(w, s, s->normal, b);
        if (!solve_normal(s->normal, b, d))
            return false;
        sim3_step(&s->sim, d, s->center_m);
        for (size_t k = 0; k < 7; k++)
            size = fmax(size, fabs(d[k]));
        if (size < 1e-11)
            break;
    }
    return true;
}

/* ---- the whole ---- */

/* Of four points, the one that the other three do without; 4: that cannot be told. */
static size_t solve_odd_one(const struct solve_work *w, struct sim3 *best)
{
    size_t odd = 4, agree = 0;
    for (size_t out = 0; out < 4; out++) {
        uint32_t pick[3];
        struct sim3 s;
        double most = 0;
        for (uint32_t i = 0, k = 0; i < 4; i++)
            if (i != out)
                pick[k++] = i;
        if (!solve_of(w, pick, 3, &s))
            continue;
        for (size_t k = 0; k < 3; k++)
            most = fmax(most, solve_distance(&s, &w->ties[pick[k]]));
        if (most > solve_agree)
            continue;
        agree++;
        if (!(solve_distance(&s, &w->ties[out]) > solve_apart))
            continue;
        odd = out;
        *best = s;
    }
    return agree == 1 ? odd : 4;
}

static bool solve_begin(const struct solve_work *w, bool robust, struct gcp_solution *s)
{
    double least = HUGE_VAL;
    s->factor = 1;
    if (!robust || w->n < 4)
        return solve_of(w, NULL, w->n, &s->sim);
    solve_draw(w, &least, &s->sim);
    if (!(least < HUGE_VAL))
        return false;
    if (w->n > 4 || solve_odd_one(w, &s->sim) == 4)
        s->factor = fmax(1, least / solve_usual);
    return true;
}

enum err_code gcp_solve(struct gcp_tie *ties, size_t n, const double up[3], double up_sigma,
                        bool robust, struct gcp_solution *out, bool *fixed, struct err *e)
{
    struct solve_work w = {.ties = ties,
                           .n = n,
                           .x = mem_array(n, sizeof *w.x),
                           .y = mem_array(n, sizeof *w.y),
                           .scratch = mem_array(n, sizeof *w.scratch),
                           .up = up,
                           .up_sigma = up_sigma};
    bool room = w.x && w.y && w.scratch;
    *out = (struct gcp_solution){.factor = 1};
    for (size_t i = 0; room && i < n; i++) {
        memcpy(w.x[i], ties[i].x, sizeof w.x[i]);
        memcpy(w.y[i], ties[i].y, sizeof w.y[i]);
    }
    *fixed = room && solve_begin(&w, robust, out) && solve_refine(&w, robust, out);
    mem_free(w.x);
    mem_free(w.y);
    mem_free(w.scratch);
    return room ? ERR_OK : err_set(e, ERR_MEM, "out of memory for ground control points");
}

void gcp_solve_error(const struct gcp_solution *s, const double y[3], double cov[9])
{
    double rows[3][7], column[3][7];
    solve_rows(s, y, rows);
    for (size_t k = 0; k < 3; k++)
        if (!solve_normal(s->normal, rows[k], column[k]))
            memset(column[k], 0, sizeof column[k]);
    for (size_t r = 0; r < 3; r++)
        for (size_t k = 0; k < 3; k++) {
            cov[3 * r + k] = 0;
            for (size_t i = 0; i < 7; i++)
                cov[3 * r + k] += rows[r][i] * column[k][i];
        }
}

void gcp_solve_move(const struct gcp_solution *s, const double turn[7], const double y[3],
                    double shift[3])
{
    double rows[3][7];
    solve_rows(s, y, rows);
    for (size_t r = 0; r < 3; r++) {
        shift[r] = 0;
        for (size_t i = 0; i < 7; i++)
            shift[r] += rows[r][i] * turn[i];
    }
}

void gcp_solve_leave_out(const struct gcp_solution *s, const struct gcp_tie *tie,
                         struct gcp_left *out)
{
    struct gcp_solution left = *s;
    double b[7] = {0}, cov[9], own[9], at[3], shift[3], r[3];
    *out = (struct gcp_left){
        {(double)NAN, (double)NAN, (double)NAN}, {(double)NAN, (double)NAN}, (double)NAN, {0}};
    bool counts = tie->weight > 0;
    solve_add(s, tie, counts ? -tie->weight : 1, left.normal, b);
    if (!solve_normal(left.normal, b, out->turn)) {
        memset(out->turn, 0, sizeof out->turn);
        return;
    }
    gcp_solve_residual(&s->sim, tie, r, own);
    sim3_apply(&s->sim, tie->x, at);
    gcp_solve_error(counts ? &left : s, at, cov);
    gcp_solve_move(s, out->turn, at, shift);
    for (size_t k = 0; k < 9; k++)
        cov[k] += own[k];
    for (size_t k = 0; k < 3; k++)
        out->residual_m[k] = r[k] + (counts ? shift[k] : 0);
    out->sigmas = gcp_solve_sigmas(out->residual_m, cov) / s->factor;
    out->sigma_m[0] = s->factor * sqrt(0.5 * (cov[0] + cov[4]));
    out->sigma_m[1] = s->factor * sqrt(cov[8]);
}
