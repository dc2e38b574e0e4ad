/* Trains one cell, from its first step to its last level; begin.c prepares it. It goes through the
 * levels, scores and saves each, and leaves a state to resume from when the run is interrupted.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

#include "train/base/config.h"
#include "train/base/metrics_log.h"
#include "train/base/result.h"
#include "train/begin.h"
#include "train/density/prune.h"
#include "train/done.h"
#include "train/forecast.h"
#include "train/level.h"
#include "train/loss/photometric.h"
#include "train/model/appearance_train.h"
#include "train/photographs/evaluate.h"
#include "train/photographs/photo_loader.h"
#include "train/photographs/residual.h"
#include "train/refit.h"
#include "train/run.h"

#define RUN_COMPILED 0.05 /* of a look: more than that, and the look does not count */
enum { RUN_LOOK_STEPS = 20, RUN_LINE_STEPS = 100, RUN_FORECAST_LOOKS = 5 };

struct run {
    struct level level;
    struct begin begin;
    const struct run_cell *job; /* borrowed, as is cfg */
    const struct train_config *cfg;
    double start_s; /* clock_s() when this process took up the run */
    struct progress progress;
    struct timing_seconds spent_before; /* when the level in work began */
    struct forecast forecast;
    double looked_s;         /* when steps were last counted for it */
    uint32_t looked_step;    /* the step of that look */
    double looked_compile_s; /* of the device, at that look */
    uint32_t looks;          /* that counted */
    uint64_t last_saved;     /* steps of this process when the state was last saved */
    struct train_cell_result *result;
};

/* Seconds spent on the run so far, by all processes. */
static double run_seconds(const struct run *t)
{
    return t->level.seconds + clock_s() - t->start_s;
}

/* ---- the first Gaussians ---- */

static enum err_code run_open_metrics(struct run *t, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct level *l = &t->level;
    const struct cell *cell = &l->site.cell;
    enum err_code rc = file_join(path, t->begin.dir, "metrics.jsonl", e);
    if (!rc)
        rc = metrics_log_open(path, t->begin.resumes, &l->metrics, e);
    if (rc)
        return rc;
    return metrics_log_line(
        l->metrics, t->begin.resumes ? "resume" : "start",
        json_pack("{s:s, s:s, s:I, s:I, s:I, s:i, s:i, s:f, s:f}", "cell", cell->id, "device",
                  l->engine.dev->name, "photographs", (json_int_t)l->gallery.n_images,
                  "test_photographs", (json_int_t)t->job->n_test, "gaussians",
                  (json_int_t)l->model.gauss.n, "level", (int)l->stage.at + 1, "step",
                  (int)l->stage.step, "edge_m", cell->edge_m, "extent_m", cell->extent_m),
        e);
}

/* The level takes over what begin.c has found out. */
static void run_make_level(struct run *t, const struct timing *clock)
{
    struct begin *b = &t->begin;
    struct level *l = &t->level;
    level_init(l, t->job, t->job->images, t->job->n_images);
    l->gallery.windows = b->windows;
    l->timing = *clock;
    timing_compiles(&l->timing, &l->engine.dev->compile_s);
    l->site.inputs = &b->inputs;
    l->site.ground = b->ground.nx ? &b->ground : NULL;
    l->site.rim = b->ground.nx ? &b->rim : NULL;
    memcpy(l->stage.levels, b->levels, sizeof b->levels);
    l->appearance = b->appearance;
    b->appearance = (struct appearance_train){0};
    forecast_open(&t->forecast, &l->gallery, &l->stage, t->job->n_test, t->job->cell.whole);
}

/* Go on from where the run was interrupted, or from the first Gaussians. */
static enum err_code run_start(struct run *t, const struct timing *clock, struct err *e)
{
    struct gauss g = {0};
    struct level *l = &t->level;
    run_make_level(t, clock);
    enum err_code rc;
    if (t->begin.resumes) {
        rc = level_resume(l, t->begin.resume_path, e);
        if (!rc)
            rc = begin_earlier_levels(&t->begin, &l->stage, t->result, e);
        if (!rc)
            log_info("train", "resume cell=%s level=%u step=%u gaussians=%u", l->site.cell.id,
                     l->stage.at + 1, l->stage.step, l->model.gauss.n);
    } else {
        rc = begin_gauss(&t->begin, &l->appearance, &g, e);
        if (!rc)
            rc = level_open(l, &g, e);
        gauss_free(&g);
    }
    if (!rc)
        rc = begin_write_config(&t->begin, e);
    return rc ? rc : run_open_metrics(t, e);
}

