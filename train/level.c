/* The training loop of one cell: a step, what follows it at certain steps, and the hand-over
 * between levels. This file conducts: it alone knows all parts of a level and hands each of them
 * what it uses. The parts do not know the level.
 *
 * A step is photograph -> forward pass -> loss -> backward pass fused with Adam. Where the schedule
 * says so, density control (densify_apply.c, thin.c) follows it: first the step, then
 * densification, so that a new Gaussian starts with the parameters it was given.
 *
 * At a hand-over the Gaussians stay, and everything of the optimiser starts anew: moments and
 * statistics 0, step 0. A coarser level that follows is thinned in its first steps.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/level.h"

#include <math.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "train/base/config.h"
#include "train/base/metrics_log.h"
#include "train/base/run_cell.h"
#include "train/density/densify_apply.h"
#include "train/density/importance.h"
#include "train/density/prune.h"
#include "train/density/thin.h"
#include "train/loss/photometric.h"
#include "train/model/harmonics.h"
#include "train/photographs/photo_loader.h"
#include "train/refit.h"
#include "train/state.h"
#include "train/terms/terms.h"

/* Of the cell's edge: beyond, exp() and determinants lose their digits. */
#define LEVEL_SIGMA_MIN 1e-6
#define LEVEL_SIGMA_MAX 0.5
#define LEVEL_BETA1 0.9f
#define LEVEL_BETA2 0.999f
#define LEVEL_EPS 1e-15f
/* Learning rates, 3DGS; those of positions follow the schedule. */
#define LEVEL_LR_SCALE 5e-3
#define LEVEL_LR_QUAT 1e-3
#define LEVEL_LR_OPACITY 5e-2
#define LEVEL_LR_SH_DC 2.5e-3
#define LEVEL_LR_SH_REST 1.25e-4
#define LEVEL_MEAN_KEEP 0.95 /* of the running means shown to people */
/* Weight of the size of harmonics at the end of a level. Measured: lab/studies/side.md. */
#define LEVEL_SH_RIDGE 0.03
#define LEVEL_NEAR_SHARE 1000.0 /* near planes in a cell's edge */

/* ---- opening ---- */

void level_init(struct level *l, const struct run_cell *job, const uint32_t *images,
                size_t n_images)
{
    const struct train_config *c = job->cfg;
    *l = (struct level){
        .cfg = c,
        .engine = {job->dev, job->render, job->loss},
        .site = {.cell = job->cell},
        .stage = {.n_levels = (uint32_t)c->level_count, .again = c->level_order == SCHEDULE_BOTH}};
    l->gallery = (struct gallery){
        .cfg = c,
        .engine = l->engine,
        .scene = job->scene,
        .images = images,
        .n_images = n_images,
        .appearance = &l->appearance,
        .near_m =
            c->near_m > 0.0 ? c->near_m : fmax(RENDER_NEAR_M, job->cell.edge_m / LEVEL_NEAR_SHARE)};
}

/* The learning rates of a step. */
static void level_set_rates(struct level *l, uint32_t step)
{
    const struct schedule *s = stage_schedule(&l->stage);
    struct render_adam *adam = &l->model.adam;
    double fade = schedule_fade(s, step), shape = s->still ? 0.0 : fade;
    adam->lr_mean = (float)(schedule_lr_mean(s, step) * fade);
    adam->lr_scale = (float)(LEVEL_LR_SCALE * s->lr_factor * shape);
    adam->lr_quat = (float)(LEVEL_LR_QUAT * s->lr_factor * shape);
    adam->lr_opacity = (float)(LEVEL_LR_OPACITY * shape);
    adam->lr_sh_dc = (float)(LEVEL_LR_SH_DC * fade);
    adam->lr_sh_rest =
        (float)(LEVEL_LR_SH_REST * fade * schedule_sh_factor(l->cfg, s, l->gallery.n_images));
}

