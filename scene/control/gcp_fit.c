/* Fits to ground control points: see gcp_fit.h.
 *
 * A first fit is robust (gcp_solve.c) and finds suspects. These are points that it does not use,
 * and points whose place by all others differs by more than survey and marks explain. The user
 * decides what happens to suspects. Limits are in standard deviations of each point, from its
 * survey, its marks and the frame. A point within a pixel on the ground is never a suspect.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_fit.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/sort.h"

static const double line_share = 1e-3;  /* second to first principal variance: on a line below */
static const double upright_most = 0.7; /* upward part of a line about which up says nothing */
static const double level_sigma = 0.05; /* radians that level ground may be off */
/* Three axes of a normal error are beyond this once in 6000 points. */
static const double point_sigmas = 4.5;
static const double contradict_factor = 3;

void gcp_fit_free(struct gcp_fit *f)
{
    mem_free(f->points);
    gcp_places_free(&f->at);
    *f = (struct gcp_fit){0};
}

struct fit_work {
    const struct gcp_fit_config *cfg;
    const double *up;
    double (*y)[3];  /* [list.n] surveyed, in the frame */
    uint32_t *index; /* [n] points of the ties */
    struct gcp_tie *ties;
    size_t n;
    struct gcp_solution s;
};

static enum err_code fit_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "out of memory for ground control points");
}

/* ---- the frame ---- */

static double gcp_fit_height(const struct gcp_fit_config *cfg, const struct gcp *g)
{
    double sea = cfg->geoid ? geoid_above(cfg->geoid, g->at[0], g->at[1]) : 0;
    return g->at[2] + cfg->height_offset_m + (isfinite(sea) ? sea : 0);
}

/* The middle one of each coordinate: one wrong point does not turn the frame. */
static enum err_code fit_frame(struct gcp_fit *f, const struct gcp_fit_config *cfg, struct err *e)
{
    size_t n = f->list->n;
    double *v = mem_array(n, sizeof *v), lon0 = f->list->gcps[0].at[0], at[3];
    if (!v)
        return fit_no_memory(e);
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = 0; i < n; i++) {
            const struct gcp *p = &f->list->gcps[i];
            v[i] = k == 0   ? remainder(p->at[0] - lon0, 360)
                   : k == 1 ? p->at[1]
                            : gcp_fit_height(cfg, p);
        }
        at[k] = sort_median(v, n);
    }
    f->frame = (struct geo_origin){remainder(lon0 + at[0], 360), at[1], at[2]};
    mem_free(v);
    return ERR_OK;
}

static enum err_code fit_survey(const struct gcp_fit *f, struct fit_work *w, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < f->list->n; i++) {
        const struct gcp *p = &f->list->gcps[i];
        double h = gcp_fit_height(w->cfg, p);
        rc = geo_to_enu(&f->frame, p->at[0], p->at[1], h, w->y[i], e);
    }
    return rc;
}

static void fit_tie(const struct gcp_fit *f, const struct fit_work *w, size_t i, struct gcp_tie *t)
{
    const struct gcp *g = &f->list->gcps[i];
    const struct gcp_place *p = &f->at.places[i];
    *t = (struct gcp_tie){.weight = 0};
    memcpy(t->x, p->x, sizeof t->x);
    memcpy(t->cov, p->cov, sizeof t->cov);
    memcpy(t->y, w->y[i], sizeof t->y);
    for (size_t k = 0; k < 2; k++) {
        double sigma = g->sigma_m[k] > 0 ? g->sigma_m[k] : w->cfg->sigma_m;
        t->var_m[k] = sigma * sigma;
    }
}

/* Control points that take part: without suspects, if they are to be left out. */
static void fit_ties(const struct gcp_fit *f, struct fit_work *w, bool drop)
{
    w->n = 0;
    for (size_t i = 0; i < f->list->n; i++) {
        if (!f->at.places[i].n_photos || f->list->gcps[i].check || f->points[i].far ||
            (drop && f->points[i].suspect))
            continue;
        fit_tie(f, w, i, &w->ties[w->n]);
        w->index[w->n++] = (uint32_t)i;
    }
}

/* Three points that are not on a line fix everything. Of two, or of more on a line, the survey
 * could turn about that line: then the ground that the sparse points make out says what is
 * level. */
