/* The training loop of one cell: a step, what follows it at certain steps, and the hand-over
 * between levels.
 *
 * A step is photograph -> forward -> loss -> backward fused with Adam; then, where the schedule
 * says so, density control and opacity reset (step first, then densify: a new Gaussian starts with
 * the parameters it was given): density.c.
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

#include "cells/cell.h"
#include "loss/photometric.h"
#include "loss/robust.h"
#include "render/permute.h"
#include "train/appearance_train.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/densify_apply.h"
#include "train/importance.h"
#include "train/photo_loader.h"
#include "train/regularizer.h"
#include "train/schedule.h"
#include "train/timing.h"

#define LEVEL_SIGMA_MIN                                                                            \
    1e-6 /* of the cell's edge: beyond, exp() and determinants lose their digits */
#define LEVEL_SIGMA_MAX 0.5
#define LEVEL_BETA1 0.9f
#define LEVEL_BETA2 0.999f
#define LEVEL_EPS 1e-15f
#define LEVEL_MEAN_KEEP 0.95 /* of the running means shown to people */

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
    if (appearance_train_is_on(&l->light) &&
        step > appearance_train_warmup(&l->light, l->cfg, level_schedule(l)))
        ro.appearance_frame = appearance_train_frame(&l->light, image);
    ro.appearance_hidden = l->light.model.hidden;
    return ro;
}

/* ---- buffers ---- */

/* The statistics, and how many there are: the last only with appearance. */
static size_t level_stats(struct level *l, cl_mem *out[5])
{
    out[0] = &l->stats.grad;
    out[1] = &l->stats.absg;
    out[2] = &l->stats.count;
    out[3] = &l->stats.radius;
    out[4] = &l->stats.opacity;
    return appearance_train_is_on(&l->light) ? 5 : 4;
}

static void level_release_stats(struct level *l)
{
    cl_mem *rows[5];
    (void)level_stats(l, rows);
    for (size_t i = 0; i < 5; i++)
        dev_release(rows[i]);
}

static void level_release(struct level *l)
{
    render_model_free(&l->model);
    dev_release(&l->adam.m1);
    dev_release(&l->adam.m2);
    level_release_stats(l);
}

/* Room for n Gaussians that are there, and for those to come. Memory that is reserved and not
 * touched costs a CPU device nothing, but a buffer that has become too small takes a copy: when all
 * that the level may have is no more than twice as many, that is the size. */
static size_t level_room(const struct level *l, size_t n)
{
    size_t most = level_schedule(l)->budget;
    most += l->cell.whole ? 0 : most / 2;
    size_t cap = most >= n && most / 2 <= n ? most : n + n / 4;
    return (cap + LAYOUT_LANES - 1) / LAYOUT_LANES * LAYOUT_LANES;
}

static enum err_code level_zero_stats(struct level *l, struct err *e)
{
    cl_mem *rows[5];
    size_t n = level_stats(l, rows);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++)
        if (!*rows[i])
            rc = dev_buffer(l->dev, l->model.cap * sizeof(float), NULL, rows[i], e);
    for (size_t i = 0; !rc && i < n; i++)
        rc = dev_zero(l->dev, *rows[i], 0, permute_floats(l->model.n, 1) * sizeof(float), e);
    return rc;
}

static void level_count(struct level *l, size_t n)
{
    l->filter_is_current = false;
    l->model.n = (uint32_t)n;
    l->model.groups = (uint32_t)((n + LAYOUT_LANES - 1) / LAYOUT_LANES);
}

/* One of the three arrays, in place or into a new one of `cap`, which takes its place. */
static enum err_code level_move_part(struct level *l, size_t part, const struct permutation *r,
                                     size_t cap, struct err *e)
{
    cl_mem *parts[] = {&l->model.params, &l->adam.m1, &l->adam.m2}, *at = parts[part], grown = NULL;
    size_t before = permute_floats(r->n_old, r->planes), after = permute_floats(r->n, r->planes);
    size_t most = before > after ? before : after;
    bool grows = cap > l->model.cap;
    void *from = NULL, *to = NULL;
    struct err why = {0};
    enum err_code rc = ERR_OK, done = ERR_OK;
    if (grows)
        rc = dev_buffer(l->dev, permute_floats(cap, r->planes) * sizeof(float), NULL, &grown, e);
    if (!rc)
        rc = dev_map(l->dev, *at, grows ? CL_MAP_READ : CL_MAP_READ | CL_MAP_WRITE,
                     (grows ? before : most) * sizeof(float), &from, e);
    if (!rc && grows)
        rc = dev_map(l->dev, grown, CL_MAP_WRITE, after * sizeof(float), &to, e);
    if (!rc)
        rc = permute_move(r, part > 0, from, grows ? to : from, e);
    done = dev_unmap(l->dev, *at, &from, &why);
    if (!done && grows)
        done = dev_unmap(l->dev, grown, &to, &why);
    if (!done)
        done = dev_finish(l->dev, &why); /* what is released below goes at once */
    if (!rc && done)
        rc = err_set(e, done, "%s", why.msg);
    if (!rc && grows) {
        cl_mem old = *at;
        *at = grown;
        grown = old;
    }
    dev_release(&grown);
    return rc;
}

