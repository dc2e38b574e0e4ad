/* Density control of the current level: applies the plan of densify_plan.c to the Gaussians on the
 * device.
 *
 * Parameters are read where they are; on CPU devices the host sees the same memory. Rows are moved
 * array by array. Beyond the model this needs a few numbers a Gaussian, and one more array when the
 * arrays have to grow.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/density/densify_apply.h"

#include <math.h>
#include <string.h>

#include <jansson.h>

#include "core/layout.h"
#include "scene/cells/footprint.h"
#include "scene/cells/trim.h"
#include "train/base/config.h"
#include "train/base/metrics_log.h"
#include "train/base/stage.h"
#include "train/base/timing.h"
#include "train/density/importance.h"
#include "train/model/appearance_train.h"
#include "train/model/densify_plan.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"

#define DENSIFY_TAU_OUTSIDE 4.0     /* of the threshold, at one cell edge outside; REUrbanGS */
#define DENSIFY_PRUNE_OPACITY 0.005 /* 3DGS */
#define DENSIFY_PRUNE_SIZE 0.1      /* in camera extents of the scene; 3DGS */
#define DENSIFY_SHARE_MIN 1e-3 /* of the Gaussians; see docs/decisions/011-density-control.md */
#define DENSIFY_SHARE_MAX 0.98
/* Spacings of the budget's Gaussians, laid out on a grid over the cell: what is smaller than this
 * is never removed for its size. Below about one spacing the ground cannot be covered, and then
 * every removal makes the others grow until they are removed too. */
#define DENSIFY_SPACINGS 4.0

/* What sticks out of the photographs is split down to one such spacing, or so many of the least
 * sizes that tiles cut. */
#define DENSIFY_CUT_SPACINGS 1.0
#define DENSIFY_CUT_LEAST 2.5
enum { DENSIFY_SORT_EVERY = 4 };

struct densify_work {
    void *params; /* mapped */
    float *mean_grad, *score, *opacity;
    struct densify_plan plan;
    struct densify_order order;
};

/* Forget what the choice was made by. */
static void densify_free_input(struct densify_work *c)
{
    mem_free(c->mean_grad);
    mem_free(c->score);
    mem_free(c->opacity);
    c->mean_grad = c->score = c->opacity = NULL;
}

/* A Gaussian that shows under the light of some photographs only must not go for being faint by
 * itself: the limit is for the largest opacity it was drawn with since the last densification. */
static enum err_code densify_opacity(const struct model *m, const struct densify_run *r,
                                     struct densify_work *c, const float *count,
                                     struct densify_params *p, struct err *e)
{
    const float *params = c->params;
    const struct appearance_train *a = r->gallery->appearance;
    if (!appearance_train_is_on(a) ||
        r->at->step <= appearance_train_warmup(a, r->gallery->cfg, stage_schedule(r->at)))
        return ERR_OK;
    c->opacity = mem_array(m->gauss.n, sizeof(float));
    if (!c->opacity)
        return err_set(e, ERR_MEM, "densify: out of memory for %u Gaussians", m->gauss.n);
    p->prune_opacity += APPEARANCE_TRAIN_OFFSET_IDLE;
    enum err_code rc =
        dev_read(m->dev, m->stats.opacity, 0, m->gauss.n * sizeof(float), c->opacity, e);
    for (size_t i = 0; !rc && i < m->gauss.n; i++) {
        float own =
            params[layout_at(i, m->gauss.planes) + (size_t)LAYOUT_PLANE_OPACITY * LAYOUT_LANES];
        if (!(count[i] > 0.0f)) /* not seen: nothing was added to its own */
            c->opacity[i] = 1.0f / (1.0f + expf(-own)) + (float)APPEARANCE_TRAIN_OFFSET_IDLE;
    }
    return rc;
}

