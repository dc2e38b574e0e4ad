/* See defer.h. The table of what is owed is kept in double on the host, and its rows go to the
 * device before they are used. The bounds of a step's groups are made anew when the next step
 * begins: until then the device works and the host does not wait.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/defer.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "render/frame.h"

extern const char adam_cl[], defer_cl[];

enum {
    DEFER_HORIZON = 256, /* steps after which c^t, 2e-12 there, is nothing */
    DEFER_ROWS_FIRST = 1024
};
#define DEFER_DRIFT_ROOM 1.05 /* drift is a bound: roundings, and rates that grow a little */

struct defer {
    struct render *r; /* borrowed */
    cl_program program;
    cl_kernel count, list, settle, bound;
    cl_mem view, counts;
    /* -- of the groups -- */
    bool known; /* settled, and with `bounded` also bounds, are those of the model */
    bool bounded;
    bool still; /* none is owed any, and bounds are those of the model: for defer_look */
    uint32_t n; /* Gaussians that are known */
    struct frame_buffer settled, bounds, listed;
    /* -- the groups that are listed -- */
    bool pending; /* their last step is not in settled and bounds yet */
    uint32_t n_listed, step;
    /* -- the table: row i is of step base + i -- */
    uint32_t base;
    float *rows;                /* [cap][LAYOUT_DEFER_ROW] */
    double *sums;               /* [cap][LAYOUT_DEFER_RATES] */
    size_t n_rows, cap, n_sent; /* n_sent: rows that the device has and that do not change */
    struct frame_buffer table;
};

