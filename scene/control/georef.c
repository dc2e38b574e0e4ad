/* Finds reliable GPS positions, and the frame that follows from them.
 *
 * Random draws of three photographs give a similarity that many agree with (RANSAC, scored by
 * truncated squares, MSAC). A robust least-squares fit follows. Heights of different days or
 * receivers may differ by metres while everything else agrees. A fit that ignores this would tilt
 * the scene and reject half of it. Therefore partitions into flights are tried: by pauses, by a
 * jump along the order of names, by two clusters of height. Each flight gets a height offset, and a
 * partition is used if it explains the positions much better. Then photographs farther from their
 * GPS position than tau = clamp(median(e) + 5 * 1.4826 * MAD(e), tau_min, tau_max) are dropped, and
 * the fit is repeated, at most three times.
 *
 * Sources: Fischler and Bolles 1981 (RANSAC), Torr and Zisserman 2000 (MSAC), Horn 1987.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/sort.h"
#include "scene/control/georef.h"

enum {
    DRAWS_MAX = 10000,
    DRAWS_MIN = 300,
    ROUNDS_MAX = 3,
    JUMPS_TRIED = 48,
    FLIGHT_MIN = 3,
    FLIGHTS_PHOTOS_MIN = 12
};
static const double collinear_ratio = 0.01;
/* limits of the rejection distance: GPS without corrections is seldom better or worse */
static const double tau_min_m = 6, tau_max_m = 64;
static const double ratio_most = 1000; /* accuracies that are said are believed so far */
/* For a partition to be taken: cost against that of one flight. Cutting one normal distribution of
 * heights at its middle leaves 0.79 of the cost, so clusters must do much better than that. A
 * receiver that drifts is no second flight: a jump must be sudden and fit better than a parabola,
 * and clusters that follow each other in order are a jump. */
static const double better_in_order = 0.8, better_in_clusters = 0.6, offset_min_m = 1,
                    offset_sigmas = 4;
static const double jump_sudden = 0.5, jump_better = 0.9, cluster_changes = 0.1;
enum { JUMP_WINDOW = 10 };
enum partition { PARTITION_PAUSE, PARTITION_JUMP, PARTITION_CLUSTER };
static const double georef_level = 0.03, normal_sigma = 0.2,
                    hint_sigma = 0.5; /* radians, of upright_at */

void georef_free(struct georef_result *r)
{
    mem_free(r->residual_m);
    mem_free(r->dropped);
    mem_free(r->flight);
    *r = (struct georef_result){0};
}

/* ---- which way is up ---- */

/* How far the cameras may lean to a side, all together. Gimbals hold them level; where they differ
 * from each other nothing does, and what hangs from a kite hangs askew: the ground knows better. */
static double georef_level_sigma(const struct georef_photo *photos, size_t n)
{
    double m[9] = {0}, values[3], vectors[9];
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            for (size_t i = 0; i < n; i++)
                m[3 * a + b] += photos[i].rot[a] * photos[i].rot[b] / (double)n;
    sim3_eigen(m, 3, values, vectors);
    return fmax(georef_level, fmax(values[0], 0) / georef_level);
}

/* Up in COLMAP's frame, from cameras that do not roll, over ground that is roughly level: the
 * direction most at right angles to all camera x axes and closest to the ground normal. */
static void georef_upright_at(const struct georef_photo *photos, size_t n, const double normal[3],
                              double sigma, double up[3])
{
    double hint[3] = {0}, m[9] = {0}, values[3], vectors[9];
    bool known = normal[0] != 0 || normal[1] != 0 || normal[2] != 0;
    double level = known && !(sigma > 0) ? georef_level_sigma(photos, n) : georef_level;
    for (size_t i = 0; i < n;
         i++) /* between "up in the picture" and "backwards": right for any pitch down */
        for (int a = 0; a < 3; a++)
            hint[a] -= photos[i].rot[3 + a] + photos[i].rot[6 + a];
    double len = sqrt(hint[0] * hint[0] + hint[1] * hint[1] + hint[2] * hint[2]);
    for (int a = 0; a < 3; a++)
        hint[a] = len > 0 ? hint[a] / len : a == 2;
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            for (size_t i = 0; i < n; i++)
                m[3 * a + b] += photos[i].rot[a] * photos[i].rot[b] / ((double)n * level * level);
            double s = !known ? hint_sigma : sigma > 0 ? sigma : normal_sigma, s2 = s * s;
            m[3 * a + b] += ((a == b) - (known ? normal[a] * normal[b] : hint[a] * hint[b])) / s2;
        }
    sim3_eigen(m, 3, values, vectors);
    double sign = vectors[0] * hint[0] + vectors[1] * hint[1] + vectors[2] * hint[2] < 0 ? -1 : 1;
    for (int a = 0; a < 3; a++)
        up[a] = sign * vectors[a];
}