static void level_start_optimiser(struct level *l)
{
    const struct train_config *c = l->cfg;
    const struct schedule *s = stage_schedule(&l->stage);
    const struct appearance_train *a = &l->appearance;
    uint32_t step = l->stage.step;
    struct render_adam *adam = &l->model.adam;
    adam->beta1 = LEVEL_BETA1;
    adam->beta2 = LEVEL_BETA2;
    adam->eps = LEVEL_EPS;
    adam->scale_log_min = (float)log(LEVEL_SIGMA_MIN * l->site.cell.edge_m);
    adam->scale_log_max = (float)log(LEVEL_SIGMA_MAX * l->site.cell.edge_m);
    adam->step = step;
    level_set_rates(l, step);
    uint32_t warmup = appearance_train_is_on(a) ? appearance_train_warmup(a, c, s) : 0;
    adam->embed_step = appearance_train_is_on(a) && step > warmup ? step - warmup : 0;
}

enum err_code level_open(struct level *l, const struct gauss *g, struct err *e)
{
    const struct cell *cell = &l->site.cell;
    size_t most = schedule_most(stage_schedule(&l->stage), cell);
    enum err_code rc = model_open(&l->model, l->engine.dev, l->engine.render, g, most, e);
    if (!rc)
        rc = model_fill(&l->model, g, e);
    return rc ? rc : model_count_inside(&l->model, cell, NULL, &l->stage.start, e);
}

void level_close(struct level *l)
{
    importance_free(&l->importance);
    terms_free(&l->terms);
    background_free(&l->background);
    model_close(&l->model);
    gallery_close(&l->gallery);
    appearance_train_close(&l->appearance);
}

/* A model that was owed steps when it was saved learns which steps those were. */
static enum err_code level_tell_owed(struct level *l, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (uint32_t step = l->owes_from; !rc && l->owes && step <= l->stage.step; step++) {
        l->model.adam.step = step;
        level_set_rates(l, step);
        rc = model_stepped(&l->model, e);
    }
    l->owes = false;
    return rc;
}

enum err_code level_begin(struct level *l, struct err *e)
{
    level_start_optimiser(l);
    enum err_code rc = level_tell_owed(l, e);
    if (rc)
        return rc;
    l->loss_mean = l->mse_mean = 0.0;
    l->step_s = clock_s();
    rc = gallery_open(&l->gallery, stage_schedule(&l->stage), e);
    return rc ? rc : terms_open(&l->terms, &l->gallery, &l->site, e);
}

/* ---- checkpoints ---- */

static struct state level_state(struct level *l, double seconds)
{
    return (struct state){
        .run = {l->cfg, &l->site.cell, l->gallery.n_images, l->site.inputs,
                &l->gallery.scene->origin},
        .at = l->stage,
        .appearance = &l->appearance,
        .seconds = seconds,
        .pixel_m = gallery_footprint_m(&l->gallery, &l->site, stage_schedule(&l->stage))};
}

enum err_code level_resume(struct level *l, const char *path, struct err *e)
{
    struct state s = level_state(l, 0.0);
    enum err_code rc = state_load(&l->model, &l->engine, &s, path, e);
    l->stage = s.at;
    l->seconds = s.seconds;
    l->owes = s.owes;
    l->owes_from = s.owes_from;
    return rc;
}

enum err_code level_save(struct level *l, double seconds, const char *path, struct err *e)
{
    struct state s = level_state(l, seconds);
    return state_save(&l->model, &s, path, e);
}

enum err_code level_save_result(struct level *l, const char *path,
                                const struct evaluate_score *score, struct err *e)
{
    struct state s = level_state(l, 0.0);
    return state_save_level(&l->model, &s, path, score, e);
}

/* ---- between levels ---- */

/* The smallest harmonics that look alike from where photographs stood. */
static enum err_code level_hold_harmonics(struct level *l, struct err *e)
{
    const struct schedule *s = stage_schedule(&l->stage);
    struct harmonics_rule r = {.n_cams = l->gallery.n_images,
                               .weight = LEVEL_SH_RIDGE,
                               .degree = schedule_sh_degree(s, s->steps)};
    struct camera *cams = gallery_cameras_full(&l->gallery);
    if (!cams)
        return err_set(e, ERR_MEM, "harmonics: out of memory for %zu photographs", r.n_cams);
    r.cams = cams;
    enum err_code rc = harmonics_level(&l->model, &r, e);
    mem_free(cams);
    return rc;
}

