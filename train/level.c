/* The training loop of one cell: a step, what follows it at certain steps, and the hand-over
 * between levels.
 *
 * A step is photograph -> forward -> loss -> backward fused with Adam; then, where the schedule
 * says so, density control and opacity reset (step first, then densify: a new Gaussian starts with
 * the parameters it was given). Density control is rare and runs on host copies of parameters and
 * moments in the device's own layout.
 *
 * At a hand-over the Gaussians stay and everything of the optimiser starts anew: moments and
 * statistics 0, step 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/level.h"

#include <math.h>
#include <string.h>

#include <jansson.h>

#include "core/layout.h"
#include "train/mask.h"

#define LEVEL_SIGMA_MIN                                                                            \
    1e-6 /* of the cell's edge: beyond, exp() and determinants lose their digits */
#define LEVEL_SIGMA_MAX 0.5
#define LEVEL_SHARE_MIN 1e-3 /* of the Gaussians; see docs/decisions/006-density-control.md */
#define LEVEL_SHARE_MAX 0.98
#define LEVEL_BETA1 0.9f
#define LEVEL_BETA2 0.999f
#define LEVEL_EPS 1e-15f
/* Spacings of the budget's Gaussians, laid out on a grid over the cell: what is smaller than this
 * is never removed for its size. Below about one spacing the ground cannot be covered, and then
 * every removal makes the others grow until they are removed too. */
#define LEVEL_SPACINGS 4.0
#define LEVEL_MEAN_KEEP 0.95 /* of the running means shown to people */
enum { LEVEL_LANES = LAYOUT_LANES };

static const struct schedule *level_schedule(const struct level *l)
{
    return &l->schedule[l->at < l->n_levels ? l->at : l->n_levels - 1];
}

struct render_options level_render_options(const struct level *l, uint32_t step)
{
    const struct train_config *c = l->cfg;
    float grey = (float)c->background;
    return (struct render_options){
        .aa = (enum render_aa)c->aa,
        .background = {grey, grey, grey},
        .near_m = c->near_m > 0.0 ? c->near_m : fmax(RENDER_NEAR_M, l->cell.edge_m / 1000.0),
        .sh_degree = (int)schedule_sh_degree(level_schedule(l), step),
    };
}

struct render_options level_photo_options(struct level *l, uint32_t step, uint32_t image)
{
    struct render_options ro = level_render_options(l, step);
    if (light_is_on(&l->light) && step > light_warmup(&l->light, l->cfg, level_schedule(l)))
        ro.appearance_frame = light_frame(&l->light, image);
    ro.appearance_hidden = l->light.model.hidden;
    return ro;
}

/* ---- buffers ------------------------------------------------------------------------------------
 */

static void level_release(struct level *l)
{
    render_model_free(&l->model);
    dev_release(&l->adam.m1);
    dev_release(&l->adam.m2);
    dev_release(&l->stats.grad);
    dev_release(&l->stats.absg);
    dev_release(&l->stats.count);
    dev_release(&l->stats.radius);
    dev_release(&l->stats.opacity);
}

/* Room for at least n Gaussians, all planes; contents are lost when it grows. */
static enum err_code level_reserve(struct level *l, size_t n, struct err *e)
{
    struct render_model keep = l->model;
    if (n <= keep.cap && l->adam.m1)
        return ERR_OK;
    size_t groups =
        (n + n / 4 + LEVEL_LANES - 1) / LEVEL_LANES; /* grow by steps, not at every call */
    size_t cap = groups * LEVEL_LANES, bytes = cap * keep.planes * sizeof(float);
    if (cap > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu Gaussians are more than the renderer counts", n);
    level_release(l);
    l->model.planes = keep.planes;
    l->model.sh_degree = keep.sh_degree;
    l->model.embed_len = keep.embed_len;
    memcpy(l->model.origin_enu_m, keep.origin_enu_m, sizeof(keep.origin_enu_m));
    cl_mem *per_plane[] = {&l->model.params, &l->adam.m1, &l->adam.m2};
    cl_mem *per_row[] = {&l->stats.grad, &l->stats.absg, &l->stats.count, &l->stats.radius,
                         &l->stats.opacity};
    const size_t rows = light_is_on(&l->light) ? 5 : 4;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 3; i++)
        rc = dev_buffer(l->dev, bytes, NULL, per_plane[i], e);
    for (size_t i = 0; !rc && i < rows; i++)
        rc = dev_buffer(l->dev, cap * sizeof(float), NULL, per_row[i], e);
    if (rc)
        return err_add(e, "training %zu Gaussians", n);
    l->model.cap = (uint32_t)cap;
    return ERR_OK;
}

