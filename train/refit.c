/* Coarser levels take over the appearance network of the finest one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/refit.h"

#include <math.h>

#include "codec/ckpt.h"
#include "train/appearance_train.h"
#include "train/importance.h"
#include "train/level.h"
#include "train/regularizer.h"
#include "train/state.h"

bool refit_wanted(const struct level *l)
{
    const struct context *ctx = &l->ctx;
    return appearance_train_is_on(&ctx->appearance) && !ctx->appearance.shared &&
           ctx->n_levels > 1 &&
           appearance_train_learns(&ctx->appearance, ctx->cfg, &ctx->schedule[1]);
}

/* Has the level another network than there is now? */
static enum err_code refit_look(const struct context *ctx, const struct ckpt_rows *c, bool *needed,
                                struct err *e)
{
    struct buf blob = {0};
    struct appearance saved = {0};
    enum err_code rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &blob, e);
    if (!rc)
        rc = appearance_read(blob.data, blob.size, &saved, e);
    *needed = !rc && !appearance_train_same(&saved, &ctx->appearance.model);
    appearance_free(&saved);
    buf_free(&blob);
    return rc;
}

/* The level's Gaussians instead of those there are; no more room than for them. */
static enum err_code refit_load(struct level *l, const struct ckpt_rows *c, struct err *e)
{
    struct context *ctx = &l->ctx;
    importance_free(&l->importance); /* made anew where needed, for as many as there are */
    regularizer_free(&l->regularizer);
    model_close(&l->model);
    enum err_code rc =
        model_open(&l->model, ctx->dev, ctx->render, ckpt_rows_like(c), ckpt_rows_count(c), e);
    if (!rc)
        rc = state_fill_rows(&l->model, c, e);
    if (!rc)
        rc = model_zero_moments(&l->model, e);
    return rc ? rc : model_count_inside(&l->model, &ctx->cell, &ctx->start, e);
}

/* A part of the level's steps, in which nothing moves, nothing grows, and nothing is reset. */
static void refit_schedule(const struct context *ctx, struct schedule *s)
{
    double steps = floor((double)s->steps * ctx->cfg->appearance_refit + 0.5);
    s->steps = steps >= 1.0 ? (uint32_t)steps : 1;
    s->densify_until = 0;
    s->reset_interval = s->steps + 1;
    s->sh_interval = 0;
    s->lr_mean_first = s->lr_mean_last = 0.0;
}

static enum err_code refit_begin(struct level *l, uint32_t at, const struct ckpt_rows *c,
                                 struct err *e)
{
    struct context *ctx = &l->ctx;
    ctx->at = at;
    ctx->step = 0;
    ctx->pruned = true;
    ctx->appearance.shared = true;
    refit_schedule(ctx, &ctx->schedule[at]);
    appearance_train_restart(&ctx->appearance);
    enum err_code rc = refit_load(l, c, e);
    if (!rc)
        rc = level_begin(l, e);
    l->model.adam.lr_scale = l->model.adam.lr_quat = l->model.adam.lr_opacity = 0.0f;
    return rc;
}

enum err_code refit_open(struct refit *r, struct level *l, uint32_t at, const char *path,
                         struct err *e)
{
    struct ckpt_rows *c = NULL;
    *r = (struct refit){.was = l->ctx.schedule[at], .was_shared = l->ctx.appearance.shared};
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = refit_look(&l->ctx, c, &r->needed, e);
    if (!rc && r->needed)
        rc = refit_begin(l, at, c, e);
    ckpt_rows_close(&c);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

void refit_end(struct refit *r, struct level *l)
{
    struct context *ctx = &l->ctx;
    if (!r->needed)
        return;
    ctx->schedule[ctx->at] = r->was;
    ctx->step = r->was.steps;
    ctx->appearance.shared = r->was_shared;
}