enum err_code georef_upright(const struct georef_photo *photos, size_t n,
                             const double ground_normal[3], double sigma, double scale,
                             struct sim3 *out, struct err *e)
{
    double up[3], east[3], north[3], mean[3] = {0}, at[3];
    if (!n)
        return err_set(e, ERR_DATA, "no photographs are left");
    georef_upright_at(photos, n, ground_normal, sigma, up);
    int a = fabs(up[0]) < 0.8 ? 0 : 1; /* an axis that is not up */
    double dot = up[a], len = sqrt(1 - dot * dot);
    for (int i = 0; i < 3; i++)
        east[i] = ((i == a) - dot * up[i]) / len;
    north[0] = up[1] * east[2] - up[2] * east[1];
    north[1] = up[2] * east[0] - up[0] * east[2];
    north[2] = up[0] * east[1] - up[1] * east[0];
    *out = (struct sim3){.scale = scale};
    for (int i = 0; i < 3; i++) {
        out->rot[i] = east[i];
        out->rot[3 + i] = north[i];
        out->rot[6 + i] = up[i];
        for (size_t k = 0; k < n; k++)
            mean[i] += photos[k].center[i] / (double)n;
    }
    sim3_apply(out, mean, at);
    out->trans[0] = -at[0];
    out->trans[1] = -at[1];
    return ERR_OK;
}

/* ---- the fit ---- */

struct work { /* arrays of one georef_fit, all [n] */
    size_t n;
    double (*x)[3], (*y)[3], (*right)[3], (*ratio)[2], *scratch, *e;
    bool *use;
    uint32_t *group, *trial, *with_gps;
    size_t n_gps;
    double up[3];
    struct sim3_problem p;
    const struct georef_config *cfg;
};

static void georef_work_free(struct work *w)
{
    mem_free(w->x);
    mem_free(w->y);
    mem_free(w->right);
    mem_free(w->ratio);
    mem_free(w->scratch);
    mem_free(w->e);
    mem_free(w->use);
    mem_free(w->group);
    mem_free(w->trial);
    mem_free(w->with_gps);
}

/* How much more each position errs than the middle one of those that say it: their errors are
 * found from the residuals, how they differ from what was said. */
static void georef_ratios(struct work *w, const struct georef_photo *photos)
{
    for (size_t k = 0; k < 2; k++) {
        size_t n = 0;
        for (size_t i = 0; i < w->n; i++)
            if (photos[i].has_gps && photos[i].sigma_m[k] > 0)
                w->scratch[n++] = photos[i].sigma_m[k];
        double middle = sort_median(w->scratch, n);
        for (size_t i = 0; i < w->n; i++)
            w->ratio[i][k] =
                photos[i].has_gps && photos[i].sigma_m[k] > 0
                    ? fmin(ratio_most, fmax(1 / ratio_most, photos[i].sigma_m[k] / middle))
                    : 1;
    }
}