/* ---- the loop ---- */

static enum err_code run_save(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = dev_finish(l->engine.dev, e);
    enum timing_on was = timing_turn(&l->timing, TIMING_CHECKPOINT);
    if (!rc)
        rc = level_save(l, run_seconds(t), t->begin.resume_path, e);
    (void)timing_turn(&l->timing, was);
    return rc;
}

static enum err_code run_stop(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = run_save(t, e);
    if (rc)
        return err_add(e, "stopped, but the state could not be saved");
    return err_set(
        e, ERR_CANCEL,
        "stopped at level %u of %u, step %u of %u; the state is saved: the same command with "
        "--resume goes on",
        l->stage.at + 1, l->stage.n_levels, l->stage.step, l->stage.levels[l->stage.at].steps);
}

/* What the whole run will take, said once when it can be known. Looks during which kernels were
 * compiled say nothing about the steps to come: they are left out. */
static void run_forecast(struct run *t, char *left, size_t size)
{
    struct level *l = &t->level;
    double now = clock_s(), n = l->model.gauss.n;
    double seconds = now - t->looked_s, compiled = l->engine.dev->compile_s - t->looked_compile_s;
    bool counts = compiled < RUN_COMPILED * seconds;
    if (counts)
        forecast_add(&t->forecast, &l->stage, t->looked_step, n, seconds - compiled);
    t->looked_s = now;
    t->looked_step = l->stage.step;
    t->looked_compile_s += compiled;
    if (!(t->forecast.work > 0.0)) {
        snprintf(left, size, "compiling kernels, ?");
        return;
    }
    forecast_text(forecast_left_s(&t->forecast, &l->stage, n), left, size);
    t->looks += counts;
    if (counts && t->looks == RUN_FORECAST_LOOKS)
        log_info("train", "cell=%s about %s left for the rest of all levels", l->site.cell.id,
                 left);
}

static enum err_code run_report(struct run *t, const struct photometric_value *v, struct err *e)
{
    struct level *l = &t->level;
    char note[160], left[32];
    double psnr = l->mse_mean > 0.0 ? -10.0 * log10(l->mse_mean) : 0.0;
    run_forecast(t, left, sizeof left);
    snprintf(note, sizeof note, "%s left of all levels, loss %.4f, PSNR %.2f dB, %.1f k Gaussians",
             left, l->loss_mean, psnr, l->model.gauss.n * 1e-3);
    progress_step(&t->progress, l->stage.step, note);
    if (l->stage.step % RUN_LINE_STEPS && l->stage.step != l->stage.levels[l->stage.at].steps)
        return ERR_OK;
    double now = clock_s(), seconds = now - l->step_s;
    l->step_s = now;
    double seen = (double)l->model.seen.groups / (double)l->model.gauss.groups;
    json_t *o = json_pack("{s:i, s:i, s:i, s:f, s:f, s:f, s:f, s:I, s:f, s:f, s:I, s:f}", "level",
                          (int)l->stage.at + 1, "turn", (int)stage_schedule(&l->stage)->turn,
                          "step", (int)l->stage.step, "loss", v->total, "l1", v->l1, "ssim",
                          v->ssim, "psnr_mean_db", psnr, "gaussians", (json_int_t)l->model.gauss.n,
                          "stepped_share", seen, "s_since_last_line", seconds, "photo_loader_bytes",
                          (json_int_t)photo_loader_bytes(l->gallery.photos), "opacity_offset",
                          l->offset_mean);
    return metrics_log_line(l->metrics, "step", o, e);
}

static enum err_code run_steps(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    uint32_t steps = l->stage.levels[l->stage.at].steps;
    while (l->stage.step < steps) {
        struct photometric_value v;
        uint32_t next = l->stage.step + 1;
        bool look = next % RUN_LOOK_STEPS == 0 || next == steps;
        enum err_code rc = level_step(l, look ? &v : NULL, e);
        (*t->job->steps)++;
        if (!rc && look)
            rc = run_report(t, &v, e);
        if (rc)
            return rc;
        bool enough = t->cfg->stop_after > 0 && *t->job->steps >= (uint64_t)t->cfg->stop_after;
        if (signals_stopping() || enough)
            return run_stop(t, e);
        if (*t->job->steps - t->last_saved >= (uint64_t)t->cfg->checkpoint_interval &&
            l->stage.step < steps) {
            t->last_saved = *t->job->steps;
            rc = run_save(t, e);
            if (rc)
                return rc;
        }
    }
    return ERR_OK;
}

