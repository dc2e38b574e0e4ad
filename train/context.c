/* What is the same for everybody who draws a training photograph and compares it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/context.h"

#include <math.h>
#include <string.h>

#include "cells/footprint.h"
#include "codec/scene.h"
#include "loss/photometric.h"
#include "loss/robust.h"
#include "train/model.h"
#include "train/photo_loader.h"

#define CONTEXT_NEAR_SHARE 1000.0 /* near planes in a cell's edge */
#define CONTEXT_SPACING_PX 2.0

void context_close(struct context *ctx)
{
    dev_release(&ctx->target);
    dev_release(&ctx->mask);
    photo_loader_close(&ctx->photos);
    appearance_train_close(&ctx->appearance);
    pose_free(&ctx->poses);
}

double context_seconds(const struct context *ctx)
{
    return ctx->before_s + clock_s() - ctx->start_s;
}

const struct schedule *context_schedule(const struct context *ctx)
{
    return &ctx->schedule[ctx->at < ctx->n_levels ? ctx->at : ctx->n_levels - 1];
}

size_t context_most(const struct context *ctx)
{
    const struct schedule *s = context_schedule(ctx);
    return s->budget + (ctx->cell.whole ? 0 : schedule_cap_outside(s));
}

/* ---- how frames are drawn ---- */

double context_size_limit(const struct context *ctx)
{
    const struct schedule *s = context_schedule(ctx);
    if (!(ctx->cfg->size_limit > 0.0) || !ctx->ground || !ctx->ground->nx)
        return 0.0;
    const struct camera *full = &ctx->scene->images[ctx->images[0]].cam;
    struct camera cam = photo_loader_camera(full, (uint32_t)ctx->cfg->max_edge_px, s->downsample);
    double px_per_m = ctx->ground->px_per_m * cam.fx_px / full->fx_px;
    return ctx->cfg->size_limit *
           fmax(ctx->cell.edge_m / sqrt((double)s->budget), CONTEXT_SPACING_PX / px_per_m);
}

struct render_options context_render_options(const struct context *ctx, uint32_t step)
{
    const struct train_config *c = ctx->cfg;
    float grey = (float)c->background;
    return (struct render_options){
        .aa = (enum render_aa)c->aa,
        .background = {grey, grey, grey},
        .near_m = c->near_m > 0.0 ? c->near_m
                                  : fmax(RENDER_NEAR_M, ctx->cell.edge_m / CONTEXT_NEAR_SHARE),
        .sh_degree = (int)schedule_sh_degree(context_schedule(ctx), step),
    };
}

struct render_options context_photo_options(struct context *ctx, uint32_t step, uint32_t image)
{
    struct appearance_train *a = &ctx->appearance;
    struct render_options ro = context_render_options(ctx, step);
    if (appearance_train_is_on(a) &&
        step > appearance_train_warmup(a, ctx->cfg, context_schedule(ctx)))
        ro.appearance_frame = appearance_train_frame(a, image);
    ro.appearance_hidden = a->model.hidden;
    return ro;
}

enum err_code context_filter(const struct context *ctx, struct model *m, struct err *e)
{
    if (ctx->cfg->aa != RENDER_AA_MIP || m->filter_is_current || ctx->at >= ctx->n_levels)
        return ERR_OK;
    struct camera *cams = mem_array(ctx->n_images, sizeof *cams);
    if (!cams)
        return err_set(e, ERR_MEM, "mip: out of memory for %zu cameras", ctx->n_images);
    for (size_t i = 0; i < ctx->n_images; i++) {
        cams[i] =
            photo_loader_camera(&ctx->scene->images[ctx->images[i]].cam,
                                (uint32_t)ctx->cfg->max_edge_px, context_schedule(ctx)->downsample);
        pose_apply(&ctx->poses, ctx->images[i], &cams[i]);
    }
    enum err_code rc = model_filter(m, cams, ctx->n_images, e);
    mem_free(cams);
    return rc;
}

/* ---- comparing a frame with its photograph ---- */

static enum err_code context_upload(struct context *ctx, cl_mem *to, size_t *room, const void *from,
                                    size_t bytes, struct err *e)
{
    if (bytes > *room) {
        dev_release(to);
        *room = 0;
        enum err_code rc = dev_buffer(ctx->dev, bytes, NULL, to, e);
        if (rc)
            return rc;
        *room = bytes;
    }
    return dev_write(ctx->dev, *to, 0, bytes, from, e);
}

/* The photograph's mask, and in a run with robust weighting the pixels that do not fit. Leaves
 * *mask NULL when all pixels count. */
static enum err_code context_upload_mask(struct context *ctx, const struct photo *p, cl_mem *mask,
                                         struct err *e)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px;
    bool robust = ctx->cfg->robust_from > 0 && ctx->step + 1 >= (uint32_t)ctx->cfg->robust_from;
    *mask = NULL;
    if (!p->mask && !robust)
        return ERR_OK;
    uint8_t *use = mem_array(n, 1);
    float *color = robust ? mem_array(4 * n, sizeof(float)) : NULL;
    enum err_code rc = use && (color || !robust)
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "%s: out of memory for its mask", p->name);
    if (!rc && p->mask)
        memcpy(use, p->mask, n);
    else if (!rc)
        memset(use, 255, n);
    if (!rc && robust)
        rc = dev_read(ctx->dev, render_color_buffer(ctx->render), 0, 3 * n * sizeof(float), color,
                      e);
    if (!rc && robust)
        robust_mask(color, p->px, p->cam.width_px, p->cam.height_px, color + 3 * n, use);
    if (!rc)
        rc = context_upload(ctx, &ctx->mask, &ctx->mask_bytes, use, n, e);
    *mask = rc ? NULL : ctx->mask;
    mem_free(use);
    mem_free(color);
    return rc;
}

static enum err_code context_loss(struct context *ctx, const struct photo *p, bool value_only,
                                  struct err *e)
{
    struct photometric_input in = {
        .value_only = value_only,
        .color = render_color_buffer(ctx->render),
        .width_px = p->cam.width_px,
        .height_px = p->cam.height_px,
        .l1_weight = (float)ctx->cfg->l1_weight,
        .ssim_weight = (float)ctx->cfg->ssim_weight,
    };
    size_t bytes = (size_t)p->cam.width_px * p->cam.height_px * 3;
    enum err_code rc = context_upload(ctx, &ctx->target, &ctx->target_bytes, p->px, bytes, e);
    in.target = ctx->target;
    if (!rc)
        rc = context_upload_mask(ctx, p, &in.mask, e);
    return rc ? rc
              : photometric_run(ctx->loss, &in,
                                value_only ? NULL : render_color_grad_buffer(ctx->render), e);
}

enum err_code context_photo_loss(struct context *ctx, const struct photo *p, struct err *e)
{
    return context_loss(ctx, p, false, e);
}

enum err_code context_photo_value(struct context *ctx, const struct photo *p, struct err *e)
{
    return context_loss(ctx, p, true, e);
}
