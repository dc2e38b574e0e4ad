/* What the configuration asks of a step besides its photograph: which regularizers act, with what
 * weight, and the buffer in which their gradients meet.
 *
 * The scale regularizer writes the whole buffer, the others add to it; without it the buffer is
 * cleared. Owns everything behind struct regularizer; level.c calls regularizer_step before each step and
 * regularizer_free at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/regularizer.h"
#include "codec/scene.h"
#include "core/base.h"
#include "core/layout.h"
#include "loss/depth.h"
#include "loss/depth_map.h"
#include "loss/embed_smoothness.h"
#include "loss/mip.h"
#include "loss/scale_loss.h"
#include "train/appearance_train.h"
#include "train/config.h"
#include "train/level.h"
#include "train/photo_loader.h"
#include "train/schedule.h"
#include "train/timing.h"

#include <math.h>

#define REGULAR_SIZE_OF_CELL 0.1 /* largest size where none is configured, in cell edges */
/* A limit of size below the size at which Gaussians are split would keep them from being split. */
#define REGULAR_SPLIT_ROOM 1.5
enum { REGULAR_FILTER_STEPS = 100, REGULAR_PLANES = 11 };
enum { REGULAR_PASS_BOTH, REGULAR_PASS_SOFT, REGULAR_PASS_HARD }; /* option depth_pass */

struct regularizer {
    struct scale_loss *scale;
    struct mip *mip;
    struct depth *depth;
    struct depth_map *maps;
    struct embed_smoothness_step *similarity;
    cl_mem extra; /* float [groups][11][16] */
    size_t groups;
};

void regularizer_free(struct regularizer **p)
{
    struct regularizer *r = *p;
    if (!r)
        return;
    scale_loss_close(&r->scale);
    mip_close(&r->mip);
    depth_close(&r->depth);
    depth_map_close(&r->maps);
    embed_smoothness_step_close(&r->similarity);
    dev_release(&r->extra);
    mem_free(r);
    *p = NULL;
}

static enum err_code regularizer_make(struct level *l, struct err *e)
{
    if (!l->regular)
        l->regular = mem_array(1, sizeof(*l->regular));
    return l->regular ? ERR_OK : err_set(e, ERR_MEM, "regularizers: out of memory");
}

/* ---- the 3-D filter ---- */

enum err_code regularizer_filter(struct level *l, struct err *e)
{
    struct camera *cams = NULL;
    if (l->cfg->aa != RENDER_AA_MIP || l->filter_is_current || l->at >= l->n_levels)
        return ERR_OK;
    enum err_code rc = regularizer_make(l, e);
    if (!rc && !l->regular->mip)
        rc = mip_open(l->dev, &l->regular->mip, e);
    if (rc)
        return rc;
    cams = mem_array(l->n_images, sizeof(*cams));
    if (!cams)
        return err_set(e, ERR_MEM, "mip: out of memory for %zu cameras", l->n_images);
    for (size_t i = 0; i < l->n_images; i++)
        cams[i] = photo_loader_camera(&l->scene->images[l->images[i]].cam,
                                      (uint32_t)l->cfg->max_edge_px, l->schedule[l->at].downsample);
    rc = mip_run(l->regular->mip, &l->model, cams, l->n_images, e);
    l->filter_is_current = !rc;
    mem_free(cams);
    return rc;
}

/* ---- the gradients ---- */

static enum err_code regularizer_reserve(struct level *l, struct err *e)
{
    struct regularizer *r = l->regular;
    size_t groups = l->model.cap / LAYOUT_LANES;
    if (r->extra && r->groups >= groups)
        return ERR_OK;
    dev_release(&r->extra);
    r->groups = 0;
    enum err_code rc = dev_buffer(l->dev, groups * REGULAR_PLANES * LAYOUT_LANES * sizeof(float),
                                  NULL, &r->extra, e);
    if (rc)
        return err_add(e, "regularizers of %u Gaussians", l->model.n);
    r->groups = groups;
    return ERR_OK;
}

static enum err_code regularizer_clear(struct level *l, struct err *e)
{
    size_t floats = (size_t)l->model.groups * REGULAR_PLANES * LAYOUT_LANES;
    return dev_zero(l->dev, l->regular->extra, 0, floats * sizeof(float), e);
}

/* From the first opacity reset and one densification after it; later levels go on with it. */
static bool regularizer_scale_acts(const struct level *l, uint32_t step)
{
    const struct schedule *s = &l->schedule[l->at];
    double from = s->level == 1 ? (double)l->cfg->scale_from * s->kappa : 0.0;
    return l->cfg->scale_weight > 0.0 && (double)step > from;
}

static enum err_code regularizer_scale(struct level *l, struct err *e)
{
    const struct train_config *c = l->cfg;
    struct regularizer *r = l->regular;
    double size = c->scale_max_m > 0.0 ? c->scale_max_m : REGULAR_SIZE_OF_CELL * l->cell.edge_m;
    struct scale_loss_input in = {
        .s_max_m = fmax(size, REGULAR_SPLIT_ROOM * c->percent_dense * l->cell.extent_m),
        .r_max = c->scale_ratio_max,
        .weight = c->scale_weight,
    };
    enum err_code rc = r->scale ? ERR_OK : scale_loss_open(l->dev, &r->scale, e);
    return rc ? rc : scale_loss_run(r->scale, &l->model, &in, l->adam.extra_sizes, r->extra, e);
}