enum err_code level_move(struct level *l, const struct permutation *r, struct err *e)
{
    size_t cap = r->n > l->model.cap ? level_room(l, r->n) : l->model.cap;
    enum err_code rc = ERR_OK;
    if (cap > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu Gaussians are more than the renderer counts", r->n);
    if (cap > l->model.cap) {
        level_release_stats(l);
        dev_release(&l->model.filter);
    }
    for (size_t k = 0; !rc && k < 3; k++)
        rc = level_move_part(l, k, r, cap, e);
    if (rc)
        return err_add(e, "training %zu Gaussians", r->n);
    l->model.cap = (uint32_t)cap;
    level_count(l, r->n);
    return level_zero_stats(l, e);
}

enum err_code level_show(struct level *l, size_t n, struct err *e)
{
    level_count(l, n);
    return level_zero_stats(l, e);
}

enum err_code level_forget(struct level *l, struct err *e)
{
    const uint32_t n = l->model.n, planes = l->model.planes, lane = n % LAYOUT_LANES;
    cl_mem parts[] = {l->model.params, l->adam.m1, l->adam.m2};
    size_t bytes = permute_floats(n, planes) * sizeof(float);
    enum err_code rc = ERR_OK;
    for (size_t k = 0; !rc && lane && k < 3; k++) {
        void *at = NULL;
        rc = dev_map(l->dev, parts[k], CL_MAP_READ | CL_MAP_WRITE, bytes, &at, e);
        for (uint32_t p = 0; !rc && p < planes; p++)
            memset((float *)at + permute_at(n, planes) + (size_t)p * LAYOUT_LANES, 0,
                   (LAYOUT_LANES - lane) * sizeof(float));
        if (!rc)
            rc = dev_unmap(l->dev, parts[k], &at, e);
    }
    return rc;
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
    uint32_t warmup = appearance_train_is_on(&l->light)
                          ? appearance_train_warmup(&l->light, c, level_schedule(l))
                          : 0;
    l->adam.embed_step =
        appearance_train_is_on(&l->light) && l->step > warmup ? l->step - warmup : 0;
}

/* Gaussians inside the cell. */
static enum err_code level_count_inside(const struct level *l, size_t *out, struct err *e)
{
    const struct render_model *m = &l->model;
    size_t n = 0, bytes = permute_floats(m->n, m->planes) * sizeof(float);
    void *params = NULL;
    enum err_code rc = dev_map(l->dev, m->params, CL_MAP_READ, bytes, &params, e);
    if (rc)
        return rc;
    for (size_t i = 0; i < m->n; i++) {
        const float *mean = (const float *)params + permute_at(i, m->planes);
        n += cell_distance(&l->cell, m->origin_enu_m[0] + (double)mean[0],
                           m->origin_enu_m[1] + (double)mean[LAYOUT_LANES]) <= 0.0;
    }
    *out = n;
    return dev_unmap(l->dev, m->params, &params, e);
}

enum err_code level_reserve(struct level *l, const struct gauss *like, struct err *e)
{
    size_t cap = level_room(l, like->n);
    struct render_model *m = &l->model;
    if (cap > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu Gaussians are more than the renderer counts", like->n);
    m->sh_degree = like->sh_degree;
    m->embed_len = like->embed_len;
    m->planes = render_planes_embed(like->sh_degree, like->embed_len);
    memcpy(m->origin_enu_m, like->origin_enu_m, sizeof(m->origin_enu_m));
    m->cap = (uint32_t)cap;
    level_count(l, like->n);
    cl_mem *parts[] = {&m->params, &l->adam.m1, &l->adam.m2};
    size_t bytes = permute_floats(cap, m->planes) * sizeof(float);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 3; i++)
        rc = dev_buffer(l->dev, bytes, NULL, parts[i], e);
    if (!rc)
        rc = dev_buffer(l->dev, sizeof(uint32_t), NULL, &l->stats.repaired, e);
    if (!rc)
        rc = dev_zero(l->dev, l->stats.repaired, 0, sizeof(uint32_t), e);
    if (!rc)
        rc = level_zero_stats(l, e);
    level_start_optimiser(l);
    return rc ? err_add(e, "training %zu Gaussians", like->n) : ERR_OK;
}

static enum err_code level_zero_moments(struct level *l, struct err *e)
{
    size_t bytes = permute_floats(l->model.n, l->model.planes) * sizeof(float);
    enum err_code rc = dev_zero(l->dev, l->adam.m1, 0, bytes, e);
    return rc ? rc : dev_zero(l->dev, l->adam.m2, 0, bytes, e);
}

enum err_code level_open(struct level *l, const struct gauss *g, struct err *e)
{
    enum err_code rc = level_reserve(l, g, e);
    if (!rc)
        rc = render_model_write(l->render, &l->model, 0, g, e);
    if (!rc)
        rc = level_zero_moments(l, e);
    return rc ? rc : level_count_inside(l, &l->start, e);
}

void level_close(struct level *l)
{
    level_release(l);
    dev_release(&l->stats.repaired);
    dev_release(&l->target);
    dev_release(&l->mask);
    photo_loader_close(&l->feed);
    budget_close(&l->budget);
    importance_free(&l->score);
    regularizer_free(&l->regular);
    appearance_train_close(&l->light);
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
    struct photo_loader_config f = {
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
    photo_loader_close(&l->feed);
    level_start_optimiser(l);
    l->loss_mean = l->mse_mean = 0.0;
    l->step_s = clock_s();
    return photo_loader_open(&f, &l->feed, e);
}

enum err_code level_next(struct level *l, struct err *e)
{
    enum err_code rc = level_count_inside(l, &l->start, e);
    if (rc)
        return rc;
    l->at++;
    l->step = 0;
    l->pruned = false;
    budget_close(&l->budget);
    l->budget.at = (struct budget_point){0};
    l->filter_is_current = false;
    appearance_train_restart(&l->light);
    rc = level_zero_moments(l, e);
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

/* What follows some steps. The device finishes the step before the clock turns. */
static enum err_code level_control(struct level *l, uint32_t x, struct err *e)
{
    enum err_code rc = dev_finish(l->dev, e);
    enum timing_on was = timing_turn(&l->spent, TIMING_BUDGET);
    if (!rc && x)
        rc = budget_look(l, x, e);
    (void)timing_turn(&l->spent, TIMING_DENSIFY);
    if (!rc && x)
        rc = densify_apply(l, x, e);
    if (!rc && schedule_resets(level_schedule(l), l->step))
        rc = densify_reset_opacity(l, e);
    (void)timing_turn(&l->spent, was);
    return rc;
}

/* ---- a step ---- */

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

static enum err_code level_upload_photo(struct level *l, const struct photo *p, struct err *e)
{
    size_t bytes = (size_t)p->cam.width_px * p->cam.height_px * 3;
    return level_upload(l, &l->target, &l->target_bytes, p->px, bytes, e);
}

/* The photograph's mask, and in a run with robust weighting the pixels that do not fit. Leaves
 * *mask NULL when all pixels count. */
static enum err_code level_upload_mask(struct level *l, const struct photo *p, cl_mem *mask,
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
        robust_mask(color, p->px, p->cam.width_px, p->cam.height_px, color + 3 * n, use);
    if (!rc)
        rc = level_upload(l, &l->mask, &l->mask_bytes, use, n, e);
    *mask = rc ? NULL : l->mask;
    mem_free(use);
    mem_free(color);
    return rc;
}

static enum err_code level_loss(struct level *l, const struct photo *p, bool value_only,
                                struct err *e)
{
    struct photometric_input in = {
        .value_only = value_only,
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
    if (rc)
        return rc;
    return photometric_run(l->loss, &in, value_only ? NULL : render_color_grad_buffer(l->render),
                           e);
}

enum err_code level_photo_loss(struct level *l, const struct photo *p, struct err *e)
{
    return level_loss(l, p, false, e);
}

enum err_code level_photo_value(struct level *l, const struct photo *p, struct err *e)
{
    return level_loss(l, p, true, e);
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

static enum err_code level_read_loss(struct level *l, struct photometric_value *v, struct err *e)
{
    enum err_code rc = photometric_read(l->loss, v, e);
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
        .frame = appearance_train_learns(&l->light, l->cfg, s) ? l->light.frame_grad : NULL};
    l->adam.lr_embed = (float)appearance_train_lr(&l->light, l->cfg, s, step);
    l->adam.embed_step = step - appearance_train_warmup(&l->light, l->cfg, s);
    l->adam.appearance = grad;
}

/* The step's gradient of the frame's constants moves the network and the photograph. */
static void level_learn_light(struct level *l, uint32_t image)
{
    const struct render_appearance_grad *grad = l->adam.appearance;
    l->offset_mean = grad->offset_mean;
    if (grad->frame)
        appearance_train_update(&l->light, image, (double)l->adam.lr_embed);
    l->adam.appearance = NULL; /* it lives in the step's frame */
}

enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e)
{
    const struct schedule *s = level_schedule(l);
    uint32_t step = l->step + 1;
    struct photo photo;
    enum timing_on was = timing_turn(&l->spent, TIMING_PHOTOGRAPHS);
    enum err_code rc = photo_loader_get(l->feed, step, &photo, e);
    (void)timing_turn(&l->spent, was);
    if (rc)
        return rc;
    struct render_options ro = level_photo_options(l, step, photo.image);
    rc = regularizer_step(l, step, &photo, e);
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