static enum err_code georef_work_make(struct work *w, const struct georef_photo *photos, size_t n,
                                      const struct georef_config *cfg, struct err *e)
{
    *w = (struct work){.n = n, .cfg = cfg};
    w->x = mem_array(n, sizeof *w->x);
    w->y = mem_array(n, sizeof *w->y);
    w->right = mem_array(n, sizeof *w->right);
    w->ratio = mem_array(n, sizeof *w->ratio);
    w->scratch = mem_array(n, sizeof *w->scratch);
    w->e = mem_array(n, sizeof *w->e);
    w->use = mem_array(n, sizeof *w->use);
    w->group = mem_array(n, sizeof *w->group);
    w->trial = mem_array(n, sizeof *w->trial);
    w->with_gps = mem_array(n, sizeof *w->with_gps);
    if (!w->x || !w->y || !w->right || !w->ratio || !w->scratch || !w->e || !w->use || !w->group ||
        !w->trial || !w->with_gps)
        return err_set(e, ERR_MEM, "georeferencing: out of memory for %zu photographs", n);
    for (size_t i = 0; i < n; i++) {
        memcpy(w->x[i], photos[i].center, sizeof w->x[i]);
        memcpy(w->y[i], photos[i].gps_enu_m, sizeof w->y[i]);
        memcpy(w->right[i], photos[i].rot, sizeof w->right[i]);
        w->use[i] = photos[i].has_gps;
        if (photos[i].has_gps)
            w->with_gps[w->n_gps++] = (uint32_t)i;
    }
    georef_ratios(w, photos);
    georef_upright_at(photos, n, cfg->ground_normal, cfg->normal_sigma, w->up);
    w->p = (struct sim3_problem){.x = (const double(*)[3])w->x,
                                 .y = (const double(*)[3])w->y,
                                 .right = (const double(*)[3])w->right,
                                 .ratio = (const double(*)[2])w->ratio,
                                 .use = w->use,
                                 .group = w->group,
                                 .n = n,
                                 .n_groups = 1,
                                 .normal_sigma = cfg->normal_sigma,
                                 .cut_m = cfg->inlier_m};
    const double *g = cfg->ground_normal;
    double sign = g[0] * w->up[0] + g[1] * w->up[1] + g[2] * w->up[2] < 0 ? -1 : 1;
    double m[9] = {0}, values[3], vectors[9];
    for (int a = 0; a < 3; a++) {
        w->p.normal[a] = sign * g[a];
        for (int b = 0; b < 3; b++)
            for (size_t i = 0; i < n; i++)
                m[3 * a + b] += photos[i].rot[a] * photos[i].rot[b] / (double)n;
    }
    sim3_eigen(m, 3, values, vectors);
    w->p.level_sigma = sqrt(fmax(0, values[0]));
    return ERR_OK;
}

/* Sum of squared distances, each capped. */
static double georef_truncated_cost(const struct work *w, const struct sim3_fit *f, double cap)
{
    double sum = 0;
    struct sim3_fit plain = *f;
    plain.sigma_v_m = 0; /* heights count fully, however uncertain */
    for (size_t k = 0; k < w->n_gps; k++) {
        double r = sim3_residual(&w->p, &plain, w->with_gps[k]);
        sum += fmin(r * r, cap * cap);
    }
    return sum;
}

static size_t georef_count_within(const struct work *w, const struct sim3_fit *f, double r)
{
    size_t n = 0;
    for (size_t k = 0; k < w->n_gps; k++)
        n += sim3_residual(&w->p, f, w->with_gps[k]) <= r;
    return n;
}

/* Sum of squared horizontal residuals, each cut at cap, and how many are within it. */
static double georef_plan_cost(const struct work *w, const struct sim3 *s, double cap,
                               size_t *within)
{
    double sum = 0;
    *within = 0;
    for (size_t k = 0; k < w->n_gps; k++) {
        double at[3], r;
        sim3_apply(s, w->x[w->with_gps[k]], at);
        r = hypot(w->y[w->with_gps[k]][0] - at[0], w->y[w->with_gps[k]][1] - at[1]);
        sum += fmin(r * r, cap * cap);
        *within += r <= cap;
    }
    return sum;
}

/* Draws needed to meet `k` agreeing photographs at once, almost surely. */
static double georef_draws_needed(double share, int k)
{
    double miss = log1p(-fmin(pow(share, k), 1 - 1e-9));
    return miss < 0 ? log(1e-6) / miss : DRAWS_MAX;
}

/* The best of many fits to two photographs, up taken from the cameras and the ground, heights
 * ignored. */
