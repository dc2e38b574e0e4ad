/* The training loop of one cell: a step, what follows it at certain steps, and the hand-over
 * between levels. This file conducts; what it calls knows the model and the context only.
 *
 * A step is photograph -> forward pass -> loss -> backward pass fused with Adam; then, where the
 * schedule says so, density control and opacity reset (step first, then densify: a new Gaussian
 * starts with the parameters it was given): densify_apply.c.
 *
 * At a hand-over the Gaussians stay and everything of the optimiser starts anew: moments and
 * statistics 0, step 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/level.h"

#include <math.h>

#include "loss/photometric.h"
#include "train/config.h"
#include "train/densify_apply.h"
#include "train/importance.h"
#include "train/photo_loader.h"
#include "train/regularizer.h"
#include "train/schedule.h"

/* Of the cell's edge: beyond, exp() and determinants lose their digits. */
#define LEVEL_SIGMA_MIN 1e-6
#define LEVEL_SIGMA_MAX 0.5
#define LEVEL_BETA1 0.9f
#define LEVEL_BETA2 0.999f
#define LEVEL_EPS 1e-15f
#define LEVEL_MEAN_KEEP 0.95 /* of the running means shown to people */

static void level_start_optimiser(struct level *l)
{
    const struct context *ctx = &l->ctx;
    const struct train_config *c = ctx->cfg;
    const struct schedule *s = context_schedule(ctx);
    const struct appearance_train *a = &ctx->appearance;
    struct render_adam *adam = &l->model.adam;
    adam->lr_scale = (float)(c->lr_scale * s->lr_factor);
    adam->lr_quat = (float)(c->lr_quat * s->lr_factor);
    adam->lr_opacity = (float)c->lr_opacity;
    adam->lr_sh_dc = (float)c->lr_sh_dc;
    adam->lr_sh_rest = (float)c->lr_sh_rest;
    adam->beta1 = LEVEL_BETA1;
    adam->beta2 = LEVEL_BETA2;
    adam->eps = LEVEL_EPS;
    adam->scale_log_min = (float)log(LEVEL_SIGMA_MIN * ctx->cell.edge_m);
    adam->scale_log_max = (float)log(LEVEL_SIGMA_MAX * ctx->cell.edge_m);
    adam->step = ctx->step;
    uint32_t warmup = appearance_train_is_on(a) ? appearance_train_warmup(a, c, s) : 0;
    adam->embed_step = appearance_train_is_on(a) && ctx->step > warmup ? ctx->step - warmup : 0;
}

enum err_code level_open(struct level *l, const struct gauss *g, struct err *e)
{
    struct context *ctx = &l->ctx;
    enum err_code rc = model_open(&l->model, ctx->dev, ctx->render, g, context_most(ctx), e);
    if (!rc)
        rc = model_fill(&l->model, g, e);
    return rc ? rc : model_count_inside(&l->model, &ctx->cell, &ctx->start, e);
}

void level_close(struct level *l)
{
    budget_close(&l->budget);
    importance_free(&l->importance);
    regularizer_free(&l->regularizer);
    background_free(&l->background);
    model_close(&l->model);
    context_close(&l->ctx);
}

enum err_code level_begin(struct level *l, struct err *e)
{
    struct context *ctx = &l->ctx;
    const struct schedule *s = context_schedule(ctx);
    struct photo_loader_config f = {
        .scene = ctx->scene,
        .images = ctx->images,
        .n_images = ctx->n_images,
        .poses = &ctx->poses,
        .max_edge_px = (uint32_t)ctx->cfg->max_edge_px,
        .downsample = s->downsample,
        .cache_bytes = (size_t)ctx->cfg->cache_mib << 20,
        .exposure = ctx->cfg->exposure ? PHOTO_LOADER_TO_MEAN : PHOTO_LOADER_AS_TAKEN,
        .no_masks = !ctx->cfg->masks,
        .seed = (uint64_t)ctx->cfg->seed,
        .level = s->level,
    };
    photo_loader_close(&ctx->photos);
    level_start_optimiser(l);
    l->loss_mean = l->mse_mean = 0.0;
    l->step_s = clock_s();
    return photo_loader_open(&f, &ctx->photos, e);
}