struct run_drawing {
    struct model *of;
    struct evaluate_model model; /* what a photograph shows of it */
};

static enum err_code run_draw(void *user, const struct camera *cam, float *rgb, double *gaussians,
                              struct err *e)
{
    struct run_drawing *d = user;
    struct model_look look;
    enum err_code rc = model_look(d->of, cam, &d->model.options, &look, e);
    d->model.model = &look.shown;
    if (!rc)
        rc = evaluate_draw_model(&d->model, cam, rgb, gaussians, e);
    d->model.model = NULL;
    *gaussians = d->of->gauss.n;
    return rc;
}

static enum err_code run_score(struct run *t, struct evaluate_score *out, struct err *e)
{
    struct level *l = &t->level;
    struct photo_loader *photos = NULL;
    struct photo_loader_config f = {
        .scene = l->gallery.scene,
        .images = t->job->test_images,
        .n_images = t->job->n_test,
        .max_edge_px = (uint32_t)t->cfg->max_edge_px,
        .downsample = l->stage.levels[l->stage.at].downsample,
        .cache_bytes = (size_t)64 << 20,
        .exposure = t->cfg->exposure ? PHOTO_LOADER_TOLD : PHOTO_LOADER_AS_TAKEN,
    };
    struct appearance_view appearance = {0};
    struct run_drawing drawing = {&l->model,
                                  {l->engine.render, NULL, gallery_options(&l->gallery, &l->stage),
                                   appearance_train_is_on(&l->appearance) ? &appearance : NULL}};
    struct evaluate_source source = {.draw = run_draw, .user = &drawing, .brief = true};
    enum err_code rc = photo_loader_open(&f, &photos, e);
    if (!rc && drawing.model.appearance)
        rc = appearance_view_open(&appearance, &l->appearance.model, l->gallery.scene, e);
    if (!rc)
        rc = evaluate_run(photos, t->job->n_test, &source, out, e);
    appearance_view_close(&appearance);
    photo_loader_close(&photos);
    return rc;
}

/* Name the photographs that fit the finest level badly, and write residuals.json. */
static enum err_code run_residuals(struct run *t, struct residual_list *r, struct err *e)
{
    char path[FILE_PATH_MAX];
    enum { NAMED = 3 };
    struct level *l = &t->level;
    if (!r->n)
        return ERR_OK;
    enum err_code rc = residual_rank(r, e);
    if (!rc)
        rc = file_join(path, t->begin.dir, "residuals.json", e);
    if (!rc)
        rc = residual_write(r, path, l->site.cell.id, e);
    for (size_t i = 0; !rc && i < r->n_suspicious && i < NAMED; i++)
        log_warn("train", "%s fits much worse than the other photographs (robust z-score %.1f)",
                 r->rows[i].name, r->rows[i].z);
    if (!rc && r->n_suspicious > NAMED)
        log_warn("train", "so do %zu more: %s", r->n_suspicious - NAMED, path);
    return rc;
}

/* Remove what contributes nothing, and tell. A run that was stopped after this and resumed must not
 * do it again. */
static enum err_code run_prune(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    struct prune_report r = {0};
    struct residual_list residuals = {0};
    bool finest = l->stage.at + 1 == l->stage.n_levels;
    enum err_code rc = level_prune(l, &r, finest ? &residuals : NULL, e);
    if (!rc)
        rc = run_residuals(t, &residuals, e);
    residual_free(&residuals);
    if (rc || !(r.faint + r.unsupported))
        return rc;
    log_info("train",
             "level=%u prune before=%zu faint=%zu unsupported=%zu removed=%zu train_psnr_db=%.3f "
             "lost_db=%.3f",
             l->stage.at + 1, r.before, r.faint, r.unsupported, r.removed, r.psnr_before_db,
             r.lost_db);
    return metrics_log_line(l->metrics, "prune",
                            json_pack("{s:i, s:I, s:I, s:I, s:I, s:o, s:f}", "level",
                                      (int)l->stage.at + 1, "before", (json_int_t)r.before, "faint",
                                      (json_int_t)r.faint, "unsupported", (json_int_t)r.unsupported,
                                      "removed", (json_int_t)r.removed, "psnr_before_db",
                                      jsonc_real(r.psnr_before_db), "lost_db", r.lost_db),
                            e);
}