static bool georef_draw_plans(const struct work *w, struct sim3_fit *best)
{
    double best_cost = HUGE_VAL, needed = DRAWS_MAX;
    for (uint64_t draw = 0; draw < DRAWS_MAX && (draw < DRAWS_MIN || (double)draw < needed);
         draw++) {
        uint32_t pick[2];
        size_t within;
        for (uint64_t k = 0; k < 2; k++)
            pick[k] = w->with_gps[rng_u64(w->cfg->seed, draw, 8 + k) % w->n_gps];
        struct sim3 s;
        if (pick[0] == pick[1] || !sim3_from_plan(w->p.x, w->p.y, pick, 2, w->up, w->scratch, &s))
            continue;
        double cost = georef_plan_cost(w, &s, w->cfg->inlier_m, &within);
        if (!(cost < best_cost))
            continue;
        best_cost = cost;
        *best = (struct sim3_fit){.sim = s};
        needed = georef_draws_needed((double)within / (double)w->n_gps, 2);
    }
    if (!(best_cost < HUGE_VAL))
        return false;
    for (size_t k = 0; k < w->n_gps; k++) {
        double at[3];
        sim3_apply(&best->sim, w->x[w->with_gps[k]], at);
        w->scratch[k] = w->y[w->with_gps[k]][2] - at[2];
    }
    best->sim.trans[2] += sort_median(w->scratch, w->n_gps);
    return true;
}

/* The best of many fits to three photographs. */
static bool georef_draw_fits(const struct work *w, struct sim3_fit *best)
{
    double best_cost = HUGE_VAL, needed = DRAWS_MAX;
    for (uint64_t draw = 0; draw < DRAWS_MAX && (draw < DRAWS_MIN || (double)draw < needed);
         draw++) {
        uint32_t pick[3];
        for (uint64_t k = 0; k < 3; k++)
            pick[k] = w->with_gps[rng_u64(w->cfg->seed, draw, k) % w->n_gps];
        if (pick[0] == pick[1] || pick[1] == pick[2] || pick[0] == pick[2])
            continue;
        struct sim3_fit f = {0};
        if (!sim3_from_pairs(w->p.x, w->p.y, pick, 3, w->up, &f.sim))
            continue;
        double cost = georef_truncated_cost(w, &f, w->cfg->inlier_m);
        if (!(cost < best_cost))
            continue;
        best_cost = cost;
        *best = f;
        needed = georef_draws_needed(
            (double)georef_count_within(w, &f, w->cfg->inlier_m) / (double)w->n_gps, 3);
    }
    return best_cost < HUGE_VAL;
}

/* ---- flights ---- */

static double georef_height_error(const struct work *w, const struct sim3_fit *f, size_t i)
{
    double y[3];
    sim3_apply(&f->sim, w->x[i], y);
    return w->y[i][2] - y[2];
}

/* Number the flights of `trial` by size, largest first; false when one is too small or there is
 * only one. */
static bool georef_flights_rank(struct work *w, size_t *n_groups)
{
    size_t count[SIM3_GROUPS_MAX] = {0}, rank[SIM3_GROUPS_MAX], n = 0;
    for (size_t k = 0; k < w->n_gps; k++)
        count[w->trial[w->with_gps[k]]]++;
    for (size_t g = 0; g < SIM3_GROUPS_MAX; g++) {
        if (count[g] && count[g] < FLIGHT_MIN)
            return false;
        n += count[g] > 0;
        rank[g] = 0;
        for (size_t h = 0; h < SIM3_GROUPS_MAX; h++)
            rank[g] += count[h] > count[g] || (count[h] == count[g] && h < g);
    }
    for (size_t i = 0; i < w->n; i++)
        w->trial[i] = rank[w->trial[i]] < n ? (uint32_t)rank[w->trial[i]]
                                            : 0; /* flights without GPS join the first */
    *n_groups = n;
    return n > 1;
}

/* Median height error of up to JUMP_WINDOW photographs before or from with_gps[at]. */
static double georef_window_height(struct work *w, const struct sim3_fit *f, size_t at, bool after)
{
    size_t lo = after ? at : at > JUMP_WINDOW ? at - JUMP_WINDOW : 0;
    size_t hi = after ? at + JUMP_WINDOW : at, n = 0;
    for (size_t k = lo; k < hi && k < w->n_gps; k++)
        w->scratch[n++] = georef_height_error(w, f, w->with_gps[k]);
    return sort_median(w->scratch, n);
}

/* Residual sum of squares of v[0..n) about its best parabola; *steps gets that about two levels
 * that meet at `at`. Values are in order of names. */