static enum err_code level_zero_stats(struct level *l, struct err *e)
{
    cl_mem rows[] = {l->stats.grad, l->stats.absg, l->stats.count, l->stats.radius,
                     l->stats.opacity};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 5; i++)
        rc = !rows[i] ? ERR_OK : dev_zero(l->dev, rows[i], 0, l->model.cap * sizeof(float), e);
    return rc;
}

enum err_code level_replace(struct level *l, const struct densify_state *s, size_t n, struct err *e)
{
    enum err_code rc = level_reserve(l, n, e);
    size_t bytes = densify_floats(n, l->model.planes) * sizeof(float);
    if (!rc)
        rc = dev_write(l->dev, l->model.params, 0, bytes, s->params, e);
    if (!rc)
        rc = dev_write(l->dev, l->adam.m1, 0, bytes, s->m1, e);
    if (!rc)
        rc = dev_write(l->dev, l->adam.m2, 0, bytes, s->m2, e);
    if (rc)
        return rc;
    l->filter_is_current = false;
    l->model.n = (uint32_t)n;
    l->model.groups = (uint32_t)((n + LEVEL_LANES - 1) / LEVEL_LANES);
    return level_zero_stats(l, e);
}

static void level_start_optimiser(struct level *l)
{
    const struct train_config *c = l->cfg;
    l->adam.lr_scale = (float)(c->lr_scale * level_schedule(l)->lr_factor);
    l->adam.lr_quat = (float)(c->lr_quat * level_schedule(l)->lr_factor);
    l->adam.lr_opacity = (float)c->lr_opacity;
    l->adam.lr_sh_dc = (float)c->lr_sh_dc;
    l->adam.lr_sh_rest = (float)c->lr_sh_rest;
    l->adam.beta1 = LEVEL_BETA1;
    l->adam.beta2 = LEVEL_BETA2;
    l->adam.eps = LEVEL_EPS;
    l->adam.scale_log_min = (float)log(LEVEL_SIGMA_MIN * l->cell.edge_m);
    l->adam.scale_log_max = (float)log(LEVEL_SIGMA_MAX * l->cell.edge_m);
    l->adam.step = l->step;
    uint32_t warmup = light_is_on(&l->light) ? light_warmup(&l->light, c, level_schedule(l)) : 0;
    l->adam.embed_step = light_is_on(&l->light) && l->step > warmup ? l->step - warmup : 0;
}

static size_t level_count_inside(const struct level *l, const struct gauss *g)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++)
        n += cell_distance(&l->cell, g->origin_enu_m[0] + (double)g->mean_m[3 * i],
                           g->origin_enu_m[1] + (double)g->mean_m[3 * i + 1]) <= 0.0;
    return n;
}

enum err_code level_open(struct level *l, const struct gauss *g, struct err *e)
{
    struct render_model packed = {0};
    float *params = NULL, *zeros = NULL;
    enum err_code rc = render_model_upload(l->render, g, &packed, e);
    if (rc)
        return rc;
    l->model.planes = packed.planes;
    l->model.sh_degree = g->sh_degree;
    l->model.embed_len = g->embed_len;
    memcpy(l->model.origin_enu_m, g->origin_enu_m, sizeof(g->origin_enu_m));
    size_t floats = densify_floats(g->n, packed.planes);
    params = mem_array(floats, sizeof(float));
    zeros = mem_array(floats, sizeof(float));
    if (!params || !zeros)
        rc = err_set(e, ERR_MEM, "out of memory for %zu Gaussians", g->n);
    if (!rc)
        rc = dev_read(l->dev, packed.params, 0, floats * sizeof(float), params, e);
    render_model_free(&packed);
    if (!rc)
        rc = dev_buffer(l->dev, sizeof(uint32_t), NULL, &l->stats.repaired, e);
    if (!rc)
        rc = dev_zero(l->dev, l->stats.repaired, 0, sizeof(uint32_t), e);
    if (!rc)
        rc = level_replace(l, &(struct densify_state){params, zeros, zeros}, g->n, e);
    l->start = level_count_inside(l, g);
    level_start_optimiser(l);
    mem_free(params);
    mem_free(zeros);
    return rc;
}