static enum err_code fit_check_line(struct gcp_fit *f, const struct fit_work *w, struct err *e)
{
    double mean[3] = {0}, cov[9] = {0}, values[3], vectors[9];
    bool known_up = w->up[0] != 0 || w->up[1] != 0 || w->up[2] != 0;
    if (w->n < 2)
        return err_set(e, ERR_DATA,
                       "%zu of %zu ground control points to fit to %s marked in photographs that "
                       "were kept: at least 2 are needed, better 5; are the photographs named as "
                       "in the list?%s",
                       w->n, f->list->n, w->n == 1 ? "is" : "are",
                       f->n_check ? " Or keep fewer out by --check" : "");
    for (size_t i = 0; i < w->n; i++)
        for (size_t k = 0; k < 3; k++)
            mean[k] += w->ties[i].y[k] / (double)w->n;
    for (size_t i = 0; i < w->n; i++)
        for (size_t r = 0; r < 3; r++)
            for (size_t k = 0; k < 3; k++)
                cov[3 * r + k] += (w->ties[i].y[r] - mean[r]) * (w->ties[i].y[k] - mean[k]);
    sim3_eigen(cov, 3, values, vectors);
    f->level_by_points = !(values[1] > line_share * values[2]);
    if (f->level_by_points && (!known_up || fabs(vectors[8]) > upright_most))
        return err_set(e, ERR_DATA,
                       "the %zu ground control points lie on a line, and the sparse points make "
                       "out no level ground: give a point beside that line",
                       w->n);
    return ERR_OK;
}

static enum err_code fit_solve(struct gcp_fit *f, struct fit_work *w, bool robust, struct err *e)
{
    bool fixed = false;
    enum err_code rc = gcp_solve(w->ties, w->n, w->up, f->level_by_points ? level_sigma : 0, robust,
                                 &w->s, &fixed, e);
    if (!rc && !fixed)
        rc = err_set(e, ERR_DATA,
                     "the ground control points do not fit the poses at any scale: are "
                     "they marked in the right photographs?");
    f->sim = w->s.sim;
    f->redundancy = (int)(3 * w->n) - 7 + f->level_by_points;
    return rc;
}

/* ---- who is a suspect ---- */

/* Beyond its errors, and beyond a pixel on the ground. */
static bool fit_is_off(const struct gcp_point *p, double sigmas, const double r[3])
{
    return sigmas > point_sigmas && (hypot(r[0], r[1]) > p->gsd_m || fabs(r[2]) > p->gsd_m);
}

static void fit_suspect_control(struct gcp_fit *f, const struct fit_work *w)
{
    for (size_t k = 0; k < w->n; k++) {
        struct gcp_point *p = &f->points[w->index[k]];
        struct gcp_left left;
        double r[3], cov[9];
        gcp_solve_leave_out(&w->s, &w->ties[k], &left);
        gcp_solve_residual(&w->s.sim, &w->ties[k], r, cov);
        if (isfinite(left.sigmas))
            p->suspect = fit_is_off(p, left.sigmas, left.residual_m);
        p->suspect = p->suspect || (w->ties[k].weight == 0 &&
                                    fit_is_off(p, gcp_solve_sigmas(r, cov) / w->s.factor, r));
    }
    f->contradict = w->s.factor > contradict_factor;
}

/* Points that are no ties: how they lie under the solution. */
static void fit_judge_other(struct gcp_fit *f, const struct fit_work *w, size_t i)
{
    struct gcp_point *p = &f->points[i];
    struct gcp_tie t;
    double own[9], cov[9], at[3];
    fit_tie(f, w, i, &t);
    gcp_solve_residual(&w->s.sim, &t, p->left.residual_m, own);
    sim3_apply(&w->s.sim, t.x, at);
    gcp_solve_error(&w->s, at, cov);
    for (size_t k = 0; k < 9; k++)
        cov[k] = f->factor * f->factor * (cov[k] + own[k]);
    p->left.sigma_m[0] = sqrt(0.5 * (cov[0] + cov[4]));
    p->left.sigma_m[1] = sqrt(cov[8]);
    p->left.sigmas = gcp_solve_sigmas(p->left.residual_m, cov);
    p->suspect =
        p->suspect || f->points[i].far || fit_is_off(p, p->left.sigmas, p->left.residual_m);
}