enum err_code level_prune(struct level *l, struct prune_report *out,
                          struct residual_list *residuals, struct err *e)
{
    enum err_code rc = model_settle(&l->model, e);
    if (rc || l->stage.pruned)
        return rc;
    if (stage_prunes(&l->stage, stage_schedule(&l->stage)))
        rc = prune_level(&l->model, &l->gallery, l->site.ground, &l->stage, out, residuals, e);
    if (!rc)
        rc = level_hold_harmonics(l, e);
    l->stage.pruned = !rc;
    return rc;
}

enum err_code level_next(struct level *l, struct err *e)
{
    struct stage *at = &l->stage;
    const uint32_t next = stage_after(at, at->at);
    enum err_code rc = model_settle(&l->model, e);
    if (at->again && !at->turned && at->at + 1 == at->n_levels)
        stage_turn(at, l->cfg);
    if (!rc)
        rc = model_count_inside(&l->model, &l->site.cell, NULL, &at->start, e);
    if (rc)
        return rc;
    at->at = next;
    at->step = 0;
    at->pruned = false;
    appearance_train_restart(&l->appearance);
    rc = model_zero_moments(&l->model, e);
    if (!rc)
        rc = model_zero_stats(&l->model, e);
    if (rc || at->at == at->n_levels)
        return rc;
    const struct schedule *s = stage_schedule(at);
    if (at->start > s->budget && !s->derived)
        log_warn("train",
                 "level %u starts with %zu Gaussians, its budget is %zu: they become no more",
                 s->level, at->start, s->budget);
    return level_begin(l, e);
}

void level_end(struct level *l)
{
    l->stage.at = l->stage.n_levels;
}

enum err_code level_back(struct level *l, const char *path, struct err *e)
{
    const double seconds = l->seconds; /* of processes before this one */
    importance_free(&l->importance);
    terms_free(&l->terms);
    model_close(&l->model);
    enum err_code rc = level_resume(l, path, e);
    l->seconds = seconds;
    return rc;
}

/* ---- one network for all levels ---- */

/* The level's Gaussians instead of those there are; no more room than for them. */
static enum err_code level_refit_load(struct level *l, const struct ckpt_rows *c, struct err *e)
{
    importance_free(&l->importance); /* made anew where needed, for as many as there are */
    terms_free(&l->terms);
    model_close(&l->model);
    enum err_code rc = model_open(&l->model, l->engine.dev, l->engine.render, ckpt_rows_like(c),
                                  ckpt_rows_count(c), e);
    if (!rc)
        rc = state_fill_rows(&l->model, c, e);
    if (!rc)
        rc = model_zero_moments(&l->model, e);
    return rc ? rc : model_count_inside(&l->model, &l->site.cell, NULL, &l->stage.start, e);
}

static enum err_code level_refit_begin(struct level *l, uint32_t at, const struct ckpt_rows *c,
                                       struct err *e)
{
    struct stage *s = &l->stage;
    s->at = at;
    s->step = 0;
    s->pruned = true;
    s->levels[at] = refit_schedule(&s->levels[at]);
    l->appearance.shared = true;
    appearance_train_restart(&l->appearance);
    enum err_code rc = level_refit_load(l, c, e);
    if (!rc)
        rc = level_begin(l, e);
    return rc;
}

