/* One cell from its first step to its last level (begin.c has what comes before): go through the
 * levels, score and save each, leave a state to resume from whenever the run is interrupted.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

#include "loss/photometric.h"
#include "train/appearance_train.h"
#include "train/begin.h"
#include "train/config.h"
#include "train/done.h"
#include "train/evaluate.h"
#include "train/harmonics.h"
#include "train/metrics_log.h"
#include "train/photo_loader.h"
#include "train/prune.h"
#include "train/refit.h"
#include "train/residual.h"
#include "train/result.h"
#include "train/run.h"
#include "train/schedule.h"
#include "train/state.h"

enum { RUN_LOOK_STEPS = 20, RUN_LINE_STEPS = 100, RUN_FORECAST_LOOKS = 3 };

/* ---- the loop ---- */

static enum err_code run_save(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = dev_finish(l->ctx.dev, e);
    enum timing_on was = timing_turn(&l->ctx.timing, TIMING_CHECKPOINT);
    if (!rc)
        rc = state_save(&l->model, &l->ctx, &l->budget, t->resume_path, e);
    (void)timing_turn(&l->ctx.timing, was);
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
        l->ctx.at + 1, l->ctx.n_levels, l->ctx.step, l->ctx.schedule[l->ctx.at].steps);
}

/* What the whole run will take, said once when it can be known. */
static void run_forecast(struct run *t, char *left, size_t size)
{
    struct context *ctx = &t->level.ctx;
    double now = clock_s(), n = t->level.model.gauss.n;
    uint32_t steps = ctx->step - t->looked_step;
    forecast_add(&t->forecast, ctx, n, steps, now - t->looked_s);
    t->looked_s = now;
    t->looked_step = ctx->step;
    double rest = forecast_left_s(&t->forecast, ctx, n);
    forecast_text(rest, left, size);
    if (++t->looks == RUN_FORECAST_LOOKS)
        log_info("train", "cell=%s about %s left for the rest of all levels", ctx->cell.id, left);
}

static enum err_code run_report(struct run *t, const struct photometric_value *v, struct err *e)
{
    struct level *l = &t->level;
    char note[160], left[32];
    double psnr = l->mse_mean > 0.0 ? -10.0 * log10(l->mse_mean) : 0.0;
    run_forecast(t, left, sizeof left);
    snprintf(note, sizeof note, "%s left of all levels, loss %.4f, PSNR %.2f dB, %.1f k Gaussians",
             left, l->loss_mean, psnr, l->model.gauss.n * 1e-3);
    progress_step(&t->progress, l->ctx.step, note);
    if (l->ctx.step % RUN_LINE_STEPS && l->ctx.step != l->ctx.schedule[l->ctx.at].steps)
        return ERR_OK;
    double now = clock_s(), seconds = now - l->step_s;
    l->step_s = now;
    json_t *o =
        json_pack("{s:i, s:i, s:f, s:f, s:f, s:f, s:I, s:f, s:I, s:f}", "level", (int)l->ctx.at + 1,
                  "step", (int)l->ctx.step, "loss", v->total, "l1", v->l1, "ssim", v->ssim,
                  "psnr_mean_db", psnr, "gaussians", (json_int_t)l->model.gauss.n,
                  "s_since_last_line", seconds, "photo_loader_bytes",
                  (json_int_t)photo_loader_bytes(l->ctx.photos), "opacity_offset", l->offset_mean);
    return metrics_log_line(l->ctx.metrics, "step", o, e);
}

static enum err_code run_steps(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    uint32_t steps = l->ctx.schedule[l->ctx.at].steps;
    while (l->ctx.step < steps) {
        struct photometric_value v;
        uint32_t next = l->ctx.step + 1;
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
            l->ctx.step < steps) {
            t->last_saved = *t->job->steps;
            rc = run_save(t, e);
            if (rc)
                return rc;
        }
    }
    return ERR_OK;
}

