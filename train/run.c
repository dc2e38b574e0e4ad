/* One cell from its first Gaussians to its last level: start or resume, go through the levels,
 * score and save each, leave a state to resume from whenever the run is interrupted.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

#include "cells/footprint.h"
#include "cells/trim.h"
#include "loss/photometric.h"
#include "train/appearance_train.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/done.h"
#include "train/evaluate.h"
#include "train/forecast.h"
#include "train/init.h"
#include "train/level.h"
#include "train/memory.h"
#include "train/metrics_log.h"
#include "train/photo_loader.h"
#include "train/prune.h"
#include "train/residual.h"
#include "train/result.h"
#include "train/run.h"
#include "train/schedule.h"
#include "train/state.h"
#include "train/state_check.h"
#include "train/timing.h"

enum { RUN_SURE = 5 }; /* photographs that know how far away a thing is */
enum { RUN_LOOK_STEPS = 20, RUN_LINE_STEPS = 100, RUN_FORECAST_LOOKS = 3 };

struct run {
    struct level level;
    const struct run_cell *job; /* borrowed */
    const struct train_config *cfg;
    char dir[FILE_PATH_MAX], resume_path[FILE_PATH_MAX];
    struct progress progress;
    struct timing_seconds spent_before; /* when the level in work began */
    struct forecast forecast;
    double looked_s;      /* when steps were last counted for it */
    uint32_t looked_step; /* the step of that look */
    uint32_t looks;
    uint64_t last_saved; /* steps of this process when the state was last saved */
    struct train_cell_result *result;
    uint32_t *images; /* training, then held-out photographs */
    struct footprint ground;
    struct trim rim;
    int lock_fd;
};

static enum err_code run_level_path(const struct run *t, uint32_t level, char *out, struct err *e)
{
    char name[32];
    snprintf(name, sizeof name, "level%u.ckpt", level);
    return file_join(out, t->dir, name, e);
}

static enum err_code run_paths(struct run *t, const char *base, struct err *e)
{
    char cells[FILE_PATH_MAX];
    enum err_code rc = file_join(cells, base, "cells", e);
    if (!rc)
        rc = file_join(t->dir, cells, t->level.ctx.cell.id, e);
    if (!rc)
        rc = file_join(t->resume_path, t->dir, "resume.ckpt", e);
    return rc ? rc : file_mkdir(t->dir, e);
}

/* The resolved options beside the results: feeding the file back repeats the run. */
static enum err_code run_write_config(const struct run *t, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *o = NULL;
    enum err_code rc = file_join(path, t->dir, "config.jsonc", e);
    if (!rc)
        rc = options_to_json(train_options(), t->cfg, &o, e);
    if (!rc)
        rc = jsonc_write(path, o, e);
    json_decref(o);
    return rc;
}

static enum err_code run_open_metrics(struct run *t, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct level *l = &t->level;
    const char *event = t->cfg->resume ? "resume" : "start";
    enum err_code rc = file_join(path, t->dir, "metrics.jsonl", e);
    if (!rc)
        rc = metrics_log_open(path, t->cfg->resume, &l->ctx.metrics, e);
    if (rc)
        return rc;
    return metrics_log_line(
        l->ctx.metrics, event,
        json_pack("{s:s, s:s, s:I, s:I, s:I, s:i, s:i, s:f, s:f}", "cell", l->ctx.cell.id, "device",
                  l->ctx.dev->name, "photographs", (json_int_t)l->ctx.n_images, "test_photographs",
                  (json_int_t)t->job->n_test, "gaussians", (json_int_t)l->model.gauss.n, "level",
                  (int)l->ctx.at + 1, "step", (int)l->ctx.step, "edge_m", l->ctx.cell.edge_m,
                  "extent_m", l->ctx.cell.extent_m),
        e);
}

/* A folder that is complete: with these options there is nothing to do, with others its results are
 * replaced only when that was asked for. */
static enum err_code run_is_done(struct run *t, bool *done, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct train_cell_result was;
    struct err why = {0};
    *done = false;
    if ((t->cfg->overwrite && !t->job->reuse) || (t->cfg->resume && file_exists(t->resume_path)) ||
        done_read(t->dir, &was, &why))
        return ERR_OK;
    enum err_code rc = run_level_path(t, was.n_levels, path, e);
    if (rc)
        return rc;
    if (state_check_result(&t->level.ctx, path, &why))
        return t->cfg->overwrite
                   ? ERR_OK
                   : err_set(
                         e, ERR_ARG,
                         "%s holds a finished run with other options (%s): --overwrite replaces "
                         "it, --output DIR keeps both",
                         t->dir, why.msg);
    *done = true;
    *t->result = was;
    t->result->was_done = true;
    return ERR_OK;
}

