/* Which regularizers act at a step, with what weight, and the buffer that sums their gradients.
 *
 * The scale regularizer writes the whole buffer, and the others add to it. Without the scale
 * regularizer the buffer is cleared first. To add a term: a function that says whether the term
 * acts at this step, a function that adds its gradient to the buffer, a line for each in
 * regularizer_step, and its kernels in regularizer_open. A step opens nothing.
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
#define REGULARIZER_FLAT_PX 0.1      /* thickness below which a Gaussian is flat, in footprints */
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
    uint8_t *parts; /* of the ground: enum scale_loss_part; NULL without one */
    struct mcmc *mcmc;
    struct depth *depth;
    struct depth_map *maps;
    struct embed_smoothness_step *smoothness;
    cl_mem extra; /* float [groups][11][16] */
    size_t extra_bytes;
};

void regularizer_free(struct regularizer **p)
{
    struct regularizer *r = *p;
    if (!r)
        return;
    scale_loss_close(&r->scale);
    mem_free(r->parts);
    mcmc_close(&r->mcmc);
    depth_close(&r->depth);
    depth_map_close(&r->maps);
    embed_smoothness_step_close(&r->smoothness);
    dev_release(&r->extra);
    mem_free(r);
    *p = NULL;
}

static enum err_code regularizer_reserve(struct regularizer *r, const struct model *m,
                                         struct err *e)
{
    size_t bytes = layout_floats(m->gauss.cap, REGULARIZER_PLANES) * sizeof(float);
    enum err_code rc = dev_reserve(m->dev, bytes, &r->extra, &r->extra_bytes, e);
    return rc ? err_add(e, "regularizers of %u Gaussians", m->gauss.n) : ERR_OK;
}

static enum err_code regularizer_clear(struct regularizer *r, const struct model *m, struct err *e)
{
    size_t floats = (size_t)m->gauss.groups * REGULARIZER_PLANES * LAYOUT_LANES;
    return dev_zero(m->dev, r->extra, 0, floats * sizeof(float), e);
}

/* Supported ground has the limit. Gaussians are flat well inside of it. At the rim few photographs
 * see a place, and all from one side: there flat Gaussians lie level, or they would stand askew
 * (docs/decisions/015-solid-surfaces.md). */
static enum err_code regularizer_parts(struct regularizer *r, const struct train_config *c,
                                       const struct site *site, struct err *e)
{
    const struct footprint *f = site->ground;
    size_t n = f ? f->nx * f->ny : 0;
    r->parts = mem_array(n, sizeof *r->parts);
    if (n && !r->parts)
        return err_set(e, ERR_MEM, "regularizers: out of memory for %zu cells of ground", n);
    const uint8_t rim = c->solid_rim > 0.0 ? SCALE_LOSS_FLAT | SCALE_LOSS_LEVEL : 0;
    for (size_t i = 0; i < n; i++)
        r->parts[i] = (f->inside[i] ? SCALE_LOSS_LIMITED : 0) |
                      (footprint_is_deep(f, i) ? SCALE_LOSS_FLAT : rim);
    return ERR_OK;
}

static bool regularizer_has_scale(const struct train_config *c)
{
    return c->scale_weight > 0.0 || c->solid_flat > 0.0 || c->solid_rim > 0.0;
}

/* From the first opacity reset and one densification after it; later levels go on with it. */
static bool regularizer_scale_acts(const struct train_config *c, const struct stage *at)
{
    const struct schedule *s = stage_schedule(at);
    double from = s->turn == 1 ? (double)c->scale_from * s->kappa : 0.0;
    return regularizer_has_scale(c) && (double)at->step > from;
}