/* What follows the levels and can be interrupted. */
static bool run_goes_on(const struct run *t)
{
    return begin_wants_last(&t->begin) || refit_wanted(&t->level.appearance, &t->level.stage);
}

/* What a fit after the levels begins from: the state at the end of the last level, and, where that
 * is not the finest one, the state at the end of the finest. */
static enum err_code run_save_for_last(struct run *t, struct err *e)
{
    const struct stage *at = &t->level.stage;
    const bool last = stage_after(at, at->at) == at->n_levels;
    char path[FILE_PATH_MAX];
    enum err_code rc = ERR_OK;
    if (last && run_goes_on(t))
        return run_save(t, e);
    if (last || at->at + 1 < at->n_levels || !begin_wants_last(&t->begin))
        return ERR_OK;
    rc = begin_finest_path(&t->begin, path, e);
    return rc ? rc : level_save(&t->level, run_seconds(t), path, e);
}

/* Results of levels that are still to come belong to an older run. */
static enum err_code run_remove_old(const struct run *t, struct err *e)
{
    const struct stage *at = &t->level.stage;
    enum err_code rc = ERR_OK;
    for (uint32_t j = 0; !rc && j < TRAIN_LEVELS_MAX; j++) {
        char path[FILE_PATH_MAX];
        if (j < at->n_levels && (at->turned ? j >= at->at : j <= at->at))
            continue;
        rc = begin_level_path(&t->begin, j + 1, path, e);
        if (!rc)
            (void)unlink(path);
    }
    return rc;
}

/* Score and save the level in work. */
static enum err_code run_finish_level(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    struct evaluate_score score = {0};
    char path[FILE_PATH_MAX];
    uint32_t k = l->stage.at + 1;
    (void)timing_turn(&l->timing, TIMING_PRUNE);
    enum err_code rc = run_prune(t, e);
    (void)timing_turn(&l->timing, TIMING_EVALUATE);
    if (!rc && t->job->n_test)
        rc = run_score(t, &score, e);
    if (rc == ERR_CANCEL)
        return run_stop(t, e);
    (void)timing_turn(&l->timing, TIMING_CHECKPOINT);
    if (!rc)
        rc = run_save_for_last(t, e);
    if (!rc)
        rc = begin_level_path(&t->begin, k, path, e);
    if (!rc)
        rc = level_save_result(l, path, score.n_photos ? &score : NULL, e);
    (void)timing_turn(&l->timing, TIMING_OTHER);
    if (!rc)
        rc = run_remove_old(t, e);
    if (rc)
        return rc;
    double seconds = run_seconds(t);
    t->result->n_gaussians[l->stage.at] = l->model.gauss.n;
    t->result->n_test = score.n_photos;
    t->result->psnr_db[l->stage.at] = score.n_photos ? score.psnr_db : (double)NAN;
    t->result->ssim[l->stage.at] = score.n_photos ? score.ssim : (double)NAN;
    if (score.n_photos)
        log_info("train",
                 "level=%u done gaussians=%u test_psnr_db=%.3f test_ssim=%.4f seconds=%.1f", k,
                 l->model.gauss.n, score.psnr_db, score.ssim, seconds);
    else
        log_info("train", "level=%u done gaussians=%u seconds=%.1f", k, l->model.gauss.n, seconds);
    return metrics_log_line(l->metrics, "level",
                            json_pack("{s:i, s:I, s:I, s:o, s:o, s:o, s:o, s:f, s:I}", "level",
                                      (int)k, "gaussians", (json_int_t)l->model.gauss.n,
                                      "test_photographs", (json_int_t)score.n_photos, "psnr_db",
                                      jsonc_real(score.psnr_db), "ssim", jsonc_real(score.ssim),
                                      "ssim_valid", jsonc_real(score.ssim_valid), "ms_frame",
                                      jsonc_real(score.ms_frame), "seconds", seconds, "peak_bytes",
                                      (json_int_t)mem_peak_bytes()),
                            e);
}

/* Where the level's time went. */
static enum err_code run_report_spent(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    char text[512];
    struct timing_seconds now = timing_now(&l->timing), here = timing_since(&now, &t->spent_before);
    t->spent_before = now;
    timing_text(&here, text, sizeof text);
    log_debug("train", "level=%u time: %s", l->stage.at + 1, text);
    return metrics_log_line(l->metrics, "time",
                            json_pack("{s:i, s:f, s:o}", "level", (int)l->stage.at + 1, "seconds",
                                      timing_total(&here), "timing", timing_json(&here)),
                            e);
}