/* Sum of squares over redundancy, where that is more than chance explains: 99 in 100 are below the
 * limit (Wilson and Hilferty 1931). */
static double fit_factor(const struct fit_work *w, int redundancy)
{
    double sum = 0, q = redundancy > 0 ? 2.0 / 9 / redundancy : 0, off = 0;
    for (size_t k = 0; k < w->n; k++) {
        double r[3], cov[9];
        gcp_solve_residual(&w->s.sim, &w->ties[k], r, cov);
        double d = gcp_solve_sigmas(r, cov);
        sum += w->ties[k].weight * d * d;
        off += 3 * (1 - w->ties[k].weight);
    }
    double left = redundancy - off;
    return left > 0 && sum / left > pow(1 - q + 2.326 * sqrt(q), 3) ? sqrt(sum / left) : 1;
}

/* How far the located points go, at most, by a turn. */
static double fit_influence(const struct gcp_fit *f, const struct fit_work *w, const double turn[7])
{
    double most = 0, at[3], d[3];
    for (size_t i = 0; i < f->list->n; i++) {
        if (!f->at.places[i].n_photos)
            continue;
        sim3_apply(&w->s.sim, f->at.places[i].x, at);
        gcp_solve_move(&w->s, turn, at, d);
        most = fmax(most, sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]));
    }
    return most;
}

/* Residuals, and what leaving out says, of all points under the final solution. */
static void fit_judge(struct gcp_fit *f, struct fit_work *w)
{
    f->factor = fit_factor(w, f->redundancy);
    w->s.factor = f->factor;
    for (size_t i = 0; i < f->list->n; i++) {
        struct gcp_point *p = &f->points[i];
        p->weight = 0;
        p->influence_m = (double)NAN;
        if (f->at.places[i].n_photos)
            fit_judge_other(f, w, i);
    }
    for (size_t k = 0; k < w->n; k++) {
        struct gcp_point *p = &f->points[w->index[k]];
        p->weight = w->ties[k].weight;
        gcp_solve_leave_out(&w->s, &w->ties[k], &p->left);
        if (isfinite(p->left.sigmas))
            p->influence_m = fit_influence(f, w, p->left.turn);
    }
    for (size_t i = 0; i < f->list->n; i++) {
        double at[3];
        sim3_apply(&w->s.sim, f->at.places[i].x, at);
        for (size_t k = 0; k < 3; k++)
            f->points[i].residual_m[k] = at[k] - w->y[i][k];
    }
}

/* ---- what is told ---- */

/* Control points that do not count are no control points. */
static bool fit_counts(const struct gcp_fit *f, size_t i)
{
    const struct gcp_point *p = &f->points[i];
    return f->at.places[i].n_photos > 0 && !p->far && (f->list->gcps[i].check || p->weight > 0);
}

static void fit_rmse(struct gcp_fit *f)
{
    double sum[2][2] = {{0}}, expected[2] = {0};
    size_t n[2] = {0};
    for (size_t i = 0; i < f->list->n; i++) {
        const struct gcp_point *p = &f->points[i];
        bool check = f->list->gcps[i].check;
        if (!fit_counts(f, i))
            continue;
        n[check]++;
        sum[check][0] += p->residual_m[0] * p->residual_m[0] + p->residual_m[1] * p->residual_m[1];
        sum[check][1] += p->residual_m[2] * p->residual_m[2];
        for (size_t k = 0; check && k < 2; k++)
            expected[k] += (k ? 1 : 2) * p->left.sigma_m[k] * p->left.sigma_m[k];
    }
    f->n_control = n[0];
    f->n_check = n[1];
    for (size_t k = 0; k < 2; k++) {
        bool known = n[0] && 3 * (int)n[0] - 7 + f->level_by_points > 0;
        f->control_m[k] = known ? sqrt(sum[0][k] / (double)n[0]) : (double)NAN;
        f->check_m[k] = n[1] ? sqrt(sum[1][k] / (double)n[1]) : (double)NAN;
        f->check_expected_m[k] = n[1] ? sqrt(expected[k] / (double)n[1]) : (double)NAN;
    }
}