enum err_code level_refit_open(struct level_refit *r, struct level *l, uint32_t at,
                               const char *path, struct err *e)
{
    struct ckpt_rows *c = NULL;
    *r = (struct level_refit){.was = l->stage.levels[at], .was_shared = l->appearance.shared};
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = refit_look(&l->appearance, c, &r->needed, e);
    if (!rc && r->needed)
        rc = level_refit_begin(l, at, c, e);
    ckpt_rows_close(&c);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

enum err_code level_refit_finish(struct level *l, struct err *e)
{
    enum err_code rc = model_settle(&l->model, e);
    return rc ? rc : level_hold_harmonics(l, e);
}

void level_refit_end(struct level_refit *r, struct level *l)
{
    struct stage *s = &l->stage;
    if (!r->needed)
        return;
    s->levels[s->at] = r->was;
    s->step = r->was.steps;
    l->appearance.shared = r->was_shared;
}

/* ---- a last fit with all photographs ---- */

/* What was opened for a list of photographs is opened anew for another list. */
static void level_set_photos(struct level *l, const struct gallery *from)
{
    l->gallery.images = from->images;
    l->gallery.n_images = from->n_images;
    l->gallery.windows = from->windows;
    terms_free(&l->terms);
    importance_free(&l->importance);
}

enum err_code level_last_open(struct level_last *r, struct level *l, const uint32_t *images,
                              size_t n_images, const struct camera_window *windows, struct err *e)
{
    struct stage *s = &l->stage;
    const struct gallery all = {.images = images, .n_images = n_images, .windows = windows};
    s->at = s->n_levels - 1;
    *r = (struct level_last){.was = s->levels[s->at], .gallery = l->gallery};
    s->step = 0;
    s->pruned = true;
    s->levels[s->at] = refit_schedule_last(&r->was);
    level_set_photos(l, &all);
    enum err_code rc = model_zero_moments(&l->model, e);
    return rc ? rc : level_begin(l, e);
}

void level_last_end(struct level_last *r, struct level *l)
{
    struct stage *s = &l->stage;
    s->levels[s->at] = r->was;
    s->step = r->was.steps;
    level_set_photos(l, &r->gallery);
}

/* ---- after a step ---- */

static bool level_thins(const struct level *l)
{
    const struct schedule *s = stage_schedule(&l->stage);
    return (s->derived || l->model.gauss.n > s->budget) && schedule_thinning(s, l->stage.step);
}

/* No more than the scene needs, or than the level may have. */
static enum err_code level_thin(struct level *l, struct err *e)
{
    struct thin_report r;
    uint32_t level = stage_schedule(&l->stage)->level, step = l->stage.step;
    (void)timing_turn(&l->timing, TIMING_THIN);
    enum err_code rc = thin_run(&l->model, &l->gallery, &l->background, &l->site, &l->stage, &r, e);
    if (rc)
        return rc;
    log_info("train",
             "level=%u step=%u thinned before=%zu removed=%zu unseen=%zu train_psnr_db=%.3f "
             "predicted_rise=%.3f",
             level, step, r.before, r.removed, r.unseen, r.psnr_db, r.rise);
    if (!l->metrics)
        return ERR_OK;
    return metrics_log_line(l->metrics, "thin",
                            json_pack("{s:i, s:i, s:I, s:I, s:I, s:o, s:f}", "level", (int)level,
                                      "step", (int)step, "before", (json_int_t)r.before, "removed",
                                      (json_int_t)r.removed, "unseen", (json_int_t)r.unseen,
                                      "psnr_db", jsonc_real(r.psnr_db), "rise", r.rise),
                            e);
}

/* What follows some steps. The device finishes the step before the clock turns. */
static enum err_code level_control(struct level *l, uint32_t x, struct err *e)
{
    const struct densify_run run = {&l->gallery,    &l->site,   &l->stage,
                                    &l->importance, l->metrics, &l->timing};
    enum err_code rc = dev_finish(l->engine.dev, e);
    enum timing_on was = timing_turn(&l->timing, TIMING_DENSIFY);
    if (!rc)
        rc = model_settle(&l->model, e);
    if (!rc && x)
        rc = densify_apply(&l->model, &run, x, e);
    if (!rc && level_thins(l))
        rc = level_thin(l, e);
    (void)timing_turn(&l->timing, was);
    return rc;
}

/* ---- a step ---- */

/* Non-finite updates are dropped on the device and counted; tell people once a thing goes wrong. */
static enum err_code level_check_repaired(struct level *l, struct err *e)
{
    uint32_t n = 0;
    enum err_code rc = dev_read(l->engine.dev, l->model.stats.repaired, 0, sizeof n, &n, e);
    if (!rc && n != l->repaired) {
        log_warn("train", "%u Gaussians had a non-finite update and were repaired (step %u)",
                 n - l->repaired, l->stage.step);
        l->repaired = n;
    }
    return rc;
}

static enum err_code level_read_loss(struct level *l, struct photometric_value *v, struct err *e)
{
    enum err_code rc = photometric_read(l->engine.loss, v, e);
    if (rc)
        return rc;
    if (!isfinite(v->total))
        return err_set(e, ERR_DATA,
                       "level %u, step %u: the loss is not finite; lower the learning rates",
                       stage_schedule(&l->stage)->level, l->stage.step);
    double keep = l->mse_mean > 0.0 ? LEVEL_MEAN_KEEP : 0.0;
    l->loss_mean = keep * l->loss_mean + (1.0 - keep) * v->total;
    l->mse_mean = keep * l->mse_mean + (1.0 - keep) * v->mse;
    return level_check_repaired(l, e);
}

/* What the backward pass of this step does about appearance. */
static void level_ask_appearance(struct level *l, uint32_t step, const struct render_options *ro,
                                 struct render_appearance_grad *grad)
{
    const struct schedule *s = stage_schedule(&l->stage);
    const struct train_config *c = l->cfg;
    const struct appearance_train *a = &l->appearance;
    struct render_adam *adam = &l->model.adam;
    adam->appearance = NULL;
    if (!ro->appearance_frame)
        return;
    *grad = (struct render_appearance_grad){.frame = appearance_train_learns(a, s) ? a->frame_grad
                                                                                   : NULL};
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
        appearance_train_update(&l->appearance, image, (double)adam->lr_embed);
}

/* The backward pass of the frame of a photograph, fused with Adam. */
static enum err_code level_backward(struct level *l, const struct term_step *terms,
                                    const struct render_options *ro, struct err *e)
{
    const uint32_t step = l->stage.step;
    const struct schedule *s = stage_schedule(&l->stage);
    struct model *m = &l->model;
    struct render_appearance_grad grad;
    struct render_density_stats stats = m->stats;
    m->adam.step = step;
    level_set_rates(l, step);
    level_ask_appearance(l, step, ro, &grad);
    if (!s->absgrad || step >= s->densify_until)
        stats.absg = NULL; /* densification would not look at it: saves a tenth of the pass */
    enum err_code rc = terms_backward(l->terms, terms, e);
    if (!rc)
        rc = render_backward_step(l->engine.render, &m->seen, &m->adam, &stats, e);
    if (!rc)
        rc = model_stepped(m, e);
    if (!rc && m->adam.appearance)
        level_learn_appearance(l, terms->photo->image);
    m->adam.appearance = NULL; /* it lives here */
    return rc;
}

/* Few Gaussians are moved sooner than chosen. */
static bool level_defers(const struct level *l)
{
    const struct render_model *g = &l->model.gauss;
    return l->cfg->defer_from > 0 && g->n >= l->cfg->defer_from && !g->embed_len;
}

enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e)
{
    struct model *m = &l->model;
    uint32_t step = ++l->stage.step;
    struct photo photo;
    enum timing_on was = timing_turn(&l->timing, TIMING_PHOTOGRAPHS);
    enum err_code rc = photo_loader_get(l->gallery.photos, step, &photo, e);
    (void)timing_turn(&l->timing, was);
    if (rc)
        return rc;
    struct render_options ro = gallery_photo_options(&l->gallery, &l->stage, photo.image);
    struct term_step terms = {.gallery = &l->gallery,
                              .site = &l->site,
                              .at = &l->stage,
                              .photo = &photo,
                              .frame = &ro,
                              .model = m,
                              .timing = &l->timing};
    if (terms_act(&l->gallery, &l->stage, TERM_RAYS))
        ro.depth_unit_m = terms_depth_unit_m(&l->site);
    rc = background_support(&l->background, l->site.ground, &photo, &terms.supported, e);
    if (!rc)
        background_choose(&l->background, l->cfg, terms.supported, &l->stage, &photo, &ro);
    if (!rc) /* while the device makes the step before; model_see waits for that */
        rc = terms_hand_over(l->terms, &terms, e);
    if (!rc)
        rc = model_see(m, level_defers(l), &photo.cam, &ro, e);
    if (!rc)
        rc = terms_before(l->terms, &terms, e);
    if (!rc)
        rc = gallery_hand_over(&l->gallery, &photo, e);
    if (!rc)
        rc = render_forward(l->engine.render, &m->seen, &photo.cam, &ro, NULL, NULL, e);
    if (!rc)
        rc = terms_after(l->terms, &terms, e);
    if (!rc)
        rc = level_backward(l, &terms, &ro, e);
    if (!rc && value)
        rc = level_read_loss(l, value, e);
    if (rc) /* what was handed over belongs to the host again */
        dev_abandon(l->engine.dev, NULL);
    const struct schedule *s = stage_schedule(&l->stage);
    uint32_t x = schedule_densify_index(s, step);
    return !rc && (x || level_thins(l)) ? level_control(l, x, e) : rc;
}