/* The steps that the level in work has left. */
static enum err_code run_steps_left(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    char what[48];
    snprintf(what, sizeof what, "train level %u/%u", l->stage.at + 1, l->stage.n_levels);
    progress_start(&t->progress, what, l->stage.levels[l->stage.at].steps);
    (void)timing_turn(&l->timing, TIMING_STEP);
    t->looked_s = clock_s();
    t->looked_step = l->stage.step;
    t->looked_compile_s = l->engine.dev->compile_s;
    enum err_code rc = run_steps(t, e);
    if (!rc)
        rc = dev_finish(l->engine.dev, e);
    (void)timing_turn(&l->timing, TIMING_OTHER);
    progress_end(&t->progress, NULL);
    return rc;
}

static enum err_code run_levels(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = level_begin(l, e);
    while (!rc && l->stage.at < l->stage.n_levels) {
        rc = run_steps_left(t, e);
        if (!rc)
            rc = run_finish_level(t, e);
        if (!rc)
            rc = run_report_spent(t, e);
        if (!rc)
            rc = level_next(l, e);
    }
    return rc;
}

/* ---- one network for all levels ---- */

/* The steps of a fit after the levels. The state that was saved before it is where it begins. */
static enum err_code run_refit_steps(struct run *t, const char *what, struct err *e)
{
    struct level *l = &t->level;
    struct progress progress = {0};
    uint32_t steps = l->stage.levels[l->stage.at].steps;
    enum err_code rc = ERR_OK;
    progress_start(&progress, what, steps);
    while (!rc && l->stage.step < steps) {
        rc = level_step(l, NULL, e);
        (*t->job->steps)++;
        if (l->stage.step % RUN_LOOK_STEPS == 0)
            progress_step(&progress, l->stage.step, "");
        bool enough = t->cfg->stop_after > 0 && *t->job->steps >= (uint64_t)t->cfg->stop_after;
        if (!rc && (signals_stopping() || enough))
            rc = err_set(e, ERR_CANCEL,
                         "stopped while %s; the state is saved: the same command with --resume "
                         "goes on",
                         what);
    }
    if (!rc)
        rc = dev_finish(l->engine.dev, e);
    progress_end(&progress, NULL);
    return rc;
}

/* Level `at` (from 0), when its network is not that of the finest. */
static enum err_code run_refit_level(struct run *t, uint32_t at, struct err *e)
{
    struct level *l = &t->level;
    struct level_refit r = {0};
    struct evaluate_score score = {0};
    char path[FILE_PATH_MAX], what[80];
    enum err_code rc = begin_level_path(&t->begin, at + 1, path, e);
    if (!rc)
        rc = level_refit_open(&r, l, at, path, e);
    if (rc || !r.needed)
        return rc;
    (void)timing_turn(&l->timing, TIMING_STEP);
    snprintf(what, sizeof what, "level %u of %u takes over the appearance network", at + 1,
             l->stage.n_levels);
    rc = run_refit_steps(t, what, e);
    (void)timing_turn(&l->timing, TIMING_PRUNE);
    if (!rc)
        rc = level_refit_finish(l, e);
    (void)timing_turn(&l->timing, TIMING_EVALUATE);
    if (!rc && t->job->n_test)
        rc = run_score(t, &score, e);
    level_refit_end(&r, l);
    (void)timing_turn(&l->timing, TIMING_CHECKPOINT);
    if (!rc)
        rc = level_save_result(l, path, score.n_photos ? &score : NULL, e);
    (void)timing_turn(&l->timing, TIMING_OTHER);
    if (rc)
        return rc;
    t->result->psnr_db[at] = score.n_photos ? score.psnr_db : (double)NAN;
    t->result->ssim[at] = score.n_photos ? score.ssim : (double)NAN;
    log_info("train", "level=%u has the appearance network of the finest level", at + 1);
    return metrics_log_line(l->metrics, "refit",
                            json_pack("{s:i, s:o, s:o}", "level", (int)at + 1, "psnr_db",
                                      jsonc_real(score.psnr_db), "ssim", jsonc_real(score.ssim)),
                            e);
}