/* Predicted error of the frame: root mean square over the points. */
static void fit_frame_error(struct gcp_fit *f, const struct fit_work *w)
{
    double sum[2] = {0}, cov[9], at[3];
    size_t n = 0;
    for (size_t i = 0; i < f->list->n; i++) {
        if (!fit_counts(f, i))
            continue;
        sim3_apply(&w->s.sim, f->at.places[i].x, at);
        gcp_solve_error(&w->s, at, cov);
        sum[0] += cov[0] + cov[4];
        sum[1] += cov[8];
        n++;
    }
    for (size_t k = 0; k < 2; k++)
        f->frame_m[k] = n ? f->factor * sqrt(sum[k] / (double)n) : (double)NAN;
}

static void fit_count(struct gcp_fit *f)
{
    f->n_suspects = f->n_mark_suspects = 0;
    for (size_t i = 0; i < f->list->n; i++)
        f->n_suspects += f->points[i].suspect;
    for (size_t k = 0; k < f->at.n_sights; k++)
        f->n_mark_suspects += f->at.sights[k].suspect;
}

/* ---- the whole ---- */

static enum err_code fit_open(struct gcp_fit *f, struct fit_work *w, const struct gcp_list *list,
                              struct err *e)
{
    f->list = list;
    f->points = mem_array(list->n, sizeof *f->points);
    w->y = mem_array(list->n, sizeof *w->y);
    w->index = mem_array(list->n, sizeof *w->index);
    w->ties = mem_array(list->n, sizeof *w->ties);
    return f->points && w->y && w->index && w->ties ? ERR_OK : fit_no_memory(e);
}

static void fit_close(struct fit_work *w)
{
    mem_free(w->y);
    mem_free(w->index);
    mem_free(w->ties);
}

static enum err_code fit_points(struct gcp_fit *f, struct fit_work *w, struct err *e)
{
    const struct gcp_fit_config *cfg = w->cfg;
    fit_ties(f, w, false);
    for (size_t i = 0; i < f->list->n; i++)
        f->n_check += f->list->gcps[i].check && f->at.places[i].n_photos > 0;
    enum err_code rc = fit_check_line(f, w, e);
    if (!rc)
        rc = fit_solve(f, w, true, e);
    if (rc)
        return rc;
    for (size_t i = 0; i < f->list->n; i++)
        f->points[i].gsd_m = f->at.places[i].depth * f->sim.scale;
    fit_suspect_control(f, w);
    if (cfg->suspects == GCP_DROP)
        fit_ties(f, w, true);
    if (cfg->suspects != GCP_REWEIGH) {
        rc = fit_check_line(f, w, e);
        if (!rc)
            rc = fit_solve(f, w, false, e);
    }
    if (rc)
        return rc;
    fit_judge(f, w);
    fit_rmse(f);
    fit_frame_error(f, w);
    fit_count(f);
    return ERR_OK;
}

enum err_code gcp_fit_make(const struct gcp_list *list, const struct colmap_model *m,
                           const struct gcp_view *views, size_t n_views,
                           const struct gcp_fit_config *cfg, const double up[3],
                           struct gcp_fit *out, struct err *e)
{
    struct gcp_fit f = {0};
    struct fit_work w = {.cfg = cfg, .up = up};
    enum err_code rc = fit_open(&f, &w, list, e);
    if (!rc)
        rc = fit_frame(&f, cfg, e);
    if (!rc)
        rc = fit_survey(&f, &w, e);
    if (!rc)
        rc = gcp_locate(list, m, views, n_views, cfg->px_scale, cfg->mark_px, up,
                        cfg->suspects == GCP_KEEP, HUGE_VAL, &f.at, e);
    if (!rc && cfg->gps_check)
        rc = gcp_blame_far(&f, views, n_views, e);
    if (!rc)
        rc = fit_points(&f, &w, e);
    if (!rc)
        rc = gcp_blame_suspects(&f, (const double(*)[3])w.y, e);
    if (!rc && cfg->gps_check)
        rc = gcp_blame_gps(&f, views, n_views, e);
    fit_close(&w);
    if (rc)
        gcp_fit_free(&f);
    *out = f;
    return rc;
}