/* Mean gradients and opacities since the last time. */
static enum err_code densify_count(const struct model *m, const struct densify_run *r,
                                   struct densify_work *c, struct densify_params *p, struct err *e)
{
    size_t n = m->gauss.n, bytes = n * sizeof(float);
    float *count = mem_array(n, sizeof(float));
    c->mean_grad = mem_array(n, sizeof(float));
    enum err_code rc = count && c->mean_grad
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "densify: out of memory for %zu Gaussians", n);
    if (!rc)
        rc = dev_read(m->dev, m->stats.count, 0, bytes, count, e);
    if (!rc)
        rc = dev_read(m->dev, stage_schedule(r->at)->absgrad ? m->stats.absg : m->stats.grad, 0,
                      bytes, c->mean_grad, e);
    for (size_t i = 0; !rc && i < n; i++) {
        float mean = count[i] > 0.0f ? c->mean_grad[i] / count[i] : 0.0f;
        c->mean_grad[i] = mean > 0.0f && isfinite(mean) ? mean : 0.0f;
    }
    if (!rc)
        rc = densify_opacity(m, r, c, count, p, e);
    mem_free(count);
    return rc;
}

/* At a level's first densification: thresholds in a wrong unit show in the share of candidates. */
static void densify_check_share(const struct schedule *s, const struct densify_report *r)
{
    double share = (double)(r->clone_candidates + r->split_candidates) / (double)r->before;
    if (share >= DENSIFY_SHARE_MIN && share <= DENSIFY_SHARE_MAX)
        return;
    log_warn("train",
             "level %u: %.2g %% of the Gaussians are candidates for densification, %.2g to %.0f %% "
             "are usual; the threshold tau is %g: it is in NDC units (2e-4, or 6e-4 with absolute "
             "gradients), and a loss with other weights shifts it",
             s->level, 100.0 * share, 100.0 * DENSIFY_SHARE_MIN, 100.0 * DENSIFY_SHARE_MAX, s->tau);
}

static enum err_code densify_tell(struct metrics_log *metrics, const struct stage *at,
                                  const struct densify_report *r, size_t cap, struct err *e)
{
    uint32_t level = stage_schedule(at)->level;
    log_debug(
        "train",
        "densify level=%u step=%u before=%zu pruned=%zu candidates=%zu+%zu room=%zu cloned=%zu "
        "split=%zu after=%zu outside=%zu cap=%zu",
        level, at->step, r->before, r->pruned, r->clone_candidates, r->split_candidates, r->room,
        r->cloned, r->split, r->after, r->outside, cap);
    if (!metrics)
        return ERR_OK;
    json_t *o = json_pack("{s:i, s:i, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I}", "level",
                          (int)level, "step", (int)at->step, "pruned", (json_int_t)r->pruned,
                          "clone_candidates", (json_int_t)r->clone_candidates, "split_candidates",
                          (json_int_t)r->split_candidates, "room", (json_int_t)r->room, "cloned",
                          (json_int_t)r->cloned, "split", (json_int_t)r->split, "cut",
                          (json_int_t)r->cut, "inside", (json_int_t)r->inside, "outside",
                          (json_int_t)r->outside, "cap", (json_int_t)cap);
    return metrics_log_line(metrics, "densify", o, e);
}

/* Children come next to their parents, and a Gaussian moves little until the next time: rows are
 * put along the curve every few times, and at last. */
static bool densify_keeps_order(const struct schedule *s, uint32_t x)
{
    return x % DENSIFY_SORT_EVERY != 1 && x < schedule_densify_count(s);
}