static double georef_parabola_cost(const double *v, size_t n, size_t at, double *steps)
{
    double moment[5] = {0}, b[3] = {0}, square = 0, sum[2] = {0};
    for (size_t k = 0; k < n; k++) {
        double t = 2 * ((double)k + 0.5) / (double)n - 1, power = 1;
        for (int a = 0; a < 5; a++, power *= t) {
            moment[a] += power;
            if (a < 3)
                b[a] += power * v[k];
        }
        square += v[k] * v[k];
        sum[k >= at] += v[k];
    }
    *steps = square - (at ? sum[0] * sum[0] / (double)at : 0) -
             (at < n ? sum[1] * sum[1] / (double)(n - at) : 0);
    /* Odd moments vanish by symmetry, so the linear term stands alone. */
    double det = moment[0] * moment[4] - moment[2] * moment[2];
    if (n < 4 || !(det > 0))
        return *steps;
    double c0 = (moment[4] * b[0] - moment[2] * b[2]) / det,
           c2 = (moment[0] * b[2] - moment[2] * b[0]) / det;
    return square - b[1] * b[1] / moment[2] - c0 * b[0] - c2 * b[2];
}

/* Are the two flights of `trial` told apart as their kind of partition demands? */
static bool georef_flights_distinct(struct work *w, const struct sim3_fit *f, enum partition how)
{
    double offset = f->offset_m[1];
    if (how == PARTITION_JUMP) {
        size_t at = 1;
        while (at < w->n_gps && w->trial[w->with_gps[at]] == w->trial[w->with_gps[at - 1]])
            at++;
        if (fabs(georef_window_height(w, f, at, true) - georef_window_height(w, f, at, false)) <=
            jump_sudden * fabs(offset))
            return false;
        double cap = fabs(offset) + 4 * f->sigma_v_m, steps; /* outliers count little */
        for (size_t k = 0; k < w->n_gps; k++)
            w->scratch[k] =
                fmax(-cap, fmin(cap, georef_height_error(w, f, w->with_gps[k]) - 0.5 * offset));
        double smooth = georef_parabola_cost(w->scratch, w->n_gps, at, &steps);
        return steps < jump_better * smooth;
    }
    if (how == PARTITION_CLUSTER) {
        size_t changes = 0;
        for (size_t k = 1; k < w->n_gps; k++)
            changes += w->trial[w->with_gps[k]] != w->trial[w->with_gps[k - 1]];
        return (double)changes > cluster_changes * (double)w->n_gps;
    }
    return true;
}

/* Fit with the flights of `trial`; take fit and flights when they explain the positions much better
 * than `single`, which has no flights, and better than `best`. */
static enum err_code georef_flights_try(struct work *w, const struct sim3_fit *single,
                                        enum partition how, struct sim3_fit *best, struct err *e)
{
    double better_cost = how == PARTITION_CLUSTER ? better_in_clusters : better_in_order;
    size_t n_groups;
    if (w->n_gps < FLIGHTS_PHOTOS_MIN || !georef_flights_rank(w, &n_groups))
        return ERR_OK;
    struct sim3_fit f = *single;
    double base = 0;
    size_t count[SIM3_GROUPS_MAX];
    for (size_t g = 0; g < n_groups; g++) {
        count[g] = 0;
        for (size_t k = 0; k < w->n_gps; k++)
            if (w->trial[w->with_gps[k]] == g)
                w->scratch[count[g]++] = georef_height_error(w, single, w->with_gps[k]);
        double median = sort_median(w->scratch, count[g]);
        if (g == 0)
            base = median;
        f.offset_m[g] = median - base;
    }
    f.sim.trans[2] += base;
    struct sim3_problem old = w->p;
    w->p.group = w->trial;
    w->p.n_groups = n_groups;
    enum err_code rc = sim3_refine(&w->p, &f, NULL);
    if (rc == ERR_MEM)
        return err_set(e, rc, "georeferencing: out of memory");
    double cap = 4.6 * fmax(f.sigma_h_m, f.sigma_v_m), cost = georef_truncated_cost(w, &f, cap),
           largest = 0;
    w->p = old;
    bool better = cost < georef_truncated_cost(w, best, cap) &&
                  cost < better_cost * georef_truncated_cost(w, single, cap);
    for (size_t g = 1; g < n_groups; g++) {
        double error = f.sigma_v_m * sqrt(1 / (double)count[0] + 1 / (double)count[g]);
        if (fabs(f.offset_m[g]) > offset_sigmas * error)
            largest = fmax(largest, fabs(f.offset_m[g]));
    }
    if (rc || largest < offset_min_m || !better || !georef_flights_distinct(w, &f, how))
        return ERR_OK;
    *best = f;
    memcpy(w->group, w->trial, w->n * sizeof *w->group);
    w->p.n_groups = n_groups;
    return ERR_OK;
}