void level_close(struct level *l)
{
    level_release(l);
    dev_release(&l->stats.repaired);
    dev_release(&l->target);
    dev_release(&l->mask);
    feed_close(&l->feed);
    budget_close(&l->budget);
    score_free(&l->score);
    regular_free(&l->regular);
    light_close(&l->light);
}

enum err_code level_gauss(struct level *l, struct gauss *out, struct err *e)
{
    *out = (struct gauss){0};
    enum err_code rc = render_model_download(l->render, &l->model, out, e);
    out->antialiased = l->cfg->aa != RENDER_AA_NONE;
    return rc;
}

enum err_code level_begin(struct level *l, struct err *e)
{
    const struct schedule *s = level_schedule(l);
    struct feed_config f = {
        .scene = l->scene,
        .images = l->images,
        .n_images = l->n_images,
        .max_edge_px = (uint32_t)l->cfg->max_edge_px,
        .downsample = s->downsample,
        .cache_bytes = (size_t)l->cfg->cache_mib << 20,
        .no_masks = !l->cfg->masks,
        .seed = (uint64_t)l->cfg->seed,
        .level = s->level,
    };
    feed_close(&l->feed);
    level_start_optimiser(l);
    l->loss_mean = l->mse_mean = 0.0;
    l->step_s = clock_s();
    return feed_open(&f, &l->feed, e);
}

enum err_code level_next(struct level *l, struct err *e)
{
    struct gauss g = {0};
    enum err_code rc = level_gauss(l, &g, e);
    if (rc)
        return rc;
    l->at++;
    l->step = 0;
    l->pruned = false;
    budget_close(&l->budget);
    l->budget.at = (struct budget_point){0};
    l->filter_is_current = false;
    l->start = level_count_inside(l, &g);
    light_restart(&l->light);
    gauss_free(&g);
    size_t bytes = densify_floats(l->model.cap, l->model.planes) * sizeof(float);
    rc = dev_zero(l->dev, l->adam.m1, 0, bytes, e);
    if (!rc)
        rc = dev_zero(l->dev, l->adam.m2, 0, bytes, e);
    if (!rc)
        rc = level_zero_stats(l, e);
    if (rc || l->at == l->n_levels)
        return rc;
    const struct schedule *s = level_schedule(l);
    if (l->start > s->budget)
        log_warn("train",
                 "level %u starts with %zu Gaussians, its budget is %zu: none will be added",
                 s->level, l->start, s->budget);
    return level_begin(l, e);
}

/* ---- density control
 * ---------------------------------------------------------------------------------- */

/* Host copies around one densification. */
struct level_copy {
    struct densify_state from, to;
    float *sum, *count, *mean_grad, *score, *opacity;
    struct densify_plan plan;
};

static void level_copy_free(struct level_copy *c)
{
    float *all[] = {c->from.params, c->from.m1, c->from.m2,   c->to.params, c->to.m1,  c->to.m2,
                    c->sum,         c->count,   c->mean_grad, c->score,     c->opacity};
    for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); i++)
        mem_free(all[i]);
    densify_plan_free(&c->plan);
}

static enum err_code level_state_alloc(struct densify_state *s, size_t floats, struct err *e)
{
    s->params = mem_array(floats, sizeof(float));
    s->m1 = mem_array(floats, sizeof(float));
    s->m2 = mem_array(floats, sizeof(float));
    if (!s->params || !s->m1 || !s->m2)
        return err_set(e, ERR_MEM, "densify: out of memory for %zu floats", 3 * floats);
    return ERR_OK;
}