enum err_code level_next(struct level *l, struct err *e)
{
    struct context *ctx = &l->ctx;
    enum err_code rc = model_count_inside(&l->model, &ctx->cell, &ctx->start, e);
    if (rc)
        return rc;
    ctx->at++;
    ctx->step = 0;
    ctx->pruned = false;
    budget_close(&l->budget);
    l->budget.at = (struct budget_point){0};
    l->model.filter_is_current = false;
    appearance_train_restart(&ctx->appearance);
    rc = model_zero_moments(&l->model, e);
    if (!rc)
        rc = model_zero_stats(&l->model, e);
    if (rc || ctx->at == ctx->n_levels)
        return rc;
    const struct schedule *s = context_schedule(ctx);
    if (ctx->start > s->budget)
        log_warn("train",
                 "level %u starts with %zu Gaussians, its budget is %zu: none will be added",
                 s->level, ctx->start, s->budget);
    return level_begin(l, e);
}

/* What follows some steps. The device finishes the step before the clock turns. */
static enum err_code level_control(struct level *l, uint32_t x, struct err *e)
{
    struct context *ctx = &l->ctx;
    enum err_code rc = dev_finish(ctx->dev, e);
    enum timing_on was = timing_turn(&ctx->timing, TIMING_BUDGET);
    if (!rc && x)
        rc = budget_look(&l->budget, &l->model, ctx, x, e);
    (void)timing_turn(&ctx->timing, TIMING_DENSIFY);
    if (!rc && x)
        rc = densify_apply(&l->model, ctx, &l->importance, x, e);
    if (!rc && schedule_resets(context_schedule(ctx), ctx->step))
        rc = model_reset_opacity(&l->model, ctx->cfg->reset_opacity, e);
    (void)timing_turn(&ctx->timing, was);
    return rc;
}

/* ---- a step ---- */

/* Non-finite updates are dropped on the device and counted; tell people once a thing goes wrong. */
static enum err_code level_check_repaired(struct level *l, struct err *e)
{
    uint32_t n = 0;
    enum err_code rc = dev_read(l->ctx.dev, l->model.stats.repaired, 0, sizeof n, &n, e);
    if (!rc && n != l->repaired) {
        log_warn("train", "%u Gaussians had a non-finite update and were repaired (step %u)",
                 n - l->repaired, l->ctx.step);
        l->repaired = n;
    }
    return rc;
}

static enum err_code level_read_loss(struct level *l, struct photometric_value *v, struct err *e)
{
    enum err_code rc = photometric_read(l->ctx.loss, v, e);
    if (rc)
        return rc;
    if (!isfinite(v->total))
        return err_set(e, ERR_DATA,
                       "level %u, step %u: the loss is not finite; lower the learning rates",
                       context_schedule(&l->ctx)->level, l->ctx.step);
    double keep = l->mse_mean > 0.0 ? LEVEL_MEAN_KEEP : 0.0;
    l->loss_mean = keep * l->loss_mean + (1.0 - keep) * v->total;
    l->mse_mean = keep * l->mse_mean + (1.0 - keep) * v->mse;
    return level_check_repaired(l, e);
}

/* What the backward pass of this step does about appearance. */
static void level_ask_appearance(struct level *l, uint32_t step, const struct render_options *ro,
                                 struct render_appearance_grad *grad)
{
    const struct schedule *s = context_schedule(&l->ctx);
    const struct train_config *c = l->ctx.cfg;
    const struct appearance_train *a = &l->ctx.appearance;
    struct render_adam *adam = &l->model.adam;
    adam->appearance = NULL;
    if (!ro->appearance_frame)
        return;
    *grad = (struct render_appearance_grad){
        .offset_weight = (float)c->opacity_offset_weight,
        .frame = appearance_train_learns(a, c, s) ? a->frame_grad : NULL};
    adam->lr_embed = (float)appearance_train_lr(a, c, s, step);
    adam->embed_step = step - appearance_train_warmup(a, c, s);
    adam->appearance = grad;
}

