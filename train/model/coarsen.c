/* A coarser level from the model of the finer one.
 *
 * Rows of a model lie along a Morton curve, so a part of them is a region. Each part is merged on
 * its own, in place: what is left of it is written behind what is left of the parts before. So the
 * bytes depend on the rows alone, and memory is walked through once.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/model/coarsen.h"

#include <math.h>

#include "core/splat/gauss.h"
#include "lod/make/simplify.h"
#include "scene/cells/cell.h"
#include "train/model/model.h"

enum { COARSEN_FIELDS = 6, COARSEN_SIDES = 2 };

struct coarsen_side { /* inside the cell, or outside */
    size_t n, target; /* Gaussians before, and to be left */
    size_t passed;    /* of them, so far */
};
struct coarsen {
    const struct model *m;
    const struct cell *cell;
    float *params; /* of the model, mapped */
    size_t n_parts;
    size_t written; /* rows */
    struct coarsen_side side[COARSEN_SIDES];
};

size_t coarsen_inside(const struct coarsen_rule *r, size_t n)
{
    double left = floor(r->share * (double)n + 0.5);
    size_t most = r->budget < n ? r->budget : n;
    return left < (double)most ? (size_t)fmax(left, n > 0 ? 1.0 : 0.0) : most;
}

size_t coarsen_outside(const struct coarsen_rule *r, size_t n)
{
    size_t kept = n < r->around ? n : r->around;
    return kept + (size_t)floor(r->share * (double)(n - kept) + 0.5);
}

/* One row of a container, from the model or into it: the planes of the layout in their order. */
static void coarsen_row(const struct coarsen *c, size_t row, struct gauss *g, size_t at, bool reads)
{
    const struct render_model *m = &c->m->gauss;
    float *p = c->params + layout_at(row, m->planes);
    const size_t n_sh = 3 * gauss_sh_count(m->sh_degree);
    const struct {
        float *values;
        size_t count;
    } fields[COARSEN_FIELDS] = {
        {g->mean_m, 3},        {g->scale_log, 3}, {g->quat_wxyz, 4},
        {g->opacity_logit, 1}, {g->sh, n_sh},     {g->embed, m->embed_len},
    };
    for (size_t f = 0; f < COARSEN_FIELDS; f++)
        for (size_t k = 0; k < fields[f].count; k++, p += LAYOUT_LANES) {
            float *v = &fields[f].values[fields[f].count * at + k];
            if (reads)
                *v = *p;
            else
                *p = *v;
        }
}

static bool coarsen_is_inside(const struct coarsen *c, size_t row)
{
    const struct render_model *m = &c->m->gauss;
    const float *mean = c->params + layout_at(row, m->planes);
    return cell_distance(c->cell, m->origin_enu_m[0] + (double)mean[0],
                         m->origin_enu_m[1] + (double)mean[LAYOUT_LANES]) <= 0.0;
}

/* How many of the next n of a side are left: each part has its share of the target, and at least
 * one. */
static size_t coarsen_target(const struct coarsen *c, struct coarsen_side *s, size_t n)
{
    double spread = s->target > c->n_parts ? (double)(s->target - c->n_parts) : 0.0;
    double before = floor(spread * (double)s->passed / (double)s->n);
    s->passed += n;
    return 1 + (size_t)(floor(spread * (double)s->passed / (double)s->n) - before);
}

static enum err_code coarsen_write(struct coarsen *c, const struct coarsen_side *s,
                                   struct gauss *of, size_t target, struct err *e)
{
    struct gauss left = {0};
    const bool merges = s->target < s->n && target < of->n;
    enum err_code rc = merges ? simplify_gauss(of, target, &left, e) : ERR_OK;
    struct gauss *from = merges ? &left : of;
    for (size_t i = 0; !rc && i < from->n; i++)
        coarsen_row(c, c->written++, from, i, false);
    gauss_free(&left);
    return rc;
}

/* Rows [first, end). */
static enum err_code coarsen_part(struct coarsen *c, size_t first, size_t end, struct err *e)
{
    const struct render_model *m = &c->m->gauss;
    struct gauss of[COARSEN_SIDES] = {{0}};
    size_t n[COARSEN_SIDES] = {0};
    enum err_code rc = ERR_OK;
    for (size_t i = first; i < end; i++)
        n[!coarsen_is_inside(c, i)]++;
    for (size_t k = 0; !rc && k < COARSEN_SIDES; k++)
        rc = gauss_alloc(&of[k], n[k], m->sh_degree, m->embed_len, e);
    for (size_t i = first; !rc && i < end; i++) {
        struct gauss *g = &of[!coarsen_is_inside(c, i)];
        coarsen_row(c, i, g, g->n++, true);
    }
    for (size_t k = 0; !rc && k < COARSEN_SIDES; k++)
        if (n[k])
            rc = coarsen_write(c, &c->side[k], &of[k], coarsen_target(c, &c->side[k], n[k]), e);
    for (size_t k = 0; k < COARSEN_SIDES; k++)
        gauss_free(&of[k]);
    return rc;
}

enum err_code coarsen_model(struct model *m, const struct coarsen_rule *r, struct err *e)
{
    struct coarsen c = {.m = m, .cell = r->cell};
    struct err why = {0};
    void *params = NULL;
    const size_t n = m->gauss.n;
    enum err_code rc = model_count_inside(m, r->cell, &c.side[0].n, e);
    c.side[1].n = n - c.side[0].n;
    c.side[0].target = coarsen_inside(r, c.side[0].n);
    c.side[1].target = coarsen_outside(r, c.side[1].n);
    c.n_parts = (n + COARSEN_ROWS - 1) / COARSEN_ROWS;
    if (!rc)
        rc = dev_map(m->dev, m->gauss.params, CL_MAP_READ | CL_MAP_WRITE, model_bytes(m), &params,
                     e);
    if (rc)
        return rc;
    c.params = params;
    for (size_t k = 0, first = 0; !rc && k < c.n_parts; k++) {
        size_t end = (k + 1) * n / c.n_parts;
        rc = coarsen_part(&c, first, end, e);
        first = end;
    }
    enum err_code done = dev_unmap(m->dev, m->gauss.params, &params, &why);
    if (!rc && done)
        rc = err_set(e, done, "%s", why.msg);
    return rc ? rc : model_keep(m, c.written, e);
}