static enum err_code level_download(struct level *l, struct level_copy *c, struct err *e)
{
    size_t n = l->model.n, floats = densify_floats(n, l->model.planes);
    bool absgrad = level_schedule(l)->absgrad;
    enum err_code rc = level_state_alloc(&c->from, floats, e);
    c->sum = mem_array(n, sizeof(float));
    c->count = mem_array(n, sizeof(float));
    c->mean_grad = mem_array(n, sizeof(float));
    if (!rc && (!c->sum || !c->count || !c->mean_grad))
        rc = err_set(e, ERR_MEM, "densify: out of memory for %zu Gaussians", n);
    struct {
        cl_mem from;
        float *to;
        size_t floats;
    } part[] = {{l->model.params, c->from.params, floats},
                {l->adam.m1, c->from.m1, floats},
                {l->adam.m2, c->from.m2, floats},
                {l->stats.count, c->count, n},
                {absgrad ? l->stats.absg : l->stats.grad, c->sum, n}};
    for (size_t i = 0; !rc && i < sizeof(part) / sizeof(part[0]); i++)
        rc = dev_read(l->dev, part[i].from, 0, part[i].floats * sizeof(float), part[i].to, e);
    for (size_t i = 0; !rc && i < n; i++) {
        float mean = c->count[i] > 0.0f ? c->sum[i] / c->count[i] : 0.0f;
        c->mean_grad[i] = mean > 0.0f && isfinite(mean) ? mean : 0.0f;
    }
    return rc;
}

/* At a level's first densification: thresholds in a wrong unit show in the share of candidates. */
static void level_check_share(const struct level *l, const struct densify_report *r, uint32_t x)
{
    double share = (double)(r->clone_candidates + r->split_candidates) / (double)r->before;
    const struct schedule *s = level_schedule(l);
    if (x != 1 || (share >= LEVEL_SHARE_MIN && share <= LEVEL_SHARE_MAX))
        return;
    log_warn("train",
             "level %u: %.2g %% of the Gaussians are candidates for densification, %.2g to %.0f %% "
             "are usual; the threshold tau is %g: it is in NDC units (2e-4, or 6e-4 with absolute "
             "gradients), and a loss with other weights shifts it",
             s->level, 100.0 * share, 100.0 * LEVEL_SHARE_MIN, 100.0 * LEVEL_SHARE_MAX, s->tau);
}

static enum err_code level_report(struct level *l, const struct densify_report *r, size_t cap,
                                  struct err *e)
{
    log_debug(
        "train",
        "densify level=%u step=%u before=%zu pruned=%zu candidates=%zu+%zu room=%zu cloned=%zu "
        "split=%zu after=%zu outside=%zu cap=%zu",
        level_schedule(l)->level, l->step, r->before, r->pruned, r->clone_candidates,
        r->split_candidates, r->room, r->cloned, r->split, r->after, r->outside, cap);
    if (!l->record)
        return ERR_OK;
    json_t *o =
        json_pack("{s:i, s:i, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I}", "level",
                  (int)level_schedule(l)->level, "step", (int)l->step, "pruned",
                  (json_int_t)r->pruned, "clone_candidates", (json_int_t)r->clone_candidates,
                  "split_candidates", (json_int_t)r->split_candidates, "room", (json_int_t)r->room,
                  "cloned", (json_int_t)r->cloned, "split", (json_int_t)r->split, "inside",
                  (json_int_t)r->inside, "outside", (json_int_t)r->outside, "cap", (json_int_t)cap);
    return record_line(l->record, "densify", o, e);
}

static double level_prune_above(const struct level *l)
{
    double spacing_m = l->cell.edge_m / sqrt((double)level_schedule(l)->budget);
    return l->cfg->prune_size > 0.0
               ? fmax(l->cfg->prune_size * l->cell.extent_m, LEVEL_SPACINGS * spacing_m)
               : 0.0;
}