static enum err_code regularizer_scale(struct regularizer *r, const struct model *m,
                                       const struct regularizer_input *in, struct err *e)
{
    const struct train_config *c = in->gallery->cfg;
    const struct cell *cell = &in->site->cell;
    const struct schedule *s = stage_schedule(in->at);
    double size = c->scale_max_m > 0.0 ? c->scale_max_m : REGULARIZER_SIZE_OF_CELL * cell->edge_m;
    struct scale_loss_input loss = {
        .s_max_m =
            fmax(size, REGULARIZER_SPLIT_ROOM * gallery_split_above(in->gallery, in->site, s)),
        .r_max = c->scale_ratio_max,
        .weight = c->scale_weight,
    };
    double limit_m = gallery_size_limit(in->gallery, in->site, s),
           footprint_m = gallery_footprint_m(in->gallery, in->site, s);
    struct scale_loss_ground ground = {.s_max_m = limit_m > 0.0 ? limit_m : (double)INFINITY};
    if (footprint_m > 0.0) {
        loss.flat_weight = c->solid_flat;
        loss.flat_m = REGULARIZER_FLAT_PX * footprint_m;
        loss.level_weight = c->solid_rim;
        const struct footprint *f = in->site->ground;
        ground.parts = r->parts;
        ground.nx = f->nx;
        ground.ny = f->ny;
        ground.cell_m = f->cell_m;
        memcpy(ground.corner_m, f->corner_m, sizeof ground.corner_m);
        loss.ground = &ground;
    }
    return scale_loss_run(r->scale, &m->seen, &loss, m->adam.extra_shape, r->extra, e);
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

static bool regularizer_pulls(const struct mcmc_pull *p)
{
    return p->opacity_weight > 0.0 || p->size_weight > 0.0;
}

static bool regularizer_shakes(const struct train_config *c)
{
    return c->strategy == DENSIFY_STRATEGY_MCMC && c->noise > 0.0;
}

enum err_code regularizer_shake(struct regularizer *r, const struct model *m,
                                const struct train_config *c, const struct cell *cell,
                                const struct stage *at, struct err *e)
{
    if (!regularizer_shakes(c))
        return ERR_OK;
    double unit_m = cell->extent_m;
    struct mcmc_noise in = {
        .rate_per_m = c->noise * schedule_lr_mean(stage_schedule(at), at->step) / (unit_m * unit_m),
        .seed = (uint64_t)c->seed,
        .stream = train_stream(TRAIN_STREAM_NOISE, at->at + 1, at->step)};
    return mcmc_noise_run(r->mcmc, &m->gauss, &in, e);
}

static bool regularizer_has_depth(const struct train_config *c)
{
    return (c->depth_dir || c->depth_sparse) && c->depth_weight > 0.0;
}

/* From depth_weight down to depth_weight_final over the level, exponentially. */
static double regularizer_depth_weight(const struct train_config *c, const struct stage *at)
{
    double t = schedule_done(stage_schedule(at), at->step);
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
    enum err_code rc =
        depth_map_target(r->maps, photo->image, &photo->cam, photo->mask, &target, e);
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

static bool regularizer_has_smoothness(const struct gallery *g)
{
    return g->cfg->embed_smoothness_weight > 0.0 && appearance_train_is_on(g->appearance);
}

/* From the first frame with appearance on; before, embeddings do not step. */
static bool regularizer_smoothness_acts(const struct gallery *g, const struct stage *at)
{
    return regularizer_has_smoothness(g) &&
           at->step > appearance_train_warmup(g->appearance, g->cfg, stage_schedule(at)) &&
           at->step % (uint32_t)g->cfg->embed_smoothness_interval == 0;
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
    if (!rc)
        rc = embed_smoothness_step_run(r->smoothness, &m->gauss, &m->adam, &pairs, &loss, e);
    (void)timing_turn(in->timing, was);
    return rc;
}

bool regularizer_moves_all(const struct train_config *cfg, const struct cell *cell)
{
    const struct mcmc_pull pull = regularizer_pull_of(cfg, cell);
    return regularizer_pulls(&pull) || regularizer_shakes(cfg) || regularizer_has_depth(cfg);
}

bool regularizer_reaches_all(const struct gallery *g, const struct site *site)
{
    return regularizer_moves_all(g->cfg, &site->cell) || regularizer_has_smoothness(g);
}

enum err_code regularizer_step(struct regularizer *r, struct model *m,
                               const struct regularizer_input *in, struct err *e)
{
    const struct train_config *c = in->gallery->cfg;
    bool scale = regularizer_scale_acts(c, in->at);
    bool depth = regularizer_has_depth(c) && in->at->step % (uint32_t)c->depth_interval == 0;
    struct mcmc_pull pull = regularizer_pull_of(c, &in->site->cell);
    bool pulls = regularizer_pulls(&pull);
    enum err_code rc = ERR_OK;
    m->adam.extra_grad = NULL;
    if (regularizer_smoothness_acts(in->gallery, in->at))
        rc = regularizer_smoothness(r, m, in, e);
    if (rc || !(scale || depth || pulls)) /* those that share the buffer */
        return rc;
    rc = regularizer_reserve(r, m, e);
    m->adam.extra_shape = scale && !depth && !pulls; /* fewer planes to pass through memory */
    if (!rc)
        rc = scale ? regularizer_scale(r, m, in, e) : regularizer_clear(r, m, e);
    if (!rc && pulls)
        rc = mcmc_pull_run(r->mcmc, &m->gauss, &pull, r->extra, e);
    if (!rc && depth)
        rc = regularizer_depth(r, m, in, e);
    if (!rc)
        m->adam.extra_grad = r->extra;
    return rc;
}

/* ---- opening ---- */

static enum err_code regularizer_open_depth(struct regularizer *r, const struct gallery *g,
                                            struct err *e)
{
    const struct depth_map_config maps = {.scene = g->scene,
                                          .images = g->images,
                                          .n_images = g->n_images,
                                          .dir = g->cfg->depth_dir,
                                          .sparse = g->cfg->depth_sparse};
    enum err_code rc = depth_map_open(&maps, &r->maps, e);
    return rc ? rc : depth_open(g->engine.dev, &r->depth, e);
}

enum err_code regularizer_open(struct regularizer **own, const struct gallery *g,
                               const struct site *site, struct err *e)
{
    const struct train_config *c = g->cfg;
    const struct mcmc_pull pull = regularizer_pull_of(c, &site->cell);
    if (*own)
        return ERR_OK;
    struct regularizer *r = *own = mem_array(1, sizeof *r);
    enum err_code rc = r ? ERR_OK : err_set(e, ERR_MEM, "regularizers: out of memory");
    if (!rc && regularizer_has_scale(c))
        rc = scale_loss_open(g->engine.dev, &r->scale, e);
    if (!rc && regularizer_has_scale(c))
        rc = regularizer_parts(r, c, site, e);
    if (!rc && (regularizer_pulls(&pull) || regularizer_shakes(c)))
        rc = mcmc_open(g->engine.dev, &r->mcmc, e);
    if (!rc && regularizer_has_depth(c))
        rc = regularizer_open_depth(r, g, e);
    if (!rc && regularizer_has_smoothness(g))
        rc = embed_smoothness_step_open(g->engine.dev, &r->smoothness, e);
    if (rc)
        regularizer_free(own);
    return rc;
}
