/* What the configuration asks of a step besides its photograph: which regularizers act, with what
 * weight, and the buffer in which their gradients meet.
 *
 * The scale regularizer writes the whole buffer, the others add to it; without it the buffer is
 * cleared. Owns everything behind struct regularizer; level.c calls regularizer_step before each
 * step and regularizer_free at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/regularizer.h"

#include <math.h>
#include <string.h>

#include "cells/footprint.h"
#include "codec/scene.h"
#include "core/layout.h"
#include "loss/depth.h"
#include "loss/depth_map.h"
#include "loss/embed_smoothness.h"
#include "loss/mcmc.h"
#include "loss/scale_loss.h"
#include "train/config.h"
#include "train/context.h"
#include "train/densify_plan.h"
#include "train/model.h"
#include "train/photo_loader.h"

#define REGULARIZER_SIZE_OF_CELL 0.1 /* largest size where none is configured, in cell edges */
/* A limit of size below the size at which Gaussians are split would keep them from being split. */
#define REGULARIZER_SPLIT_ROOM 1.5
#define REGULARIZER_MCMC 0.01 /* weights of 3DGS-MCMC */
enum { REGULARIZER_FILTER_STEPS = 100, REGULARIZER_PLANES = 11 };
enum {
    REGULARIZER_PASS_BOTH,
    REGULARIZER_PASS_SOFT,
    REGULARIZER_PASS_HARD
}; /* option depth_pass */

struct regularizer {
    struct scale_loss *scale;
    struct mcmc *mcmc;
    struct depth *depth;
    struct depth_map *maps;
    struct embed_smoothness_step *smoothness;
    cl_mem extra; /* float [groups][11][16] */
    size_t groups;
};

void regularizer_free(struct regularizer **p)
{
    struct regularizer *r = *p;
    if (!r)
        return;
    scale_loss_close(&r->scale);
    mcmc_close(&r->mcmc);
    depth_close(&r->depth);
    depth_map_close(&r->maps);
    embed_smoothness_step_close(&r->smoothness);
    dev_release(&r->extra);
    mem_free(r);
    *p = NULL;
}

static enum err_code regularizer_make(struct regularizer **own, struct err *e)
{
    if (!*own)
        *own = mem_array(1, sizeof **own);
    if (*own)
        return ERR_OK;
    (void)err_set(e, ERR_MEM, "regularizers: out of memory");
    return ERR_MEM;
}

static enum err_code regularizer_reserve(struct regularizer *r, const struct model *m,
                                         struct err *e)
{
    size_t groups = m->gauss.cap / LAYOUT_LANES;
    if (r->extra && r->groups >= groups)
        return ERR_OK;
    dev_release(&r->extra);
    r->groups = 0;
    enum err_code rc = dev_buffer(
        m->dev, groups * REGULARIZER_PLANES * LAYOUT_LANES * sizeof(float), NULL, &r->extra, e);
    if (rc)
        return err_add(e, "regularizers of %u Gaussians", m->gauss.n);
    r->groups = groups;
    return ERR_OK;
}

static enum err_code regularizer_clear(struct regularizer *r, const struct model *m, struct err *e)
{
    size_t floats = (size_t)m->gauss.groups * REGULARIZER_PLANES * LAYOUT_LANES;
    return dev_zero(m->dev, r->extra, 0, floats * sizeof(float), e);
}

/* From the first opacity reset and one densification after it; later levels go on with it. */
static bool regularizer_scale_acts(const struct context *ctx, uint32_t step)
{
    const struct schedule *s = context_schedule(ctx);
    double from = s->level == 1 ? (double)ctx->cfg->scale_from * s->kappa : 0.0;
    return ctx->cfg->scale_weight > 0.0 && (double)step > from;
}