static struct densify_params densify_make_params(const struct model *m, const struct densify_run *r,
                                                 uint32_t x)
{
    const struct schedule *s = stage_schedule(r->at);
    const struct train_config *c = r->gallery->cfg;
    const struct site *site = r->site;
    double spacing_m = site->cell.edge_m / sqrt((double)s->budget);
    bool limits = schedule_limits_size(s, r->at->step);
    struct densify_params p = {
        .cell = &site->cell,
        .cap_inside = schedule_cap(r->at->start, schedule_grows(s), x, schedule_densify_count(s)),
        .cap_outside = schedule_cap_outside(s),
        .tau = s->tau,
        .tau_outside = DENSIFY_TAU_OUTSIDE,
        .split_above_m = gallery_split_above(r->gallery, site, s),
        .prune_opacity = DENSIFY_PRUNE_OPACITY,
        .prune_above_m = limits ? fmax(DENSIFY_PRUNE_SIZE * site->cell.scene_extent_m,
                                       DENSIFY_SPACINGS * spacing_m)
                                : 0.0,
        .keep_order = densify_keeps_order(s, x),
        .seed = (uint64_t)c->seed,
        .level = s->level,
        .step = r->at->step,
    };
    if (site->ground && limits) {
        p.ground = site->ground;
        p.free_space_m = DENSIFY_FREE_SPACE * site->ground->height_m;
        p.size_limit_m = gallery_size_limit(r->gallery, site, s);
    }
    if (site->rim && limits)
        p.rim = site->rim;
    p.cut_above_m = fmax(DENSIFY_CUT_SPACINGS * spacing_m,
                         site->rim ? DENSIFY_CUT_LEAST * site->rim->least_m : 0.0);
    memcpy(p.origin_enu_m, m->gauss.origin_enu_m, sizeof p.origin_enu_m);
    return p;
}

/* Which rows there will be, from the parameters as they are. */
static enum err_code densify_decide(struct model *m, const struct densify_run *r,
                                    struct densify_work *c, struct densify_params *p, struct err *e)
{
    enum err_code rc = densify_count(m, r, c, p, e);
    struct densify_input in = {.params = c->params,
                               .n = m->gauss.n,
                               .planes = m->gauss.planes,
                               .mean_grad = c->mean_grad,
                               .opacity = c->opacity};
    if (!rc)
        rc = densify_plan_make(p, &in, &c->plan, e);
    if (!rc && c->plan.report.needs_importance) {
        enum timing_on was = timing_turn(r->timing, TIMING_IMPORTANCE);
        c->score = mem_array(in.n, sizeof(float));
        rc = c->score ? importance_run(r->importance, m, r->gallery, r->at, c->score, e)
                      : err_set(e, ERR_MEM, "densify: out of memory for %zu scores", in.n);
        (void)timing_turn(r->timing, was);
        in.score = c->score;
        if (!rc)
            rc = densify_plan_score(p, &in, &c->plan, e);
    }
    if (!rc && !c->plan.n)
        rc = err_set(e, ERR_DATA,
                     "level %u, step %u: every Gaussian became transparent and was removed; "
                     "are the poses right?",
                     p->level, p->step);
    densify_free_input(c);
    return rc ? rc : densify_order(p, &in, &c->plan, &c->order, e);
}

/* Move the rows and halve what was split. */
static enum err_code densify_commit(struct model *m, size_t most, const struct densify_work *c,
                                    struct err *e)
{
    void *params = NULL;
    enum err_code rc = model_move(m, &c->order.rows, most, e);
    if (rc || !c->order.n_split)
        return rc;
    rc = dev_map(m->dev, m->gauss.params, CL_MAP_READ | CL_MAP_WRITE, model_bytes(m), &params, e);
    if (rc)
        return rc;
    densify_halve(&c->order, params);
    return dev_unmap(m->dev, m->gauss.params, &params, e);
}

enum err_code densify_apply(struct model *m, const struct densify_run *r, uint32_t x, struct err *e)
{
    struct densify_work c = {0};
    struct err why = {0};
    struct densify_params p = densify_make_params(m, r, x);
    enum err_code rc = dev_map(m->dev, m->gauss.params, CL_MAP_READ, model_bytes(m), &c.params, e);
    if (!rc)
        rc = densify_decide(m, r, &c, &p, e);
    enum err_code done = dev_unmap(m->dev, m->gauss.params, &c.params, &why);
    if (!rc && done)
        rc = err_set(e, done, "%s", why.msg);
    struct densify_report report = c.plan.report;
    densify_plan_free(&c.plan);
    if (!rc)
        rc = densify_commit(m, schedule_most(stage_schedule(r->at), &r->site->cell), &c, e);
    if (!rc) {
        if (x == 1)
            densify_check_share(stage_schedule(r->at), &report);
        rc = densify_tell(r->metrics, r->at, &report, p.cap_inside, e);
    }
    densify_free_input(&c);
    densify_order_free(&c.order);
    return rc;
}
