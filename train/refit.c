/* Coarser levels take over the appearance network of the finest one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/refit.h"

#include <math.h>

#include "codec/ckpt.h"
#include "train/appearance_train.h"
#include "train/level.h"

bool refit_wanted(const struct level *l)
{
    const struct context *ctx = &l->ctx;
    return appearance_train_is_on(&ctx->appearance) && !ctx->appearance.shared &&
           ctx->n_levels > 1 &&
           appearance_train_learns(&ctx->appearance, ctx->cfg, &ctx->schedule[1]);
}

/* The level's Gaussians, unless it has the network that there is now. */
static enum err_code refit_read(const struct context *ctx, const char *path, struct gauss *g,
                                bool *needed, struct err *e)
{
    struct ckpt_rows *c = NULL;
    struct buf blob = {0};
    struct appearance saved = {0};
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &blob, e);
    if (!rc)
        rc = appearance_read(blob.data, blob.size, &saved, e);
    *needed = !rc && !appearance_train_same(&saved, &ctx->appearance.model);
    if (*needed)
        rc = ckpt_rows_read(c, 0, ckpt_rows_count(c), g, e);
    appearance_free(&saved);
    buf_free(&blob);
    ckpt_rows_close(&c);
    return rc ? err_add(e, "%s", path) : ERR_OK;
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

enum err_code refit_open(struct refit *r, struct level *l, uint32_t at, const char *path,
                         struct err *e)
{
    struct context *ctx = &l->ctx;
    struct gauss g = {0};
    *r = (struct refit){.was = ctx->schedule[at], .was_shared = ctx->appearance.shared};
    enum err_code rc = refit_read(ctx, path, &g, &r->needed, e);
    if (rc || !r->needed) {
        gauss_free(&g);
        return rc;
    }
    model_close(&l->model);
    ctx->at = at;
    ctx->step = 0;
    ctx->pruned = true;
    ctx->appearance.shared = true;
    refit_schedule(ctx, &ctx->schedule[at]);
    appearance_train_restart(&ctx->appearance);
    rc = level_open(l, &g, e);
    gauss_free(&g);
    if (!rc)
        rc = level_begin(l, e);
    l->model.adam.lr_scale = l->model.adam.lr_quat = l->model.adam.lr_opacity = 0.0f;
    return rc;
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