/* What follows will not be what the done-file tells of, nor the residuals of another run. */
static enum err_code run_forget_done(const struct run *t, struct err *e)
{
    const char *const names[] = {"done.json", "residuals.json", "poses.json"};
    bool goes_on = t->cfg->resume && file_exists(t->resume_path);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < (goes_on ? 1 : sizeof names / sizeof *names); i++) {
        char path[FILE_PATH_MAX];
        rc = file_join(path, t->dir, names[i], e);
        if (!rc && unlink(path) && errno != ENOENT)
            rc = err_errno(e, ERR_IO, "%s: cannot be removed", path);
    }
    return rc;
}

/* Levels that were finished before this process. */
static enum err_code run_earlier_levels(struct run *t, struct err *e)
{
    struct train_cell_result *r = t->result;
    enum err_code rc = ERR_OK;
    for (uint32_t i = 0; !rc && i < t->level.ctx.at; i++) {
        char path[FILE_PATH_MAX];
        rc = run_level_path(t, i + 1, path, e);
        if (!rc)
            rc = state_read_level(path, &r->n_gaussians[i], &r->psnr_db[i], &r->ssim[i], e);
        if (rc)
            err_add(e, "level %u of the run to go on with: leave out --resume to start anew",
                    i + 1);
    }
    return rc;
}

static enum err_code run_start(struct run *t, struct err *e)
{
    struct gauss g = {0};
    struct level *l = &t->level;
    if (t->cfg->resume && file_exists(t->resume_path)) {
        enum err_code rc = state_load(&l->model, &l->ctx, &l->budget, t->resume_path, e);
        if (!rc)
            rc = run_earlier_levels(t, e);
        if (!rc)
            log_info("train", "resume cell=%s level=%u step=%u gaussians=%u", l->ctx.cell.id,
                     l->ctx.at + 1, l->ctx.step, l->model.gauss.n);
        return rc;
    }
    if (file_exists(t->resume_path))
        log_warn(
            "train",
            "%s of an unfinished run is ignored and will be replaced; --resume goes on from it",
            t->resume_path);
    const struct init_input first = {.scene = l->ctx.scene,
                                     .images = l->ctx.images,
                                     .n_images = l->ctx.n_images,
                                     .cell = &l->ctx.cell,
                                     .ground = l->ctx.ground,
                                     .ground_share = t->cfg->seed_ground,
                                     .no_masks = !t->cfg->masks,
                                     .sh_degree = (uint32_t)t->cfg->sh_degree,
                                     .limit = l->ctx.schedule[0].budget,
                                     .seed = (uint64_t)t->cfg->seed};
    enum err_code rc = init_gauss(&first, &g, e);
    if (!rc && appearance_train_is_on(&l->ctx.appearance))
        rc = appearance_train_embed(&l->ctx.appearance, (uint64_t)t->cfg->seed, &g, e);
    if (!rc)
        rc = level_open(l, &g, e);
    gauss_free(&g);
    return rc;
}

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
    if (!rc)
        rc = run_level_path(t, k, path, e);
    if (!rc)
        rc = state_save_level(&l->model, &l->ctx, &l->budget, path, t->job->n_test ? &score : NULL,
                              e);
    (void)timing_turn(&l->ctx.timing, TIMING_OTHER);
    for (uint32_t j = k + 1; !rc && j <= TRAIN_LEVELS_MAX; j++) {
        rc = run_level_path(t, j, path, e);
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

/* Which photographs train, and how many Gaussians each level may have. */
static enum err_code run_budget(struct run *t, struct err *e)
{
    struct level *l = &t->level;
    const struct run_cell *job = t->job;
    size_t n_points = 0, n_held = 0;
    t->images = mem_array(2 * job->n_images, sizeof *t->images);
    if (!t->images)
        return err_set(e, ERR_MEM, "train: out of memory for %zu photographs", job->n_images);
    uint32_t *held = t->images + job->n_images;
    budget_hold_out(t->cfg, job->images, job->n_images, t->images, &l->ctx.n_images, held, &n_held);
    l->ctx.images = t->images;
    l->budget.held = held;
    l->budget.n_held = n_held;
    if (t->cfg->budget == BUDGET_AUTO && !n_held)
        log_warn("train", "%zu photographs are too few to hold any out: --budget fit is used",
                 job->n_images);
    enum err_code rc = schedule_make(t->cfg, l->ctx.n_images, &l->ctx.cell, l->ctx.schedule, e);
    if (!rc)
        rc = init_count_points(l->ctx.scene, l->ctx.images, l->ctx.n_images, &l->ctx.cell,
                               &n_points, e);
    for (uint32_t i = 0; i < l->ctx.n_levels; i++)
        l->budget.table[i] = l->ctx.schedule[i].budget;
    if (!rc)
        budget_limit(l->ctx.scene, l->ctx.images, l->ctx.n_images, t->cfg, n_points,
                     l->ctx.schedule);
    return rc;
}

/* What people need to know before days of computing. */
static void run_tell_memory(const struct run *t)
{
    const struct level *l = &t->level;
    struct memory_need m = memory_estimate(t->cfg, l->ctx.scene, l->ctx.images, l->ctx.n_images,
                                           l->ctx.schedule, l->ctx.n_levels, l->ctx.cell.whole);
    log_info("train",
             "cell=%s memory_mib<=%.0f beside the program: %zu Gaussians of %zu B, %zu pixels of "
             "%zu B, photographs %.0f MiB, neighbours %.0f MiB",
             l->ctx.cell.id, (double)m.total / 1048576.0, m.gaussians, m.per_gaussian, m.pixels,
             m.per_pixel, (double)m.photo_bytes / 1048576.0, (double)m.group_bytes / 1048576.0);
}

/* And how long it is. */
static void run_tell_length(const struct run *t)
{
    const struct context *ctx = &t->level.ctx;
    char parts[64] = "";
    double steps = 0.0;
    size_t at = 0;
    for (uint32_t i = 0; i < ctx->n_levels; i++) {
        steps += ctx->schedule[i].steps;
        at += (size_t)snprintf(parts + at, sizeof parts - at, "%s%u", i ? " + " : "",
                               ctx->schedule[i].steps);
    }
    log_info("train", "cell=%s %.0f steps, by level %s%s", ctx->cell.id, steps, parts,
             t->cfg->iterations ? "" : ": the full method; --iterations N makes it shorter");
}

/* A network that is warmed up for longer than its level learns nothing. */
static enum err_code run_check_warmup(const struct run *t, struct err *e)
{
    const struct context *ctx = &t->level.ctx;
    const struct appearance_train *a = &ctx->appearance;
    if (!appearance_train_is_on(a) || a->shared)
        return ERR_OK;
    uint32_t warmup = appearance_train_warmup(a, t->cfg, &ctx->schedule[0]);
    return warmup < ctx->schedule[0].steps
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "the appearance network would learn nothing: its warm-up of %u steps is "
                         "not shorter than the %u steps of the first level: lower "
                         "--appearance-warmup or take more steps",
                         warmup, ctx->schedule[0].steps);
}