static enum err_code regularizer_scale(struct regularizer *r, const struct model *m,
                                       const struct context *ctx, struct err *e)
{
    const struct train_config *c = ctx->cfg;
    double size =
        c->scale_max_m > 0.0 ? c->scale_max_m : REGULARIZER_SIZE_OF_CELL * ctx->cell.edge_m;
    struct scale_loss_input in = {
        .s_max_m = fmax(size, REGULARIZER_SPLIT_ROOM * c->percent_dense * ctx->cell.extent_m),
        .r_max = c->scale_ratio_max,
        .weight = c->scale_weight,
    };
    struct scale_loss_ground ground = {.s_max_m = context_size_limit(ctx)};
    if (ground.s_max_m > 0.0) {
        const struct footprint *f = ctx->ground;
        ground.inside = f->inside;
        ground.nx = f->nx;
        ground.ny = f->ny;
        ground.cell_m = f->cell_m;
        memcpy(ground.corner_m, f->corner_m, sizeof ground.corner_m);
        in.ground = &ground;
    }
    enum err_code rc = r->scale ? ERR_OK : scale_loss_open(ctx->dev, &r->scale, e);
    return rc ? rc : scale_loss_run(r->scale, &m->gauss, &in, m->adam.extra_sizes, r->extra, e);
}

/* What an option of -1 means. */
static double regularizer_pull_weight(const struct train_config *c, double given)
{
    return given >= 0.0 ? given : c->strategy == DENSIFY_STRATEGY_MCMC ? REGULARIZER_MCMC : 0.0;
}

static struct mcmc_pull regularizer_pull_of(const struct context *ctx)
{
    const struct train_config *c = ctx->cfg;
    return (struct mcmc_pull){.opacity_weight = regularizer_pull_weight(c, c->opacity_weight),
                              .size_weight = regularizer_pull_weight(c, c->size_weight),
                              .unit_m = ctx->cell.extent_m};
}

static enum err_code regularizer_pull(struct regularizer *r, const struct model *m,
                                      const struct mcmc_pull *in, struct err *e)
{
    enum err_code rc = r->mcmc ? ERR_OK : mcmc_open(m->dev, &r->mcmc, e);
    return rc ? rc : mcmc_pull_run(r->mcmc, &m->gauss, in, r->extra, e);
}

enum err_code regularizer_shake(struct regularizer **own, const struct model *m,
                                const struct context *ctx, uint32_t step, struct err *e)
{
    const struct train_config *c = ctx->cfg;
    if (c->strategy != DENSIFY_STRATEGY_MCMC || !(c->noise > 0.0))
        return ERR_OK;
    double unit_m = ctx->cell.extent_m;
    struct mcmc_noise in = {.rate_per_m = c->noise * schedule_lr_mean(context_schedule(ctx), step) /
                                          (unit_m * unit_m),
                            .seed = (uint64_t)c->seed,
                            .stream = train_stream(TRAIN_STREAM_NOISE, ctx->at + 1, step)};
    enum err_code rc = regularizer_make(own, e);
    if (!rc && !(*own)->mcmc)
        rc = mcmc_open(m->dev, &(*own)->mcmc, e);
    return rc ? rc : mcmc_noise_run((*own)->mcmc, &m->gauss, &in, e);
}

static bool regularizer_depth_acts(const struct context *ctx, uint32_t step)
{
    const struct train_config *c = ctx->cfg;
    return (c->depth_dir || c->depth_sparse) && c->depth_weight > 0.0 &&
           step % (uint32_t)c->depth_interval == 0;
}

static enum err_code regularizer_depth_open(struct regularizer *r, const struct context *ctx,
                                            struct err *e)
{
    struct depth_map_config maps = {.scene = ctx->scene,
                                    .images = ctx->images,
                                    .n_images = ctx->n_images,
                                    .dir = ctx->cfg->depth_dir,
                                    .sparse = ctx->cfg->depth_sparse};
    enum err_code rc = r->maps ? ERR_OK : depth_map_open(&maps, &r->maps, e);
    return rc || r->depth ? rc : depth_open(ctx->dev, &r->depth, e);
}

/* From depth_weight down to depth_weight_final over the level, exponentially. */
static double regularizer_depth_weight(const struct context *ctx, uint32_t step)
{
    const struct train_config *c = ctx->cfg;
    double t = fmin((double)step / (double)context_schedule(ctx)->steps, 1.0);
    if (!(c->depth_weight_final > 0.0))
        return c->depth_weight * (1.0 - t);
    return c->depth_weight * pow(c->depth_weight_final / c->depth_weight, t);
}

