/* Harmonics of least size that look the same from the photographs: the normal equations of a
 * Gaussian, 16 by 16, by Cholesky.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/harmonics.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/camera.h"
#include "core/cholesky.h"
#include "core/layout.h"
#include "core/pool.h"
#include "core/simd.h"
#include "render/render_ref.h"
#include "train/model.h"

enum {
    HARMONICS_ROWS = 1024, /* that a thread takes at a time */
    HARMONICS_CHANNELS = 3,
    HARMONICS_WIDE = 4 /* doubles of a vector */
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

struct harmonics_fit { /* of one Gaussian */
    size_t count;      /* coefficients */
    double a[LAYOUT_SH_MAX][LAYOUT_SH_MAX];
};

/* Sum of Y Y^T over the photographs that see it; their number. */
SIMD_INLINE size_t harmonics_gather(const struct harmonics_work *w, const double x[3],
                                    struct harmonics_fit *f)
{
    size_t seen = 0;
    memset(f->a, 0, sizeof f->a);
    for (size_t k = 0; k < w->rule->n_cams; k++) {
        double dir[3], y[LAYOUT_SH_MAX], length2 = 0.0;
        if (!camera_frames(&w->rule->cams[k], x, HARMONICS_NEAR_M, NULL))
            continue;
        for (int i = 0; i < 3; i++) {
            dir[i] = x[i] - w->center[k][i];
            length2 += dir[i] * dir[i];
        }
        for (int i = 0; i < 3; i++)
            dir[i] /= sqrt(length2);
        ref_sh_basis(dir, w->rule->degree, y);
        for (size_t i = 0; i < LAYOUT_SH_MAX; i++) /* y is 0 beyond its degree */
            for (size_t block = 0; block <= i / HARMONICS_WIDE; block++)
                for (size_t j = 0; j < HARMONICS_WIDE; j++)
                    f->a[i][HARMONICS_WIDE * block + j] += y[i] * y[HARMONICS_WIDE * block + j];
        seen++;
    }
    for (size_t i = 0; i < f->count; i++)
        for (size_t j = 0; j < i; j++)
            f->a[j][i] = f->a[i][j];
    return seen;
}

/* What the photographs see of c0: the right side of the normal equations. */
SIMD_INLINE void harmonics_seen(const struct harmonics_fit *f,
                                double c0[LAYOUT_SH_MAX][CHOLESKY_SIDES],
                                double out[LAYOUT_SH_MAX][CHOLESKY_SIDES])
{
    memset(out, 0, LAYOUT_SH_MAX * sizeof *out);
    for (size_t i = 0; i < f->count; i++)
        for (size_t j = 0; j < f->count; j++)
            for (size_t ch = 0; ch < CHOLESKY_SIDES; ch++)
                out[i][ch] += f->a[i][j] * c0[j][ch];
}

static float *harmonics_at(float *row, size_t i, size_t channel)
{
    return row + (LAYOUT_PLANE_SH + HARMONICS_CHANNELS * i + channel) * LAYOUT_LANES;
}

SIMD_WIDE static void harmonics_row(const struct harmonics_work *w, float *row)
{
    struct harmonics_fit f = {.count = (size_t)(w->rule->degree + 1) * (w->rule->degree + 1)};
    /* a side of the equations is a channel; the last is not used */
    double x[3], c[LAYOUT_SH_MAX][CHOLESKY_SIDES] = {{0}}, b[LAYOUT_SH_MAX][CHOLESKY_SIDES];
    for (size_t k = 0; k < 3; k++)
        x[k] = w->origin_enu_m[k] + (double)row[(LAYOUT_PLANE_MEAN + k) * LAYOUT_LANES];
    size_t seen = harmonics_gather(w, x, &f);
    for (size_t i = 0; i < f.count; i++)
        for (size_t ch = 0; ch < HARMONICS_CHANNELS; ch++)
            c[i][ch] = (double)*harmonics_at(row, i, ch);
    harmonics_seen(&f, c, b);
    for (size_t i = 1; i < f.count; i++)
        f.a[i][i] += w->rule->weight * (double)seen;
    if (seen && !cholesky_factor(&f.a[0][0], f.count, LAYOUT_SH_MAX))
        return; /* not finite: left as it is */
    if (seen)
        cholesky_solve_sides(&f.a[0][0], f.count, LAYOUT_SH_MAX, b);
    for (size_t i = seen ? 0 : 1; i < f.count; i++)
        for (size_t ch = 0; ch < HARMONICS_CHANNELS; ch++)
            *harmonics_at(row, i, ch) = (float)b[i][ch]; /* nobody saw it: b is 0 */
}

static enum err_code harmonics_rows(void *user, size_t part, struct err *e)
{
    const struct harmonics_work *w = user;
    size_t end = (part + 1) * HARMONICS_ROWS;
    (void)e;
    for (size_t i = part * HARMONICS_ROWS; i < w->n && i < end; i++)
        harmonics_row(w, w->params + layout_at(i, w->planes));
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
        for (size_t i = 0, n; !rc && i < g->n; i += n) {
            n = g->n - i < MODEL_PART ? g->n - i : MODEL_PART;
            rc = harmonics_hold(r, (float *)params + layout_at(i, g->planes), n, g->planes,
                                g->origin_enu_m, e);
            model_walked(m, false, i, i + n);
        }
        enum err_code done = dev_unmap(m->dev, g->params, &params, &why);
        if (!rc && done)
            rc = err_set(e, done, "%s", why.msg);
    }
    return rc;
}