/* Poses that move with the Gaussians. */
static enum err_code run_poses(struct run *t, struct err *e)
{
    struct context *ctx = &t->level.ctx;
    if (!t->cfg->refine_poses)
        return ERR_OK;
    if (!ctx->cell.whole)
        return err_set(e, ERR_ARG,
                       "--refine-poses: a photograph that several cells of a plan train on would "
                       "get a pose in each: train without the plan, or leave poses as they are");
    double unit_m = t->ground.nx ? t->ground.height_m : ctx->cell.extent_m;
    return pose_open(&ctx->poses, ctx->scene, ctx->images, ctx->n_images, unit_m, e);
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

/* What the sparse points and photographs say about where there can be Gaussians. */
static enum err_code run_ground(struct run *t, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (t->cfg->free_space > 0.0 || t->cfg->seed_ground > 0.0 || t->cfg->refine_poses ||
        t->cfg->trim_rim)
        rc = footprint_of(t->job->scene, &t->ground, e);
    if (rc || !t->ground.nx)
        return rc;
    t->level.ctx.ground = &t->ground;
    if (!t->cfg->trim_rim)
        return ERR_OK;
    t->level.ctx.rim = &t->rim;
    return trim_open(t->job->scene, &t->ground, RUN_SURE, t->cfg->free_space * t->ground.height_m,
                     &t->rim, e);
}

/* Everything up to the first step; *done: there is nothing to do. */
static enum err_code run_open(struct run *t, bool *done, struct err *e)
{
    const struct run_cell *job = t->job;
    enum err_code rc = run_budget(t, e);
    if (!rc)
        rc = run_paths(t, job->base_dir, e);
    if (!rc && appearance_train_wanted(job->cfg))
        rc = appearance_train_open(&t->level.ctx.appearance, job->cfg, job->scene, job->images,
                                   job->n_images, job->shared, e);
    if (!rc)
        rc = run_check_warmup(t, e);
    if (!rc)
        rc = done_lock(t->dir, &t->lock_fd, e);
    if (!rc)
        rc = run_is_done(t, done, e);
    if (rc || *done)
        return rc;
    rc = run_forget_done(t, e);
    if (rc)
        return rc;
    run_tell_memory(t);
    run_tell_length(t);
    rc = run_ground(t, e);
    if (!rc)
        rc = run_poses(t, e);
    if (!rc)
        rc = run_start(t, e);
    if (!rc)
        rc = run_write_config(t, e);
    return rc ? rc : run_open_metrics(t, e);
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
    enum err_code rc = run_open(t, &done, e);
    if (!rc && !done) {
        rc = run_levels(t, e);
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
