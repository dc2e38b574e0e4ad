/* Which regularizers act at a step, with what weight, and the buffer that sums their gradients.
 *
 * The scale regularizer writes the whole buffer, and the others add to it. Without the scale
 * regularizer the buffer is cleared first. To add a term: a function that says whether the term
 * acts at this step, a function that adds its gradient to the buffer, and a line for each in
 * regularizer_step.
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
#include "train/appearance_train.h"
#include "train/config.h"
#include "train/densify_plan.h"
#include "train/gallery.h"
#include "train/model.h"
#include "train/photo_loader.h"
#include "train/stage.h"
#include "train/timing.h"

#define REGULARIZER_SIZE_OF_CELL 0.1 /* largest size where none is configured, in cell edges */
/* A limit of size below the size at which Gaussians are split would keep them from being split. */
#define REGULARIZER_SPLIT_ROOM 1.5
#define REGULARIZER_MCMC 0.01 /* weights of 3DGS-MCMC */
enum { REGULARIZER_PLANES = 11 };
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
static bool regularizer_scale_acts(const struct train_config *c, const struct stage *at)
{
    const struct schedule *s = stage_schedule(at);
    double from = s->level == 1 ? (double)c->scale_from * s->kappa : 0.0;
    return c->scale_weight > 0.0 && (double)at->step > from;
}

static enum err_code regularizer_scale(struct regularizer *r, const struct model *m,
                                       const struct regularizer_input *in, struct err *e)
{
    const struct train_config *c = in->gallery->cfg;
    const struct cell *cell = &in->site->cell;
    double size = c->scale_max_m > 0.0 ? c->scale_max_m : REGULARIZER_SIZE_OF_CELL * cell->edge_m;
    struct scale_loss_input loss = {
        .s_max_m = fmax(size, REGULARIZER_SPLIT_ROOM * c->percent_dense * cell->extent_m),
        .r_max = c->scale_ratio_max,
        .weight = c->scale_weight,
    };
    struct scale_loss_ground ground = {
        .s_max_m = gallery_size_limit(in->gallery, in->site, stage_schedule(in->at))};
    if (ground.s_max_m > 0.0) {
        const struct footprint *f = in->site->ground;
        ground.inside = f->inside;
        ground.nx = f->nx;
        ground.ny = f->ny;
        ground.cell_m = f->cell_m;
        memcpy(ground.corner_m, f->corner_m, sizeof ground.corner_m);
        loss.ground = &ground;
    }
    enum err_code rc = r->scale ? ERR_OK : scale_loss_open(m->dev, &r->scale, e);
    return rc ? rc : scale_loss_run(r->scale, &m->gauss, &loss, m->adam.extra_sizes, r->extra, e);
}

/* What an option of -1 means. */
static double regularizer_pull_weight(const struct train_config *c, double given)
{
    return given >= 0.0 ? given : c->strategy == DENSIFY_STRATEGY_MCMC ? REGULARIZER_MCMC : 0.0;
}

static struct mcmc_pull regularizer_pull_of(const struct train_config *c, const struct cell *cell)
{
    return (struct mcmc_pull){.opacity_weight = regularizer_pull_weight(c, c->opacity_weight),
                              .size_weight = regularizer_pull_weight(c, c->size_weight),
                              .unit_m = cell->extent_m};
}

static enum err_code regularizer_pull(struct regularizer *r, const struct model *m,
                                      const struct mcmc_pull *in, struct err *e)
{
    enum err_code rc = r->mcmc ? ERR_OK : mcmc_open(m->dev, &r->mcmc, e);
    return rc ? rc : mcmc_pull_run(r->mcmc, &m->gauss, in, r->extra, e);
}

enum err_code regularizer_shake(struct regularizer **own, const struct model *m,
                                const struct train_config *c, const struct cell *cell,
                                const struct stage *at, struct err *e)
{
    if (c->strategy != DENSIFY_STRATEGY_MCMC || !(c->noise > 0.0))
        return ERR_OK;
    double unit_m = cell->extent_m;
    struct mcmc_noise in = {
        .rate_per_m = c->noise * schedule_lr_mean(stage_schedule(at), at->step) / (unit_m * unit_m),
        .seed = (uint64_t)c->seed,
        .stream = train_stream(TRAIN_STREAM_NOISE, at->at + 1, at->step)};
    enum err_code rc = regularizer_make(own, e);
    if (!rc && !(*own)->mcmc)
        rc = mcmc_open(m->dev, &(*own)->mcmc, e);
    return rc ? rc : mcmc_noise_run((*own)->mcmc, &m->gauss, &in, e);
}

static bool regularizer_depth_acts(const struct train_config *c, uint32_t step)
{
    return (c->depth_dir || c->depth_sparse) && c->depth_weight > 0.0 &&
           step % (uint32_t)c->depth_interval == 0;
}