static enum err_code run_score(struct run *t, struct evaluate_score *out, struct err *e)
{
    struct level *l = &t->level;
    struct photo_loader *photos = NULL;
    struct photo_loader_config f = {
        .scene = l->ctx.scene,
        .images = t->job->test_images,
        .n_images = t->job->n_test,
        .max_edge_px = (uint32_t)t->cfg->max_edge_px,
        .downsample = l->ctx.schedule[l->ctx.at].downsample,
        .cache_bytes = (size_t)64 << 20,
        .exposure = t->cfg->exposure ? PHOTO_LOADER_TOLD : PHOTO_LOADER_AS_TAKEN,
    };
    struct appearance_view appearance = {0};
    struct evaluate_model model = {l->ctx.render, &l->model.gauss,
                                   context_render_options(&l->ctx, l->ctx.step),
                                   appearance_train_is_on(&l->ctx.appearance) ? &appearance : NULL};
    struct evaluate_source source = {.draw = evaluate_draw_model, .user = &model};
    enum err_code rc = photo_loader_open(&f, &photos, e);
    if (!rc && model.appearance)
        rc = appearance_view_open(&appearance, &l->ctx.appearance.model, l->ctx.scene, e);
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
        rc = file_join(path, t->dir, "residuals.json", e);
    if (!rc)
        rc = residual_write(r, path, l->ctx.cell.id, e);
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
    bool finest = l->ctx.at + 1 == l->ctx.n_levels;
    enum err_code rc =
        l->ctx.pruned ? ERR_OK : prune_level(&l->model, &l->ctx, &r, finest ? &residuals : NULL, e);
    if (!rc && !l->ctx.pruned)
        rc = harmonics_level(&l->model, &l->ctx, e);
    l->ctx.pruned = !rc;
    if (!rc)
        rc = run_residuals(t, &residuals, e);
    residual_free(&residuals);
    if (rc || !(r.faint + r.unsupported))
        return rc;
    log_info("train",
             "level=%u prune before=%zu faint=%zu unsupported=%zu removed=%zu train_psnr_db=%.3f "
             "lost_db=%.3f",
             l->ctx.at + 1, r.before, r.faint, r.unsupported, r.removed, r.psnr_before_db,
             r.lost_db);
    return metrics_log_line(l->ctx.metrics, "prune",
                            json_pack("{s:i, s:I, s:I, s:I, s:I, s:o, s:f}", "level",
                                      (int)l->ctx.at + 1, "before", (json_int_t)r.before, "faint",
                                      (json_int_t)r.faint, "unsupported", (json_int_t)r.unsupported,
                                      "removed", (json_int_t)r.removed, "psnr_before_db",
                                      jsonc_real(r.psnr_before_db), "lost_db", r.lost_db),
                            e);
}

/* Score and save the level in work, and remove results of finer levels, which belong to an older
 * run. */
static enum err_code run_finish_level(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    struct evaluate_score score = {0};
    char path[FILE_PATH_MAX];
    uint32_t k = l->ctx.at + 1;
    (void)timing_turn(&l->ctx.timing, TIMING_PRUNE);
    enum err_code rc = run_prune(t, e);
    if (!rc)
        rc = context_filter(&l->ctx, &l->model, e);
    (void)timing_turn(&l->ctx.timing, TIMING_EVALUATE);
    if (!rc && t->job->n_test)
        rc = run_score(t, &score, e);
    if (rc == ERR_CANCEL)
        return run_stop(t, e);
    (void)timing_turn(&l->ctx.timing, TIMING_CHECKPOINT);
    if (!rc && k == l->ctx.n_levels && refit_wanted(l))
        rc = run_save(t, e); /* what follows can be interrupted, and begins here */
    if (!rc)
        rc = begin_level_path(t, k, path, e);
    if (!rc)
        rc = state_save_level(&l->model, &l->ctx, &l->budget, path, t->job->n_test ? &score : NULL,
                              e);
    (void)timing_turn(&l->ctx.timing, TIMING_OTHER);
    for (uint32_t j = k + 1; !rc && j <= TRAIN_LEVELS_MAX; j++) {
        rc = begin_level_path(t, j, path, e);
        if (!rc)
            (void)unlink(path);
    }
    if (rc)
        return rc;
    double seconds = context_seconds(&l->ctx);
    t->result->n_gaussians[l->ctx.at] = l->model.gauss.n;
    t->result->psnr_db[l->ctx.at] = t->job->n_test ? score.psnr_db : (double)NAN;
    t->result->ssim[l->ctx.at] = t->job->n_test ? score.ssim : (double)NAN;
    if (t->job->n_test)
        log_info("train",
                 "level=%u done gaussians=%u test_psnr_db=%.3f test_ssim=%.4f seconds=%.1f", k,
                 l->model.gauss.n, score.psnr_db, score.ssim, seconds);
    else
        log_info("train", "level=%u done gaussians=%u seconds=%.1f", k, l->model.gauss.n, seconds);
    return metrics_log_line(
        l->ctx.metrics, "level",
        json_pack("{s:i, s:I, s:I, s:o, s:o, s:o, s:f, s:f, s:I}", "level", (int)k, "gaussians",
                  (json_int_t)l->model.gauss.n, "test_photographs", (json_int_t)t->job->n_test,
                  "psnr_db", jsonc_real(score.psnr_db), "ssim", jsonc_real(score.ssim),
                  "ssim_valid", jsonc_real(score.ssim_valid), "ms_frame", score.ms_frame, "seconds",
                  seconds, "peak_bytes", (json_int_t)mem_peak_bytes()),
        e);
}