static struct densify_params level_densify_params(const struct level *l, uint32_t x)
{
    const struct schedule *s = level_schedule(l);
    const struct train_config *c = l->cfg;
    struct densify_params p = {
        .cell = &l->cell,
        .cap_inside = schedule_cap(l->start, s->budget, x, schedule_densify_count(s)),
        .cap_outside = s->budget / 2,
        .tau = s->tau,
        .tau_outside = c->tau_outside,
        .split_above_m = c->percent_dense * l->cell.extent_m,
        .split = (enum densify_split)c->split,
        .prune_opacity = c->prune_opacity,
        .prune_above_m = schedule_was_reset(s, l->step) ? level_prune_above(l) : 0.0,
        .seed = (uint64_t)c->seed,
        .level = s->level,
        .step = l->step,
    };
    memcpy(p.origin_enu_m, l->model.origin_enu_m, sizeof(p.origin_enu_m));
    return p;
}

/* A Gaussian that shows under the light of some photographs only must not go for being faint by
 * itself: the limit is for the largest opacity it was drawn with since the last densification. */
static enum err_code level_opacity(struct level *l, struct level_copy *c, struct densify_params *p,
                                   struct err *e)
{
    if (!light_is_on(&l->light) || l->step <= light_warmup(&l->light, l->cfg, level_schedule(l)))
        return ERR_OK;
    c->opacity = mem_array(l->model.n, sizeof(float));
    if (!c->opacity)
        return err_set(e, ERR_MEM, "densify: out of memory for %u Gaussians", l->model.n);
    p->prune_opacity += LIGHT_OFFSET_IDLE;
    enum err_code rc =
        dev_read(l->dev, l->stats.opacity, 0, l->model.n * sizeof(float), c->opacity, e);
    for (size_t i = 0; !rc && i < l->model.n; i++) {
        const float *row = c->from.params + i / LEVEL_LANES * l->model.planes * LEVEL_LANES;
        float own = row[RENDER_PLANE_OPACITY * LEVEL_LANES + i % LEVEL_LANES];
        if (!(c->count[i] > 0.0f)) /* not seen: nothing was added to its own */
            c->opacity[i] = 1.0f / (1.0f + expf(-own)) + (float)LIGHT_OFFSET_IDLE;
    }
    return rc;
}

static enum err_code level_densify(struct level *l, uint32_t x, struct err *e)
{
    struct level_copy c = {0};
    struct densify_params p = level_densify_params(l, x);
    enum err_code rc = level_download(l, &c, e);
    if (!rc)
        rc = level_opacity(l, &c, &p, e);
    if (rc)
        goto out;
    struct densify_input in = {.params = c.from.params,
                               .n = l->model.n,
                               .planes = l->model.planes,
                               .mean_grad = c.mean_grad,
                               .opacity = c.opacity};
    rc = densify_choose(&p, &in, &c.plan, e);
    if (!rc && c.plan.report.needs_score) {
        c.score = mem_array(in.n, sizeof(float));
        enum spent_on was = spent_turn(&l->spent, SPENT_SCORE);
        rc = c.score ? score_run(l, c.from.params, c.mean_grad, c.score, e)
                     : err_set(e, ERR_MEM, "densify: out of memory for %zu scores", in.n);
        (void)spent_turn(&l->spent, was);
        in.score = c.score;
        if (!rc)
            rc = densify_choose(&p, &in, &c.plan, e);
    }
    if (rc)
        goto out;
    if (!c.plan.n) {
        rc = err_set(e, ERR_DATA,
                     "level %u, step %u: every Gaussian became transparent and was removed; "
                     "are the poses right?",
                     level_schedule(l)->level, l->step);
        goto out;
    }
    rc = level_state_alloc(&c.to, densify_floats(c.plan.n, l->model.planes), e);
    if (!rc)
        rc = densify_apply(&p, &in, &c.plan, &c.from, &c.to, e);
    if (!rc)
        rc = level_replace(l, &c.to, c.plan.n, e);
    if (!rc) {
        level_check_share(l, &c.plan.report, x);
        rc = level_report(l, &c.plan.report, p.cap_inside, e);
    }
out:
    level_copy_free(&c);
    return rc;
}