/* Flights before and from place `at` in the order of names; *jump = at when that is the best so
 * far. */
static enum err_code georef_jump_try(struct work *w, const struct sim3_fit *single,
                                     struct sim3_fit *best, size_t at, size_t *jump, struct err *e)
{
    double before = best->offset_m[1], sigma = best->sigma_v_m;
    for (size_t i = 0; i < w->n; i++)
        w->trial[i] = i >= at;
    enum err_code rc = georef_flights_try(w, single, PARTITION_JUMP, best, e);
    if (before != best->offset_m[1] || sigma != best->sigma_v_m)
        *jump = at;
    return rc;
}

static enum err_code georef_flights_find(struct work *w, const struct georef_photo *photos,
                                         struct sim3_fit *fit, struct err *e)
{
    enum err_code rc = ERR_OK;
    const struct sim3_fit single = *fit;
    for (size_t i = 0; i < w->n; i++)
        w->trial[i] =
            photos[i].flight_hint < SIM3_GROUPS_MAX ? photos[i].flight_hint : SIM3_GROUPS_MAX - 1;
    rc = georef_flights_try(w, &single, PARTITION_PAUSE, fit, e);
    if (rc || w->p.n_groups > 1)
        return rc;
    /* A jump somewhere along the order of names, then two clusters in any order. */
    struct sim3_fit best = single;
    size_t step = w->n / JUMPS_TRIED + 1;
    size_t jump = 0;
    for (size_t at = FLIGHT_MIN; !rc && at + FLIGHT_MIN <= w->n; at += step)
        rc = georef_jump_try(w, &single, &best, at, &jump, e);
    for (size_t at = jump > step ? jump - step + 1 : 1, end = jump + step; !rc && jump && at < end;
         at++)
        rc = georef_jump_try(w, &single, &best, at, &jump, e);
    for (size_t k = 0; k < w->n_gps; k++)
        w->scratch[k] = georef_height_error(w, &single, w->with_gps[k]);
    sort_median(w->scratch, w->n_gps); /* sorts */
    double split = 0.5 * (w->scratch[w->n_gps / 8] + w->scratch[w->n_gps - 1 - w->n_gps / 8]);
    for (size_t i = 0; i < w->n; i++)
        w->trial[i] = photos[i].has_gps && georef_height_error(w, &single, i) > split;
    if (!rc && w->p.n_groups == 1)
        rc = georef_flights_try(w, &single, PARTITION_CLUSTER, &best, e);
    *fit = best;
    return rc;
}

/* ---- dropping ---- */

static double georef_rejection_distance(struct work *w, const struct sim3_fit *f)
{
    for (size_t k = 0; k < w->n_gps; k++)
        w->scratch[k] = sim3_residual(&w->p, f, w->with_gps[k]);
    double median = sort_median(w->scratch, w->n_gps);
    for (size_t k = 0; k < w->n_gps; k++)
        w->scratch[k] = fabs(sim3_residual(&w->p, f, w->with_gps[k]) - median);
    double tau = median + 5 * 1.4826 * sort_median(w->scratch, w->n_gps);
    return fmin(fmax(tau, tau_min_m), tau_max_m);
}

static enum err_code georef_drop_rounds(struct work *w, struct sim3_fit *f, struct georef_result *r,
                                        struct err *e)
{
    enum err_code rc = ERR_OK;
    for (r->rounds = 0; r->rounds < ROUNDS_MAX && !rc;) {
        size_t changed = 0, kept = 0;
        r->rounds++;
        r->tau_m = georef_rejection_distance(w, f);
        for (size_t k = 0; k < w->n_gps; k++) {
            size_t i = w->with_gps[k];
            bool far = !(sim3_residual(&w->p, f, i) <= r->tau_m);
            changed += far != r->dropped[i];
            r->dropped[i] = far;
            w->use[i] = !far;
            kept += !far;
        }
        if (kept < 3)
            return err_set(
                e, ERR_DATA,
                "only %zu of %zu GPS positions agree within %.1f m: they do not fit the COLMAP "
                "model",
                kept, w->n_gps, r->tau_m);
        if (!changed)
            break;
        rc = sim3_refine(&w->p, f, e);
    }
    return rc;
}