/* The step's gradient of the frame's constants moves the network and the photograph. */
static void level_learn_appearance(struct level *l, uint32_t image)
{
    struct render_adam *adam = &l->model.adam;
    const struct render_appearance_grad *grad = adam->appearance;
    l->offset_mean = grad->offset_mean;
    if (grad->frame)
        appearance_train_update(&l->ctx.appearance, image, (double)adam->lr_embed);
}

/* Of poses, from lr_pose down to lr_pose_final over all levels. */
static double level_pose_rate(const struct level *l, uint32_t step)
{
    const struct context *ctx = &l->ctx;
    const struct train_config *c = ctx->cfg;
    double done = step, all = 0.0;
    for (uint32_t i = 0; i < ctx->n_levels; i++) {
        done += i < ctx->at ? ctx->schedule[i].steps : 0.0;
        all += ctx->schedule[i].steps;
    }
    if (!(c->lr_pose > 0.0) || !(c->lr_pose_final > 0.0))
        return c->lr_pose * (1.0 - done / all);
    return c->lr_pose * pow(c->lr_pose_final / c->lr_pose, done / all);
}

/* The backward pass of the frame of a photograph, fused with Adam. */
static enum err_code level_backward(struct level *l, uint32_t step, uint32_t image,
                                    const struct render_options *ro, struct err *e)
{
    const struct schedule *s = context_schedule(&l->ctx);
    struct model *m = &l->model;
    struct render_appearance_grad grad;
    struct render_density_stats stats = m->stats;
    double pose[POSE_NUMBERS];
    m->adam.pose_grad = l->ctx.poses.n ? pose : NULL;
    m->adam.step = step;
    m->adam.lr_mean = (float)schedule_lr_mean(s, step);
    level_ask_appearance(l, step, ro, &grad);
    if (!s->absgrad || step >= s->densify_until)
        stats.absg = NULL; /* densification would not look at it: saves a tenth of the pass */
    enum err_code rc = render_backward_step(l->ctx.render, &m->gauss, &m->adam, &stats, e);
    if (!rc && m->adam.appearance)
        level_learn_appearance(l, image);
    if (!rc && m->adam.pose_grad)
        pose_update(&l->ctx.poses, image, pose, level_pose_rate(l, step));
    m->adam.appearance = NULL; /* these live here */
    m->adam.pose_grad = NULL;
    return rc;
}

enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e)
{
    struct context *ctx = &l->ctx;
    struct model *m = &l->model;
    uint32_t step = ctx->step + 1;
    struct photo photo;
    enum timing_on was = timing_turn(&ctx->timing, TIMING_PHOTOGRAPHS);
    enum err_code rc = photo_loader_get(ctx->photos, step, &photo, e);
    (void)timing_turn(&ctx->timing, was);
    if (rc)
        return rc;
    struct render_options ro = context_photo_options(ctx, step, photo.image);
    rc = background_choose(&l->background, ctx, step, &photo, &ro, e);
    if (!rc)
        rc = regularizer_step(&l->regularizer, m, ctx, step, &photo, e);
    if (!rc)
        rc = render_forward(ctx->render, &m->gauss, &photo.cam, &ro, NULL, NULL, e);
    if (!rc)
        rc = context_photo_loss(ctx, &photo, e);
    if (!rc)
        rc = level_backward(l, step, photo.image, &ro, e);
    if (!rc)
        rc = regularizer_shake(&l->regularizer, m, ctx, step, e);
    ctx->step = step;
    if (!rc && value)
        rc = level_read_loss(l, value, e);
    uint32_t x = schedule_densify_index(context_schedule(ctx), step);
    return !rc && (x || schedule_resets(context_schedule(ctx), step)) ? level_control(l, x, e) : rc;
}