static enum err_code regularizer_depth_open(struct regularizer *r, const struct gallery *g,
                                            struct err *e)
{
    struct depth_map_config maps = {.scene = g->scene,
                                    .images = g->images,
                                    .n_images = g->n_images,
                                    .dir = g->cfg->depth_dir,
                                    .sparse = g->cfg->depth_sparse};
    enum err_code rc = r->maps ? ERR_OK : depth_map_open(&maps, &r->maps, e);
    return rc || r->depth ? rc : depth_open(g->engine.dev, &r->depth, e);
}

/* From depth_weight down to depth_weight_final over the level, exponentially. */
static double regularizer_depth_weight(const struct train_config *c, const struct stage *at)
{
    double t = fmin((double)at->step / (double)stage_schedule(at)->steps, 1.0);
    if (!(c->depth_weight_final > 0.0))
        return c->depth_weight * (1.0 - t);
    return c->depth_weight * pow(c->depth_weight_final / c->depth_weight, t);
}

static enum err_code regularizer_depth(struct regularizer *r, const struct model *m,
                                       const struct regularizer_input *in, struct err *e)
{
    const struct train_config *c = in->gallery->cfg;
    const struct photo *photo = in->photo;
    struct depth_target target = {0};
    enum err_code rc = regularizer_depth_open(r, in->gallery, e);
    if (!rc)
        rc = depth_map_target(r->maps, photo->image, &photo->cam, photo->mask, &target, e);
    if (rc || !target.n_known)
        return rc;
    uint32_t turn = in->at->step / (uint32_t)c->depth_interval;
    struct depth_input depth = {
        .cam = &photo->cam,
        .options = gallery_options(in->gallery, in->at),
        .target = target.t,
        .unit_m = target.unit_m,
        .n_known = target.n_known,
        .weight = regularizer_depth_weight(c, in->at),
        .hard = c->depth_pass == REGULARIZER_PASS_HARD ||
                (c->depth_pass == REGULARIZER_PASS_BOTH && turn % 2),
    };
    return depth_run(r->depth, m->render, &m->gauss, &depth, r->extra, e);
}

/* From the first frame with appearance on; before, embeddings do not step. */
static bool regularizer_smoothness_acts(const struct gallery *g, const struct stage *at)
{
    const struct train_config *c = g->cfg;
    return c->embed_smoothness_weight > 0.0 && appearance_train_is_on(g->appearance) &&
           at->step > appearance_train_warmup(g->appearance, c, stage_schedule(at)) &&
           at->step % (uint32_t)c->embed_smoothness_interval == 0;
}

/* Steps the embeddings at once. The device finishes first: this part shall not pay for the step
 * before it. */
static enum err_code regularizer_smoothness(struct regularizer *r, struct model *m,
                                            const struct regularizer_input *in, struct err *e)
{
    const struct train_config *c = in->gallery->cfg;
    double edge_m = in->site->cell.edge_m, loss;
    struct embed_smoothness_input pairs = {
        .samples = (size_t)c->embed_smoothness_samples,
        .neighbours = (size_t)c->embed_smoothness_neighbours,
        .falloff = c->embed_smoothness_falloff / (edge_m * edge_m),
        .weight = c->embed_smoothness_weight,
        .seed = (uint64_t)c->seed,
        .stream = train_stream(TRAIN_STREAM_SIMILARITY, in->at->at + 1, in->at->step),
    };
    enum err_code rc = dev_finish(m->dev, e);
    enum timing_on was = timing_turn(in->timing, TIMING_EMBED_SMOOTHNESS);
    if (!rc && !r->smoothness)
        rc = embed_smoothness_step_open(m->dev, &r->smoothness, e);
    if (!rc)
        rc = embed_smoothness_step_run(r->smoothness, &m->gauss, &m->adam, &pairs, &loss, e);
    (void)timing_turn(in->timing, was);
    return rc;
}

enum err_code regularizer_step(struct regularizer **own, struct model *m,
                               const struct regularizer_input *in, struct err *e)
{
    const struct train_config *c = in->gallery->cfg;
    bool scale = regularizer_scale_acts(c, in->at), depth = regularizer_depth_acts(c, in->at->step);
    bool smoothness = regularizer_smoothness_acts(in->gallery, in->at);
    struct mcmc_pull pull = regularizer_pull_of(c, &in->site->cell);
    bool pulls = pull.opacity_weight > 0.0 || pull.size_weight > 0.0;
    bool extra = scale || depth || pulls; /* the parts that share the buffer */
    m->adam.extra_grad = NULL;
    if (!extra && !smoothness)
        return ERR_OK;
    enum err_code rc = regularizer_make(own, e);
    if (!rc && smoothness)
        rc = regularizer_smoothness(*own, m, in, e);
    if (rc || !extra)
        return rc;
    rc = regularizer_reserve(*own, m, e);
    m->adam.extra_sizes = scale && !depth && !pulls; /* fewer planes to pass through memory */
    if (!rc && scale)
        rc = regularizer_scale(*own, m, in, e);
    else if (!rc)
        rc = regularizer_clear(*own, m, e);
    if (!rc && pulls)
        rc = regularizer_pull(*own, m, &pull, e);
    if (!rc && depth)
        rc = regularizer_depth(*own, m, in, e);
    if (!rc)
        m->adam.extra_grad = (*own)->extra;
    return rc;
}