void defer_close(struct defer **p)
{
    struct defer *d = *p;
    if (!d)
        return;
    cl_kernel kernels[] = {d->count, d->list, d->settle, d->bound};
    for (size_t i = 0; i < sizeof kernels / sizeof *kernels; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (d->program)
        clReleaseProgram(d->program);
    dev_release(&d->view);
    dev_release(&d->counts);
    dev_release(&d->settled.mem);
    dev_release(&d->bounds.mem);
    dev_release(&d->listed.mem);
    dev_release(&d->table.mem);
    mem_free(d->rows);
    mem_free(d->sums);
    mem_free(d);
    *p = NULL;
}

enum err_code defer_open(struct render *r, struct defer **out, struct err *e)
{
    const struct dev_source sources[] = {
        FRAME_SOURCES, {"render/adam.cl", adam_cl}, {"render/defer.cl", defer_cl}};
    struct defer *d = *out = mem_array(1, sizeof *d);
    if (!d)
        return err_set(e, ERR_MEM, "deferred steps: out of memory");
    d->r = r;
    enum err_code rc =
        dev_build(r->dev, sources, sizeof sources / sizeof *sources, NULL, &d->program, e);
    if (!rc)
        rc = dev_kernel(d->program, "defer_count", &d->count, e);
    if (!rc)
        rc = dev_kernel(d->program, "defer_list", &d->list, e);
    if (!rc)
        rc = dev_kernel(d->program, "defer_settle", &d->settle, e);
    if (!rc)
        rc = dev_kernel(d->program, "defer_bound", &d->bound, e);
    if (!rc)
        rc = dev_buffer(r->dev, sizeof(struct layout_view), NULL, &d->view, e);
    if (!rc)
        rc = dev_buffer(r->dev, (LAYOUT_DEFER_CHUNKS + 1) * sizeof(uint32_t), NULL, &d->counts, e);
    if (rc)
        defer_close(out);
    return rc;
}

/* ---- the table ---- */

/* Learning rates over both bias corrections of a step; 0 at step 0, which is none. */
static void defer_rates(const struct render_adam *a, double out[LAYOUT_DEFER_RATES])
{
    const float lr[LAYOUT_DEFER_RATES] = {a->lr_mean,    a->lr_scale, a->lr_quat,
                                          a->lr_opacity, a->lr_sh_dc, a->lr_sh_rest};
    double bias1 = 1.0 - pow((double)a->beta1, a->step);
    double bias2 = 1.0 - pow((double)a->beta2, a->step);
    for (size_t i = 0; i < LAYOUT_DEFER_RATES; i++)
        out[i] = a->step ? (double)lr[i] * sqrt(bias2) / bias1 : 0.0;
}

/* c: what is left of m1 / sqrt(m2) after a step without gradient. */
static double defer_left(const struct render_adam *a)
{
    return (double)a->beta1 / sqrt((double)a->beta2);
}

/* Sum of c^j over the steps to come, in units of this step's rate: the second bias correction lets
 * rates grow. */
static double defer_drift(const struct render_adam *a)
{
    double c = defer_left(a), b2 = (double)a->beta2, now = 1.0 - pow(b2, a->step), sum = 0.0;
    double left = 1.0, power = 1.0 - now;
    for (int j = 1; a->step && j <= DEFER_HORIZON; j++) {
        left *= c;
        power *= b2;
        sum += left * sqrt((1.0 - power) / now);
    }
    return DEFER_DRIFT_ROOM * sum;
}

static enum err_code defer_grow(struct defer *d, struct err *e)
{
    size_t cap = d->cap ? 2 * d->cap : DEFER_ROWS_FIRST;
    float *rows = mem_array(cap, LAYOUT_DEFER_ROW * sizeof *rows);
    double *sums = mem_array(cap, LAYOUT_DEFER_RATES * sizeof *sums);
    if (!rows || !sums) {
        mem_free(rows);
        mem_free(sums);
        return err_set(e, ERR_MEM, "deferred steps: out of memory for %zu steps", cap);
    }
    if (d->n_rows) {
        memcpy(rows, d->rows, d->n_rows * LAYOUT_DEFER_ROW * sizeof *rows);
        memcpy(sums, d->sums, d->n_rows * LAYOUT_DEFER_RATES * sizeof *sums);
    }
    mem_free(d->rows);
    mem_free(d->sums);
    d->rows = rows;
    d->sums = sums;
    d->cap = cap;
    return ERR_OK;
}

/* The next row, and what this step adds to those before. */
static enum err_code defer_add_row(struct defer *d, const struct render_adam *a, struct err *e)
{
    double rate[LAYOUT_DEFER_RATES], c = defer_left(a), left = 1.0, drift = defer_drift(a);
    size_t k = d->n_rows, from = k > DEFER_HORIZON ? k - DEFER_HORIZON : 0;
    enum err_code rc = k == d->cap ? defer_grow(d, e) : ERR_OK;
    if (rc)
        return rc;
    assert(a->step == d->base + k);
    defer_rates(a, rate);
    for (size_t row = k; row-- > from;) {
        left *= c;
        for (size_t i = 0; i < LAYOUT_DEFER_RATES; i++) {
            double *sum = &d->sums[row * LAYOUT_DEFER_RATES + i];
            *sum += rate[i] * left;
            d->rows[row * LAYOUT_DEFER_ROW + i] = (float)*sum;
        }
    }
    float *out = d->rows + k * LAYOUT_DEFER_ROW;
    memset(out, 0, LAYOUT_DEFER_ROW * sizeof *out);
    memset(d->sums + k * LAYOUT_DEFER_RATES, 0, LAYOUT_DEFER_RATES * sizeof *d->sums);
    out[LAYOUT_DEFER_DRIFT] = (float)(drift * rate[LAYOUT_DEFER_MEAN]);
    out[LAYOUT_DEFER_DRIFT + 1] = (float)(drift * rate[LAYOUT_DEFER_SCALE]);
    out[LAYOUT_DEFER_DRIFT + 2] = (float)(drift * rate[LAYOUT_DEFER_OPACITY]);
    out[LAYOUT_DEFER_DECAY] = (float)pow((double)a->beta1, (double)k);
    out[LAYOUT_DEFER_DECAY + 1] = (float)pow((double)a->beta2, (double)k);
    d->n_rows = k + 1;
    d->n_sent = d->n_sent < from ? d->n_sent : from;
    return ERR_OK;
}

/* The device gets the rows that it does not have. */
static enum err_code defer_send(struct defer *d, struct err *e)
{
    const size_t row = LAYOUT_DEFER_ROW * sizeof(float);
    size_t had = d->table.cap_bytes;
    enum err_code rc = frame_reserve(d->r, &d->table, d->cap * row, e);
    if (!rc && d->table.cap_bytes != had)
        d->n_sent = 0; /* a new buffer may lie where the old one was */
    if (!rc && d->n_sent < d->n_rows)
        rc = dev_write(d->r->dev, d->table.mem, d->n_sent * row, (d->n_rows - d->n_sent) * row,
                       d->rows + d->n_sent * LAYOUT_DEFER_ROW, e);
    d->n_sent = d->n_rows;
    return rc;
}

/* ---- the kernels ---- */

static enum err_code defer_reserve(struct defer *d, const struct render_model *m, struct err *e)
{
    size_t groups = layout_floats(m->n, 1) / LAYOUT_LANES,
           vectors = layout_floats(groups, LAYOUT_DEFER_BOUND);
    enum err_code rc = frame_reserve(d->r, &d->settled, groups * sizeof(uint32_t), e);
    if (!rc)
        rc = frame_reserve(d->r, &d->listed, groups * sizeof(uint32_t), e);
    if (!rc)
        rc = frame_reserve(d->r, &d->bounds, vectors * sizeof(float), e);
    return rc ? err_add(e, "deferred steps of %u Gaussians", m->n) : ERR_OK;
}

/* Groups of the list, or [from, end) of all. */
struct defer_range {
    cl_uint listed, from, end;
};

/* Their bounds. step: they have just made it. */
static enum err_code defer_run_bound(struct defer *d, const struct render_model *m,
                                     const struct render_adam *a, struct defer_range g,
                                     cl_uint step, struct err *e)
{
    size_t local, items = frame_items(d->r, g.end - g.from, &local);
    if (d->r->dev->vector_width == 1)
        items = (g.end - g.from + local - 1) / local * local;
    return frame_run(d->r, d->bound, "defer_bound",
                     FRAME_ARGS(FRAME_ARG(d->listed.mem), FRAME_ARG(g.listed), FRAME_ARG(g.from),
                                FRAME_ARG(g.end), FRAME_ARG(m->n), FRAME_ARG(m->planes),
                                FRAME_ARG(step), FRAME_ARG(d->base), FRAME_ARG(a->eps),
                                FRAME_ARG(d->table.mem), FRAME_ARG(m->params),
                                FRAME_ARG(a->moments), FRAME_ARG(d->settled.mem),
                                FRAME_ARG(d->bounds.mem)),
                     items, local, e);
}

static enum err_code defer_run_settle(struct defer *d, const struct render_model *m,
                                      const struct render_adam *a, struct defer_range g,
                                      struct err *e)
{
    size_t local, items = frame_items(d->r, g.end - g.from, &local);
    return frame_run(d->r, d->settle, "defer_settle",
                     FRAME_ARGS(FRAME_ARG(d->listed.mem), FRAME_ARG(g.listed), FRAME_ARG(g.from),
                                FRAME_ARG(g.end), FRAME_ARG(m->n), FRAME_ARG(m->planes),
                                FRAME_ARG(a->step), FRAME_ARG(d->base), FRAME_ARG(a->eps),
                                FRAME_ARG(a->scale_log_min), FRAME_ARG(a->scale_log_max),
                                FRAME_ARG(d->settled.mem), FRAME_ARG(d->table.mem),
                                FRAME_ARG(m->params), FRAME_ARG(a->moments)),
                     items, local, e);
}

/* settled and bounds as they are after the last step. */
static enum err_code defer_catch_up(struct defer *d, const struct render_model *m,
                                    const struct render_adam *a, struct err *e)
{
    enum err_code rc = defer_send(d, e);
    if (!rc && !d->bounded)
        rc = defer_run_bound(d, m, a, (struct defer_range){false, 0, m->groups}, 0, e);
    d->bounded = true;
    if (!rc && d->pending)
        rc = defer_run_bound(d, m, a, (struct defer_range){true, 0, d->n_listed}, d->step, e);
    d->pending = false;
    return rc;
}

/* All groups have made adam->step: of that they are known from now on. */
static enum err_code defer_begin(struct defer *d, const struct render_model *m,
                                 const struct render_adam *a, struct err *e)
{
    enum err_code rc = defer_reserve(d, m, e);
    size_t groups = m->groups;
    if (rc)
        return rc;
    uint32_t *settled = mem_array(groups, sizeof *settled);
    if (!settled)
        return err_set(e, ERR_MEM, "deferred steps: out of memory for %u Gaussians", m->n);
    for (size_t i = 0; i < groups; i++)
        settled[i] = a->step;
    rc = dev_write(d->r->dev, d->settled.mem, 0, groups * sizeof *settled, settled, e);
    mem_free(settled);
    d->n = m->n;
    d->base = a->step;
    d->n_rows = d->n_sent = 0;
    d->pending = d->bounded = d->still = false;
    if (!rc)
        rc = defer_add_row(d, a, e);
    d->known = !rc;
    return rc;
}

/* ---- a step ---- */

/* Groups that the view may show: their number, and whether the last of all is one of them. */
static enum err_code defer_find(struct defer *d, const struct render_model *m,
                                const struct camera *cam, const struct render_options *o,
                                bool *has_last, struct err *e)
{
    struct layout_view view;
    uint32_t counts[LAYOUT_DEFER_CHUNKS + 1], groups = m->groups;
    size_t local = dev_local(d->r->dev);
    render_view_fill(d->r, m, cam, o, &view);
    enum err_code rc = dev_write(d->r->dev, d->view, 0, sizeof view, &view, e);
    if (!rc)
        rc = frame_run(d->r, d->count, "defer_count",
                       FRAME_ARGS(FRAME_ARG(d->view), FRAME_ARG(d->bounds.mem), FRAME_ARG(groups),
                                  FRAME_ARG(d->counts)),
                       LAYOUT_DEFER_CHUNKS, local, e);
    if (!rc)
        rc = frame_run(d->r, d->list, "defer_list",
                       FRAME_ARGS(FRAME_ARG(d->view), FRAME_ARG(d->bounds.mem), FRAME_ARG(groups),
                                  FRAME_ARG(d->counts), FRAME_ARG(d->listed.mem)),
                       LAYOUT_DEFER_CHUNKS, local, e);
    if (!rc)
        rc = dev_read(d->r->dev, d->counts, 0, sizeof counts, counts, e);
    if (rc)
        return rc;
    d->n_listed = 0;
    for (size_t i = 0; i < LAYOUT_DEFER_CHUNKS; i++)
        d->n_listed += counts[i];
    *has_last = counts[LAYOUT_DEFER_CHUNKS] != 0;
    return ERR_OK;
}

/* Of a copy of the model, the groups that were found. */
static void defer_show(const struct defer *d, bool has_last, struct render_model *seen)
{
    const uint32_t empty = seen->groups * LAYOUT_LANES - seen->n; /* lanes of the last group */
    seen->list = d->listed.mem;
    seen->groups = d->n_listed;
    seen->n = d->n_listed * LAYOUT_LANES - (has_last ? empty : 0);
}

enum err_code defer_see(struct defer *d, const struct render_model *m,
                        const struct render_adam *adam, const struct camera *cam,
                        const struct render_options *o, struct render_model *seen, struct err *e)
{
    bool has_last = false;
    enum err_code rc = d->known ? ERR_OK : defer_begin(d, m, adam, e);
    *seen = *m;
    if (rc || !m->groups)
        return rc;
    assert(m->n == d->n && !m->list && !m->embed_len);
    rc = defer_catch_up(d, m, adam, e);
    if (!rc)
        rc = defer_find(d, m, cam, o, &has_last, e);
    if (!rc)
        rc = defer_run_settle(d, m, adam, (struct defer_range){true, 0, d->n_listed}, e);
    d->pending = !rc;
    d->step = adam->step;
    seen->settled = d->settled.mem;
    seen->owed = d->table.mem;
    defer_show(d, has_last, seen);
    return rc;
}

/* All have made adam->step, and keep still from now on. */
static enum err_code defer_keep_still(struct defer *d, const struct render_model *m,
                                      const struct render_adam *adam, struct err *e)
{
    enum err_code rc = defer_begin(d, m, adam, e);
    if (!rc)
        rc = defer_catch_up(d, m, adam, e);
    d->known = false;
    d->still = !rc;
    return rc;
}

enum err_code defer_look(struct defer *d, const struct render_model *m,
                         const struct render_adam *adam, const struct camera *cam,
                         const struct render_options *o, struct render_model *seen, struct err *e)
{
    bool has_last = false;
    enum err_code rc = ERR_OK;
    *seen = *m;
    if (!m->groups)
        return ERR_OK;
    assert(!d->known && !m->list && !m->embed_len);
    if (!d->still || m->n > d->n)
        rc = defer_keep_still(d, m, adam, e);
    if (!rc)
        rc = defer_find(d, m, cam, o, &has_last, e);
    defer_show(d, has_last, seen);
    return rc;
}

enum err_code defer_stepped(struct defer *d, const struct render_adam *adam, struct err *e)
{
    d->step = adam->step;
    return defer_add_row(d, adam, e);
}

enum err_code defer_settle(struct defer *d, const struct render_model *m,
                           const struct render_adam *adam, struct err *e)
{
    if (!d->known || !m->groups)
        return ERR_OK;
    assert(m->n == d->n);
    enum err_code rc = defer_catch_up(d, m, adam, e);
    if (!rc)
        rc = defer_run_settle(d, m, adam, (struct defer_range){false, 0, m->groups}, e);
    d->known = d->still = false;
    return rc;
}

void defer_moved(struct defer *d)
{
    d->still = false;
}

bool defer_owes(const struct defer *d)
{
    return d && d->known;
}

/* ---- states ---- */

enum err_code defer_save(struct defer *d, const struct render_model *m,
                         const struct render_adam *adam, cl_mem *out, struct err *e)
{
    enum err_code rc = defer_catch_up(d, m, adam, e);
    *out = d->settled.mem;
    return rc;
}

enum err_code defer_restore(struct defer *d, const struct render_model *m, const uint32_t *settled,
                            uint32_t *first, struct err *e)
{
    enum err_code rc = defer_reserve(d, m, e);
    if (!rc)
        rc = dev_write(d->r->dev, d->settled.mem, 0, m->groups * sizeof *settled, settled, e);
    *first = m->groups ? settled[0] : 0;
    for (size_t i = 1; i < m->groups; i++)
        *first = settled[i] < *first ? settled[i] : *first;
    d->n = m->n;
    d->base = *first;
    d->n_rows = d->n_sent = 0;
    d->pending = d->bounded = d->still = false;
    d->known = !rc;
    return rc;
}