/* Is the largest spread of the cameras a hundred times the second? */
static bool georef_is_collinear(const struct work *w)
{
    double mean[3] = {0}, m[9] = {0}, values[3], vectors[9];
    for (size_t k = 0; k < w->n_gps; k++)
        for (int a = 0; a < 3; a++)
            mean[a] += w->x[w->with_gps[k]][a] / (double)w->n_gps;
    for (size_t k = 0; k < w->n_gps; k++) {
        const double *x = w->x[w->with_gps[k]];
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++)
                m[3 * a + b] += (x[a] - mean[a]) * (x[b] - mean[b]);
    }
    sim3_eigen(m, 3, values, vectors);
    return sqrt(fmax(0, values[1])) < collinear_ratio * sqrt(fmax(0, values[2]));
}

/* Two starts: three-dimensional, and level with heights ignored. The likelier end is taken. */
static enum err_code georef_first_fit(struct work *w, struct sim3_fit *out, struct err *e)
{
    struct sim3_fit space = {0}, plan = {0};
    enum err_code rc_space = ERR_DATA, rc_plan = ERR_DATA;
    if (georef_draw_fits(w, &space))
        rc_space = sim3_refine(&w->p, &space, e);
    if (georef_draw_plans(w, &plan))
        rc_plan = sim3_refine(&w->p, &plan, e);
    if (rc_space == ERR_MEM || rc_plan == ERR_MEM)
        return err_set(e, ERR_MEM, "georeferencing: out of memory for %zu photographs", w->n);
    if (rc_space != ERR_OK && rc_plan != ERR_OK)
        return err_set(e, ERR_DATA,
                       "the photographs all stand at one place, in the COLMAP model or by GPS");
    bool level = rc_plan == ERR_OK && (rc_space != ERR_OK || plan.objective < space.objective);
    *out = level ? plan : space;
    log_debug("georef",
              "starts space=%.1f plan=%.1f sigma_h_m=%.2f sigma_v_m=%.2f share_h=%.3f share_v=%.3f",
              space.objective, plan.objective, out->sigma_h_m, out->sigma_v_m, out->share_h,
              out->share_v);
    return ERR_OK;
}

static enum err_code georef_fit_all(struct work *w, const struct georef_photo *photos,
                                    struct georef_result *r, struct err *e)
{
    struct sim3_fit f = {0};
    if (w->n_gps < 3)
        return err_set(e, ERR_DATA,
                       "%zu photographs have a GPS position, three at least are needed", w->n_gps);
    enum err_code rc = georef_first_fit(w, &f, e);
    if (!rc)
        rc = georef_flights_find(w, photos, &f, e);
    if (!rc)
        rc = georef_drop_rounds(w, &f, r, e);
    if (rc)
        return rc;
    r->fit = f;
    r->sim = f.sim;
    r->n_gps = w->n_gps;
    r->n_flights = w->p.n_groups;
    r->collinear = georef_is_collinear(w);
    memcpy(r->flight_offset_m, f.offset_m, sizeof r->flight_offset_m);
    for (size_t i = 0; i < w->n; i++) {
        r->residual_m[i] = photos[i].has_gps ? sim3_residual(&w->p, &f, i) : (double)NAN;
        r->flight[i] = w->group[i];
        r->n_dropped += r->dropped[i];
    }
    return ERR_OK;
}

enum err_code georef_fit(const struct georef_photo *photos, size_t n,
                         const struct georef_config *cfg, struct georef_result *out, struct err *e)
{
    struct work w;
    struct georef_result r = {0};
    enum err_code rc = georef_work_make(&w, photos, n, cfg, e);
    if (rc)
        goto out;
    r.residual_m = mem_array(n, sizeof *r.residual_m);
    r.dropped = mem_array(n, sizeof *r.dropped);
    r.flight = mem_array(n, sizeof *r.flight);
    if (!r.residual_m || !r.dropped || !r.flight) {
        rc = err_set(e, ERR_MEM, "georeferencing: out of memory for %zu photographs", n);
        goto out;
    }
    rc = georef_fit_all(&w, photos, &r, e);
out:
    georef_work_free(&w);
    if (rc)
        georef_free(&r);
    *out = r;
    return rc;
}