static bool regularizer_depth_acts(const struct level *l, uint32_t step)
{
    const struct train_config *c = l->cfg;
    return (c->depth_dir || c->depth_sparse) && c->depth_weight > 0.0 &&
           step % (uint32_t)c->depth_interval == 0;
}

static enum err_code regularizer_depth_open(struct level *l, struct err *e)
{
    struct regularizer *r = l->regular;
    struct depth_map_config maps = {.scene = l->scene,
                                    .images = l->images,
                                    .n_images = l->n_images,
                                    .dir = l->cfg->depth_dir,
                                    .sparse = l->cfg->depth_sparse};
    enum err_code rc = r->maps ? ERR_OK : depth_map_open(&maps, &r->maps, e);
    return rc || r->depth ? rc : depth_open(l->dev, &r->depth, e);
}

/* From depth_weight down to depth_weight_final over the level, exponentially. */
static double regularizer_depth_weight(const struct level *l, uint32_t step)
{
    const struct train_config *c = l->cfg;
    double t = fmin((double)step / (double)l->schedule[l->at].steps, 1.0);
    if (!(c->depth_weight_final > 0.0))
        return c->depth_weight * (1.0 - t);
    return c->depth_weight * pow(c->depth_weight_final / c->depth_weight, t);
}

static enum err_code regularizer_depth(struct level *l, uint32_t step, const struct photo *photo,
                                       struct err *e)
{
    struct depth_target target = {0};
    enum err_code rc = regularizer_depth_open(l, e);
    if (!rc)
        rc = depth_map_target(l->regular->maps, photo->image, &photo->cam, photo->mask, &target, e);
    if (rc || !target.n_known)
        return rc;
    uint32_t turn = step / (uint32_t)l->cfg->depth_interval;
    struct depth_input in = {
        .cam = &photo->cam,
        .options = level_render_options(l, step),
        .target = target.t,
        .unit_m = target.unit_m,
        .n_known = target.n_known,
        .weight = regularizer_depth_weight(l, step),
        .hard = l->cfg->depth_pass == REGULAR_PASS_HARD ||
                (l->cfg->depth_pass == REGULAR_PASS_BOTH && turn % 2),
    };
    return depth_run(l->regular->depth, l->render, &l->model, &in, l->regular->extra, e);
}

/* From the first frame with appearance on; before, embeddings do not step. */
static bool regularizer_similarity_acts(const struct level *l, uint32_t step)
{
    return l->model.embed_len && l->cfg->similarity_weight > 0.0 &&
           appearance_train_is_on(&l->light) &&
           step > appearance_train_warmup(&l->light, l->cfg, &l->schedule[l->at]) &&
           step % (uint32_t)l->cfg->similarity_interval == 0;
}

static enum err_code regularizer_similarity(struct level *l, uint32_t step, struct err *e)
{
    struct embed_smoothness_input in = {
        .samples = (size_t)l->cfg->similarity_samples,
        .neighbours = (size_t)l->cfg->similarity_neighbours,
        .falloff = l->cfg->similarity_falloff / (l->cell.edge_m * l->cell.edge_m),
        .weight = l->cfg->similarity_weight,
        .seed = (uint64_t)l->cfg->seed,
        .stream = train_stream(TRAIN_STREAM_SIMILARITY, l->at + 1, step),
    };
    double loss;
    enum err_code rc = regularizer_make(l, e);
    if (!rc && !l->regular->similarity)
        rc = embed_smoothness_step_open(l->dev, &l->regular->similarity, e);
    return rc ? rc
              : embed_smoothness_step_run(l->regular->similarity, &l->model, &l->adam, &in, &loss,
                                          e);
}

enum err_code regularizer_step(struct level *l, uint32_t step, const struct photo *photo,
                               struct err *e)
{
    bool scale = regularizer_scale_acts(l, step), depth = regularizer_depth_acts(l, step);
    if (step % REGULAR_FILTER_STEPS == 0)
        l->filter_is_current = false;
    l->adam.extra_grad = NULL;
    enum err_code rc = regularizer_filter(l, e);
    if (!rc && regularizer_similarity_acts(l, step)) {
        rc = dev_finish(l->dev, e); /* what follows shall not pay for the last step */
        enum timing_on was = timing_turn(&l->spent, TIMING_SIMILARITY);
        if (!rc)
            rc = regularizer_similarity(l, step, e);
        (void)timing_turn(&l->spent, was);
    }
    if (rc || (!scale && !depth))
        return rc;
    rc = regularizer_make(l, e);
    if (!rc)
        rc = regularizer_reserve(l, e);
    l->adam.extra_sizes = scale && !depth; /* fewer planes to pass through memory */
    if (!rc && scale)
        rc = regularizer_scale(l, e);
    else if (!rc)
        rc = regularizer_clear(l, e);
    if (!rc && depth)
        rc = regularizer_depth(l, step, photo, e);
    if (!rc)
        l->adam.extra_grad = l->regular->extra;
    return rc;
}