/* Lower every opacity to the reset value and forget its moments. */
static enum err_code level_reset_opacity(struct level *l, struct err *e)
{
    size_t floats = densify_floats(l->model.n, l->model.planes), bytes = floats * sizeof(float);
    float top = (float)log(l->cfg->reset_opacity / (1.0 - l->cfg->reset_opacity));
    cl_mem buffers[] = {l->model.params, l->adam.m1, l->adam.m2};
    float *host = mem_array(floats, sizeof(float));
    enum err_code rc = host ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu floats", floats);
    for (size_t b = 0; !rc && b < 3; b++) {
        rc = dev_read(l->dev, buffers[b], 0, bytes, host, e);
        for (size_t i = 0; i < l->model.n; i++) {
            float *o = host +
                       (i / LEVEL_LANES * l->model.planes + RENDER_PLANE_OPACITY) * LEVEL_LANES +
                       i % LEVEL_LANES;
            *o = b ? 0.0f : fminf(*o, top);
        }
        if (!rc)
            rc = dev_write(l->dev, buffers[b], 0, bytes, host, e);
    }
    mem_free(host);
    return rc;
}

/* What follows some steps. The device finishes the step before the clock turns. */
static enum err_code level_control(struct level *l, uint32_t x, struct err *e)
{
    enum err_code rc = dev_finish(l->dev, e);
    enum spent_on was = spent_turn(&l->spent, SPENT_BUDGET);
    if (!rc && x)
        rc = budget_look(l, x, e);
    (void)spent_turn(&l->spent, SPENT_DENSIFY);
    if (!rc && x)
        rc = level_densify(l, x, e);
    if (!rc && schedule_resets(level_schedule(l), l->step))
        rc = level_reset_opacity(l, e);
    (void)spent_turn(&l->spent, was);
    return rc;
}

/* ---- a step
 * ---------------------------------------------------------------------------------------------- */

static enum err_code level_upload(struct level *l, cl_mem *to, size_t *room, const void *from,
                                  size_t bytes, struct err *e)
{
    if (bytes > *room) {
        dev_release(to);
        *room = 0;
        enum err_code rc = dev_buffer(l->dev, bytes, NULL, to, e);
        if (rc)
            return rc;
        *room = bytes;
    }
    return dev_write(l->dev, *to, 0, bytes, from, e);
}

static enum err_code level_upload_photo(struct level *l, const struct feed_photo *p, struct err *e)
{
    size_t bytes = (size_t)p->cam.width_px * p->cam.height_px * 3;
    return level_upload(l, &l->target, &l->target_bytes, p->px, bytes, e);
}

/* The photograph's mask, and in a run with robust weighting the pixels that do not fit. Leaves
 * *mask NULL when all pixels count. */
static enum err_code level_upload_mask(struct level *l, const struct feed_photo *p, cl_mem *mask,
                                       struct err *e)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px;
    bool robust = l->cfg->robust_from > 0 && l->step + 1 >= (uint32_t)l->cfg->robust_from;
    *mask = NULL;
    if (!p->mask && !robust)
        return ERR_OK;
    uint8_t *use = mem_array(n, 1);
    float *color = robust ? mem_array(4 * n, sizeof(float)) : NULL;
    enum err_code rc = use && (color || !robust) ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    if (!rc && p->mask)
        memcpy(use, p->mask, n);
    else if (!rc)
        memset(use, 255, n);
    if (!rc && robust)
        rc = dev_read(l->dev, render_color_buffer(l->render), 0, 3 * n * sizeof(float), color, e);
    if (!rc && robust)
        mask_robust(color, p->px, p->cam.width_px, p->cam.height_px, color + 3 * n, use);
    if (!rc)
        rc = level_upload(l, &l->mask, &l->mask_bytes, use, n, e);
    *mask = rc ? NULL : l->mask;
    mem_free(use);
    mem_free(color);
    return rc;
}

enum err_code level_photo_loss(struct level *l, const struct feed_photo *p, struct err *e)
{
    struct loss_input in = {
        .color = render_color_buffer(l->render),
        .width_px = p->cam.width_px,
        .height_px = p->cam.height_px,
        .l1_weight = (float)l->cfg->l1_weight,
        .ssim_weight = (float)l->cfg->ssim_weight,
    };
    enum err_code rc = level_upload_photo(l, p, e);
    in.target = l->target;
    if (!rc)
        rc = level_upload_mask(l, p, &in.mask, e);
    return rc ? rc : loss_run(l->loss, &in, render_color_grad_buffer(l->render), e);
}

