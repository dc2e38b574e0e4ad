/* Harmonics of least size that look the same from the photographs: the normal equations of a
 * Gaussian, 16 by 16, by Cholesky.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/model/harmonics.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "core/math/cholesky.h"
#include "core/math/simd.h"
#include "core/pool.h"
#include "core/splat/camera.h"
#include "core/splat/sh.h"
#include "train/model/model.h"

enum {
    HARMONICS_ROWS = 1024, /* that a thread takes at a time */
    HARMONICS_CHANNELS = 3
};
#define HARMONICS_NEAR_M 1e-6

struct harmonics_work {
    const struct harmonics_rule *rule;
    double (*center)[3]; /* [n_cams] of projection */
    float *params;
    size_t n;
    uint32_t planes;
    const double *origin_enu_m;
};

enum { HARMONICS_LANES = CHOLESKY_LANES }; /* Gaussians side by side */
static_assert((int)HARMONICS_ROWS % (int)LAYOUT_LANES == 0 &&
                  (int)LAYOUT_LANES % (int)HARMONICS_LANES == 0 &&
                  (int)CHOLESKY_RIGHT == (int)HARMONICS_CHANNELS &&
                  (int)CHOLESKY_LANES_N == (int)LAYOUT_SH_MAX,
              "a group is whole vectors, a channel is a right side");

struct harmonics_fit { /* of some Gaussians */
    size_t count;      /* coefficients */
    double x[3][HARMONICS_LANES];
    double a[LAYOUT_SH_MAX][LAYOUT_SH_MAX][HARMONICS_LANES]; /* the lower triangle */
    double seen[HARMONICS_LANES];                            /* photographs that see it */
};

/* 1 where a photograph shows the place, as camera_frames says; false: nowhere. */
SIMD_INLINE bool harmonics_framed(const struct camera *c, const struct harmonics_fit *f,
                                  double in[HARMONICS_LANES])
{
    double t[3][HARMONICS_LANES], any = 0.0;
    for (int i = 0; i < 3; i++)
        for (size_t l = 0; l < HARMONICS_LANES; l++)
            t[i][l] = c->rot[3 * i] * f->x[0][l] + c->rot[3 * i + 1] * f->x[1][l] +
                      c->rot[3 * i + 2] * f->x[2][l] + c->trans[i];
    for (size_t l = 0; l < HARMONICS_LANES; l++) {
        double u = c->fx_px * t[0][l] / t[2][l] + c->cx_px,
               v = c->fy_px * t[1][l] / t[2][l] + c->cy_px;
        const int is = (t[2][l] > HARMONICS_NEAR_M) & (u >= 0.0) & (v >= 0.0) & (u < c->width_px) &
                       (v < c->height_px);
        in[l] = is ? 1.0 : 0.0;
    }
    for (size_t l = 0; l < HARMONICS_LANES; l++)
        any += in[l];
    return any > 0.0;
}

/* Sum of Y Y^T over the photographs that see it; their number. */
SIMD_INLINE void harmonics_gather(const struct harmonics_work *w, struct harmonics_fit *f)
{
    memset(f->a, 0, sizeof f->a);
    memset(f->seen, 0, sizeof f->seen);
    for (size_t k = 0; k < w->rule->n_cams; k++) {
        double in[HARMONICS_LANES], dir[3][HARMONICS_LANES],
            length2[HARMONICS_LANES] = {0}, y[LAYOUT_SH_MAX][HARMONICS_LANES] = {{0}};
        if (!harmonics_framed(&w->rule->cams[k], f, in))
            continue;
        for (int i = 0; i < 3; i++)
            for (size_t l = 0; l < HARMONICS_LANES; l++) {
                dir[i][l] = f->x[i][l] - w->center[k][i];
                length2[l] += dir[i][l] * dir[i][l];
            }
        for (int i = 0; i < 3; i++)
            for (size_t l = 0; l < HARMONICS_LANES; l++)
                dir[i][l] /= sqrt(length2[l]);
        for (size_t l = 0; l < HARMONICS_LANES; l++) {
            double own[LAYOUT_SH_MAX];
            if (!(in[l] > 0.0))
                continue;
            sh_basis((const double[3]){dir[0][l], dir[1][l], dir[2][l]}, w->rule->degree, own);
            for (size_t i = 0; i < f->count; i++)
                y[i][l] = own[i];
        }
        for (size_t i = 0; i < f->count; i++)
            for (size_t j = 0; j <= i; j++)
                for (size_t l = 0; l < HARMONICS_LANES; l++)
                    f->a[i][j][l] += y[i][l] * y[j][l];
        for (size_t l = 0; l < HARMONICS_LANES; l++)
            f->seen[l] += in[l];
    }
}