/* Where the level's time went. */
static enum err_code run_report_spent(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    char text[512];
    struct timing_seconds now = timing_now(&l->ctx.timing),
                          here = timing_since(&now, &t->spent_before);
    t->spent_before = now;
    timing_text(&here, text, sizeof text);
    log_debug("train", "level=%u time: %s", l->ctx.at + 1, text);
    return metrics_log_line(l->ctx.metrics, "time",
                            json_pack("{s:i, s:f, s:o}", "level", (int)l->ctx.at + 1, "seconds",
                                      timing_total(&here), "timing", timing_json(&here)),
                            e);
}

static enum err_code run_levels(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = level_begin(l, e);
    while (!rc && l->ctx.at < l->ctx.n_levels) {
        char what[48];
        snprintf(what, sizeof what, "train level %u/%u", l->ctx.at + 1, l->ctx.n_levels);
        progress_start(&t->progress, what, l->ctx.schedule[l->ctx.at].steps);
        (void)timing_turn(&l->ctx.timing, TIMING_STEP);
        t->looked_s = clock_s();
        t->looked_step = l->ctx.step;
        rc = run_steps(t, e);
        if (!rc)
            rc = dev_finish(l->ctx.dev, e);
        (void)timing_turn(&l->ctx.timing, TIMING_OTHER);
        progress_end(&t->progress, NULL);
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

static enum err_code run_refit_steps(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    struct progress progress = {0};
    uint32_t steps = l->ctx.schedule[l->ctx.at].steps;
    enum err_code rc = ERR_OK;
    char what[64];
    snprintf(what, sizeof what, "level %u/%u takes over the network", l->ctx.at + 1,
             l->ctx.n_levels);
    progress_start(&progress, what, steps);
    while (!rc && l->ctx.step < steps) {
        rc = level_step(l, NULL, e);
        (*t->job->steps)++;
        if (l->ctx.step % RUN_LOOK_STEPS == 0)
            progress_step(&progress, l->ctx.step, "");
        bool enough = t->cfg->stop_after > 0 && *t->job->steps >= (uint64_t)t->cfg->stop_after;
        if (!rc && (signals_stopping() || enough))
            rc = err_set(e, ERR_CANCEL,
                         "stopped while level %u of %u takes over the appearance network; the "
                         "state is saved: the same command with --resume goes on",
                         l->ctx.at + 1, l->ctx.n_levels);
    }
    if (!rc)
        rc = dev_finish(l->ctx.dev, e);
    progress_end(&progress, NULL);
    return rc;
}

/* Level `at` (from 0), when its network is not that of the finest. */
static enum err_code run_refit_level(struct run *t, uint32_t at, struct err *e)
{
    struct level *l = &t->level;
    struct refit r = {0};
    struct evaluate_score score = {0};
    char path[FILE_PATH_MAX];
    enum err_code rc = begin_level_path(t, at + 1, path, e);
    if (!rc)
        rc = refit_open(&r, l, at, path, e);
    if (rc || !r.needed)
        return rc;
    (void)timing_turn(&l->ctx.timing, TIMING_STEP);
    rc = run_refit_steps(t, e);
    (void)timing_turn(&l->ctx.timing, TIMING_PRUNE);
    if (!rc)
        rc = harmonics_level(&l->model, &l->ctx, e);
    (void)timing_turn(&l->ctx.timing, TIMING_EVALUATE);
    if (!rc && t->job->n_test)
        rc = run_score(t, &score, e);
    refit_end(&r, l);
    (void)timing_turn(&l->ctx.timing, TIMING_CHECKPOINT);
    if (!rc)
        rc = state_save_level(&l->model, &l->ctx, &l->budget, path, t->job->n_test ? &score : NULL,
                              e);
    (void)timing_turn(&l->ctx.timing, TIMING_OTHER);
    if (rc)
        return rc;
    t->result->psnr_db[at] = t->job->n_test ? score.psnr_db : (double)NAN;
    t->result->ssim[at] = t->job->n_test ? score.ssim : (double)NAN;
    log_info("train", "level=%u has the appearance network of the finest level", at + 1);
    return metrics_log_line(l->ctx.metrics, "refit",
                            json_pack("{s:i, s:o, s:o}", "level", (int)at + 1, "psnr_db",
                                      jsonc_real(score.psnr_db), "ssim", jsonc_real(score.ssim)),
                            e);
}

static enum err_code run_refit(struct run *t, struct err *e)
{
    struct context *ctx = &t->level.ctx;
    enum err_code rc = ERR_OK;
    if (!refit_wanted(&t->level))
        return ERR_OK;
    for (uint32_t at = ctx->n_levels - 1; !rc && at-- > 0;)
        rc = run_refit_level(t, at, e);
    if (!rc)
        ctx->at = ctx->n_levels;
    return rc;
}

/* What became of them. */
static enum err_code run_tell_poses(const struct run *t, struct err *e)
{
    const struct context *ctx = &t->level.ctx;
    char path[FILE_PATH_MAX];
    if (!ctx->poses.n)
        return ERR_OK;
    struct pose_report r = pose_describe(&ctx->poses);
    log_info("train",
             "poses moved by %.3f m and %.3f degrees (root mean squares), at most %.3f m and %.3f "
             "degrees: poses.json",
             r.rms_m, r.rms_deg, r.largest_m, r.largest_deg);
    enum err_code rc = file_join(path, t->dir, "poses.json", e);
    return rc ? rc : pose_write(&ctx->poses, ctx->scene, path, e);
}

enum err_code run_cell(const struct run_cell *job, struct train_cell_result *out, struct err *e)
{
    struct run *t = mem_array(1, sizeof *t);
    bool done = false;
    if (!t)
        return err_set(e, ERR_MEM, "train: out of memory");
    t->job = job;
    t->lock_fd = -1;
    t->cfg = job->cfg;
    t->result = out;
    t->level.ctx = (struct context){.cfg = job->cfg,
                                    .scene = job->scene,
                                    .images = job->images,
                                    .n_images = job->n_images,
                                    .dev = job->dev,
                                    .render = job->render,
                                    .loss = job->loss,
                                    .cell = job->cell,
                                    .start_s = clock_s(),
                                    .n_levels = (uint32_t)job->cfg->level_count};
    timing_start(&t->level.ctx.timing, TIMING_START);
    *out = (struct train_cell_result){.n_levels = t->level.ctx.n_levels};
    memcpy(out->id, job->cell.id, sizeof out->id);
    for (size_t i = 0; i < TRAIN_LEVELS_MAX; i++) /* not known, which 0 would not say */
        out->psnr_db[i] = out->ssim[i] = (double)NAN;
    enum err_code rc = begin_run(t, &done, e);
    if (!rc && !done) {
        rc = run_levels(t, e);
        if (!rc)
            rc = run_refit(t, e);
        out->seconds = context_seconds(&t->level.ctx);
        out->timing = timing_now(&t->level.ctx.timing);
        if (!rc)
            rc = run_tell_poses(t, e);
        if (!rc)
            rc = done_write(t->dir, out, e);
        if (!rc)
            (void)unlink(t->resume_path); /* nothing is left to go on from */
    }
    level_close(&t->level);
    metrics_log_close(&t->level.ctx.metrics);
    done_unlock(&t->lock_fd);
    trim_free(&t->rim);
    footprint_free(&t->ground);
    mem_free(t->images);
    mem_free(t);
    return rc;
}