/* Non-finite updates are dropped on the device and counted; tell people once a thing goes wrong. */
static enum err_code level_check_repaired(struct level *l, struct err *e)
{
    uint32_t n = 0;
    enum err_code rc = dev_read(l->dev, l->stats.repaired, 0, sizeof(n), &n, e);
    if (!rc && n != l->repaired) {
        log_warn("train", "%u Gaussians had a non-finite update and were repaired (step %u)",
                 n - l->repaired, l->step);
        l->repaired = n;
    }
    return rc;
}

static enum err_code level_read_loss(struct level *l, struct loss_value *v, struct err *e)
{
    enum err_code rc = loss_read(l->loss, v, e);
    if (rc)
        return rc;
    if (!isfinite(v->total))
        return err_set(e, ERR_DATA,
                       "level %u, step %u: the loss is not finite; lower the learning rates",
                       level_schedule(l)->level, l->step);
    double keep = l->mse_mean > 0.0 ? LEVEL_MEAN_KEEP : 0.0;
    l->loss_mean = keep * l->loss_mean + (1.0 - keep) * v->total;
    l->mse_mean = keep * l->mse_mean + (1.0 - keep) * v->mse;
    return level_check_repaired(l, e);
}

/* What the way back of this step does about appearance. */
static void level_light(struct level *l, uint32_t step, const struct render_options *ro,
                        struct render_appearance_grad *grad)
{
    const struct schedule *s = level_schedule(l);
    l->adam.appearance = NULL;
    if (!ro->appearance_frame)
        return;
    *grad = (struct render_appearance_grad){
        .offset_weight = (float)l->cfg->opacity_offset_weight,
        .frame = light_learns(&l->light, l->cfg, s) ? l->light.frame_grad : NULL};
    l->adam.lr_embed = (float)light_lr(&l->light, l->cfg, s, step);
    l->adam.embed_step = step - light_warmup(&l->light, l->cfg, s);
    l->adam.appearance = grad;
}

/* The step's gradient of the frame's constants moves the network and the photograph. */
static void level_learn_light(struct level *l, uint32_t image)
{
    const struct render_appearance_grad *grad = l->adam.appearance;
    l->offset_mean = grad->offset_mean;
    if (grad->frame)
        light_update(&l->light, image, (double)l->adam.lr_embed);
    l->adam.appearance = NULL; /* it lives in the step's frame */
}

enum err_code level_step(struct level *l, struct loss_value *value, struct err *e)
{
    const struct schedule *s = level_schedule(l);
    uint32_t step = l->step + 1;
    struct feed_photo photo;
    enum spent_on was = spent_turn(&l->spent, SPENT_PHOTOGRAPHS);
    enum err_code rc = feed_get(l->feed, step, &photo, e);
    (void)spent_turn(&l->spent, was);
    if (rc)
        return rc;
    struct render_options ro = level_photo_options(l, step, photo.image);
    rc = regular_step(l, step, &photo, e);
    if (!rc)
        rc = render_forward(l->render, &l->model, &photo.cam, &ro, NULL, NULL, e);
    if (!rc)
        rc = level_photo_loss(l, &photo, e);
    l->adam.step = step;
    l->adam.lr_mean = (float)schedule_lr_mean(s, step);
    struct render_appearance_grad grad;
    level_light(l, step, &ro, &grad);
    struct render_density_stats stats = l->stats;
    if (!s->absgrad || step >= s->densify_until)
        stats.absg = NULL; /* densification would not look at it: saves a tenth of the way back */
    if (!rc)
        rc = render_backward_step(l->render, &l->model, &l->adam, &stats, e);
    if (!rc && l->adam.appearance)
        level_learn_light(l, photo.image);
    l->step = step;
    if (!rc && value)
        rc = level_read_loss(l, value, e);
    uint32_t x = schedule_densify_index(s, step);
    return !rc && (x || schedule_resets(s, step)) ? level_control(l, x, e) : rc;
}