/* What the photographs see of c0: the right side of the normal equations. */
SIMD_INLINE void harmonics_seen(const struct harmonics_fit *f,
                                double c0[LAYOUT_SH_MAX][HARMONICS_CHANNELS][HARMONICS_LANES],
                                double out[LAYOUT_SH_MAX][HARMONICS_CHANNELS][HARMONICS_LANES])
{
    memset(out, 0, LAYOUT_SH_MAX * sizeof *out);
    for (size_t i = 0; i < f->count; i++)
        for (size_t j = 0; j < f->count; j++)
            for (size_t ch = 0; ch < HARMONICS_CHANNELS; ch++)
                for (size_t l = 0; l < HARMONICS_LANES; l++)
                    out[i][ch][l] += f->a[i > j ? i : j][i > j ? j : i][l] * c0[j][ch][l];
}

static float *harmonics_at(float *row, size_t i, size_t channel)
{
    return row + (LAYOUT_PLANE_SH + HARMONICS_CHANNELS * i + channel) * LAYOUT_LANES;
}

/* Gaussians side by side from `row` on, `n` of which are there; the others repeat the first. */
SIMD_WIDE static void harmonics_some(const struct harmonics_work *w, float *row, size_t n)
{
    struct harmonics_fit f = {.count = (size_t)(w->rule->degree + 1) * (w->rule->degree + 1)};
    double c[LAYOUT_SH_MAX][HARMONICS_CHANNELS][HARMONICS_LANES],
        b[LAYOUT_SH_MAX][HARMONICS_CHANNELS][HARMONICS_LANES],
        unsolved[LAYOUT_SH_MAX][HARMONICS_CHANNELS][HARMONICS_LANES];
    bool ok[HARMONICS_LANES];
    for (size_t l = 0; l < HARMONICS_LANES; l++) {
        const size_t at = l < n ? l : 0;
        for (size_t k = 0; k < 3; k++)
            f.x[k][l] =
                w->origin_enu_m[k] + (double)row[(LAYOUT_PLANE_MEAN + k) * LAYOUT_LANES + at];
        for (size_t i = 0; i < f.count; i++)
            for (size_t ch = 0; ch < HARMONICS_CHANNELS; ch++)
                c[i][ch][l] = (double)harmonics_at(row, i, ch)[at];
    }
    harmonics_gather(w, &f);
    harmonics_seen(&f, c, b);
    memcpy(unsolved, b, sizeof b);
    for (size_t i = 1; i < f.count; i++)
        for (size_t l = 0; l < HARMONICS_LANES; l++)
            f.a[i][i][l] += w->rule->weight * f.seen[l];
    cholesky_factor_lanes(f.a[0], f.count, LAYOUT_SH_MAX, ok);
    cholesky_solve_lanes(f.a[0], f.count, LAYOUT_SH_MAX, b);
    for (size_t l = 0; l < n; l++) {
        const bool seen = f.seen[l] > 0.0;
        if (seen && !ok[l])
            continue; /* not finite: left as it is */
        for (size_t i = seen ? 0 : 1; i < f.count; i++)
            for (size_t ch = 0; ch < HARMONICS_CHANNELS; ch++) /* nobody saw it: they are 0 */
                harmonics_at(row, i, ch)[l] = (float)(seen ? b : unsolved)[i][ch][l];
    }
}

static enum err_code harmonics_rows(void *user, size_t part, struct err *e)
{
    const struct harmonics_work *w = user;
    size_t end = (part + 1) * HARMONICS_ROWS;
    (void)e;
    end = end < w->n ? end : w->n;
    for (size_t i = part * HARMONICS_ROWS; i < end; i += HARMONICS_LANES)
        harmonics_some(w, w->params + layout_at(i, w->planes),
                       end - i < HARMONICS_LANES ? end - i : HARMONICS_LANES);
    return ERR_OK;
}

enum err_code harmonics_hold(const struct harmonics_rule *r, float *params, size_t n,
                             uint32_t planes, const double origin_enu_m[3], struct err *e)
{
    struct harmonics_work w = {.rule = r, .n = n, .planes = planes, .origin_enu_m = origin_enu_m};
    w.params = params;
    if (!r->degree || !n)
        return ERR_OK;
    w.center = mem_array(r->n_cams, sizeof *w.center);
    if (!w.center)
        return err_set(e, ERR_MEM, "harmonics: out of memory for %zu photographs", r->n_cams);
    for (size_t k = 0; k < r->n_cams; k++)
        camera_center(&r->cams[k], w.center[k]);
    enum err_code rc =
        pool_for((n + HARMONICS_ROWS - 1) / HARMONICS_ROWS, 0, harmonics_rows, &w, e);
    mem_free(w.center);
    return rc;
}

enum err_code harmonics_level(struct model *m, const struct harmonics_rule *r, struct err *e)
{
    const struct render_model *g = &m->gauss;
    struct err why = {0};
    void *params = NULL;
    enum err_code rc =
        dev_map(m->dev, g->params, CL_MAP_READ | CL_MAP_WRITE, model_bytes(m), &params, e);
    if (!rc) {
        rc = harmonics_hold(r, params, g->n, g->planes, g->origin_enu_m, e);
        enum err_code done = dev_unmap(m->dev, g->params, &params, &why);
        if (!rc && done)
            rc = err_set(e, done, "%s", why.msg);
    }
    return rc;
}