static enum err_code run_refit(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = ERR_OK;
    if (!refit_wanted(&l->appearance, &l->stage))
        return ERR_OK;
    for (uint32_t at = l->stage.n_levels - 1; !rc && at-- > 0;)
        rc = run_refit_level(t, at, e);
    if (!rc)
        level_end(l);
    return rc;
}

/* ---- a last fit with all photographs ---- */

/* The finest level is not the one in work where coarser levels were made of it. */
static enum err_code run_back_to_finest(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    char path[FILE_PATH_MAX];
    if (!l->stage.turned || l->stage.n_levels == 1)
        return ERR_OK;
    (void)timing_turn(&l->timing, TIMING_CHECKPOINT);
    enum err_code rc = begin_finest_path(&t->begin, path, e);
    return rc ? rc : level_back(l, path, e);
}

/* The level that is there now was trained without the photographs that score it. Its scores stay
 * those. */
static enum err_code run_last(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    const struct begin *b = &t->begin;
    struct level_last last;
    const uint32_t finest = l->stage.n_levels - 1;
    const struct evaluate_score score = {.n_photos = t->job->n_test,
                                         .psnr_db = t->result->psnr_db[finest],
                                         .ssim = t->result->ssim[finest]};
    char path[FILE_PATH_MAX];
    if (!begin_wants_last(b))
        return ERR_OK;
    enum err_code rc = run_back_to_finest(t, e);
    if (!rc)
        rc = begin_level_path(b, finest + 1, path, e);
    if (rc)
        return rc;
    (void)timing_turn(&l->timing, TIMING_STEP);
    rc = level_last_open(&last, l, b->all, b->n_all, b->windows, e);
    uint32_t steps = l->stage.levels[l->stage.at].steps;
    if (!rc)
        rc = run_refit_steps(t, "the finest level trains with all photographs", e);
    if (!rc)
        rc = level_refit_finish(l, e); /* harmonics are held to where all photographs stood */
    level_last_end(&last, l);
    (void)timing_turn(&l->timing, TIMING_CHECKPOINT);
    if (!rc)
        rc = level_save_result(l, path, &score, e);
    (void)timing_turn(&l->timing, TIMING_OTHER);
    if (rc)
        return rc;
    level_end(l);
    log_info("train",
             "level=%u trained %u steps more with all %zu photographs; its scores are of "
             "before",
             l->stage.n_levels, steps, b->n_all);
    return metrics_log_line(l->metrics, "last",
                            json_pack("{s:i, s:i, s:I}", "level", (int)l->stage.n_levels, "steps",
                                      (int)steps, "photographs", (json_int_t)b->n_all),
                            e);
}

/* Nothing is left to go on from. */
static void run_remove_states(const struct run *t)
{
    char path[FILE_PATH_MAX];
    struct err ignored = {0};
    (void)unlink(t->begin.resume_path);
    if (!begin_finest_path(&t->begin, path, &ignored))
        (void)unlink(path);
}

enum err_code run_cell(const struct run_cell *job, struct train_cell_result *out, struct err *e)
{
    struct run *t = mem_array(1, sizeof *t);
    struct timing clock;
    bool done = false;
    if (!t)
        return err_set(e, ERR_MEM, "train: out of memory");
    t->job = job;
    t->cfg = job->cfg;
    t->result = out;
    t->start_s = clock_s();
    t->begin.job = job;
    t->begin.lock_fd = -1;
    timing_start(&clock, TIMING_START);
    *out = (struct train_cell_result){.n_levels = (uint32_t)job->cfg->level_count};
    memcpy(out->id, job->cell.id, sizeof out->id);
    for (size_t i = 0; i < TRAIN_LEVELS_MAX; i++) /* not known, which 0 would not say */
        out->psnr_db[i] = out->ssim[i] = (double)NAN;
    enum err_code rc = begin_run(&t->begin, out, &done, e);
    if (!rc && !done) {
        rc = run_start(t, &clock, e);
        if (!rc)
            rc = run_levels(t, e);
        if (!rc)
            rc = run_refit(t, e);
        if (!rc)
            rc = run_last(t, e);
        out->seconds = run_seconds(t);
        out->timing = timing_now(&t->level.timing);
        if (!rc)
            rc = done_write(t->begin.dir, out, e);
        if (!rc)
            run_remove_states(t);
    }
    level_close(&t->level);
    metrics_log_close(&t->level.metrics);
    begin_close(&t->begin);
    mem_free(t);
    return rc;
}