static enum err_code regularizer_depth(struct regularizer *r, const struct model *m,
                                       const struct context *ctx, uint32_t step,
                                       const struct photo *photo, struct err *e)
{
    struct depth_target target = {0};
    enum err_code rc = regularizer_depth_open(r, ctx, e);
    if (!rc)
        rc = depth_map_target(r->maps, photo->image, &photo->cam, photo->mask, &target, e);
    if (rc || !target.n_known)
        return rc;
    uint32_t turn = step / (uint32_t)ctx->cfg->depth_interval;
    struct depth_input in = {
        .cam = &photo->cam,
        .options = context_render_options(ctx, step),
        .target = target.t,
        .unit_m = target.unit_m,
        .n_known = target.n_known,
        .weight = regularizer_depth_weight(ctx, step),
        .hard = ctx->cfg->depth_pass == REGULARIZER_PASS_HARD ||
                (ctx->cfg->depth_pass == REGULARIZER_PASS_BOTH && turn % 2),
    };
    return depth_run(r->depth, ctx->render, &m->gauss, &in, r->extra, e);
}

/* From the first frame with appearance on; before, embeddings do not step. */
static bool regularizer_smoothness_acts(const struct context *ctx, uint32_t step)
{
    return ctx->cfg->embed_smoothness_weight > 0.0 && appearance_train_is_on(&ctx->appearance) &&
           step > appearance_train_warmup(&ctx->appearance, ctx->cfg, context_schedule(ctx)) &&
           step % (uint32_t)ctx->cfg->embed_smoothness_interval == 0;
}

static enum err_code regularizer_smoothness(struct regularizer *r, struct model *m,
                                            const struct context *ctx, uint32_t step, struct err *e)
{
    struct embed_smoothness_input in = {
        .samples = (size_t)ctx->cfg->embed_smoothness_samples,
        .neighbours = (size_t)ctx->cfg->embed_smoothness_neighbours,
        .falloff = ctx->cfg->embed_smoothness_falloff / (ctx->cell.edge_m * ctx->cell.edge_m),
        .weight = ctx->cfg->embed_smoothness_weight,
        .seed = (uint64_t)ctx->cfg->seed,
        .stream = train_stream(TRAIN_STREAM_SIMILARITY, ctx->at + 1, step),
    };
    double loss;
    enum err_code rc =
        r->smoothness ? ERR_OK : embed_smoothness_step_open(m->dev, &r->smoothness, e);
    return rc ? rc : embed_smoothness_step_run(r->smoothness, &m->gauss, &m->adam, &in, &loss, e);
}

enum err_code regularizer_step(struct regularizer **own, struct model *m, struct context *ctx,
                               uint32_t step, const struct photo *photo, struct err *e)
{
    bool scale = regularizer_scale_acts(ctx, step), depth = regularizer_depth_acts(ctx, step);
    bool smoothness = regularizer_smoothness_acts(ctx, step);
    if (step % REGULARIZER_FILTER_STEPS == 0)
        m->filter_is_current = false;
    m->adam.extra_grad = NULL;
    enum err_code rc = context_filter(ctx, m, e);
    struct mcmc_pull pull = regularizer_pull_of(ctx);
    bool pulls = pull.opacity_weight > 0.0 || pull.size_weight > 0.0;
    if (rc || (!scale && !depth && !smoothness && !pulls))
        return rc;
    rc = regularizer_make(own, e);
    if (!rc && smoothness) {
        rc = dev_finish(ctx->dev, e); /* what follows shall not pay for the last step */
        enum timing_on was = timing_turn(&ctx->timing, TIMING_EMBED_SMOOTHNESS);
        if (!rc)
            rc = regularizer_smoothness(*own, m, ctx, step, e);
        (void)timing_turn(&ctx->timing, was);
    }
    if (rc || (!scale && !depth && !pulls))
        return rc;
    rc = regularizer_reserve(*own, m, e);
    m->adam.extra_sizes = scale && !depth && !pulls; /* fewer planes to pass through memory */
    if (!rc && scale)
        rc = regularizer_scale(*own, m, ctx, e);
    else if (!rc)
        rc = regularizer_clear(*own, m, e);
    if (!rc && pulls)
        rc = regularizer_pull(*own, m, &pull, e);
    if (!rc && depth)
        rc = regularizer_depth(*own, m, ctx, step, photo, e);
    if (!rc)
        m->adam.extra_grad = (*own)->extra;
    return rc;
}
