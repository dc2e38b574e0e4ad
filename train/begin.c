/* Everything up to the first step of a cell: where results go, whether they are there already,
 * which photographs train and how many Gaussians there may be, what is known of the ground, the
 * first Gaussians or those of an interrupted run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/begin.h"

#include <errno.h>
#include <stdio.h>
#include <unistd.h>

#include <jansson.h>

#include "train/appearance_train.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/done.h"
#include "train/init.h"
#include "train/memory.h"
#include "train/metrics_log.h"
#include "train/result.h"
#include "train/run_cell.h"
#include "train/schedule.h"
#include "train/state.h"
#include "train/state_check.h"

enum { BEGIN_SURE = 5 }; /* photographs that know how far away a thing is */

enum err_code begin_level_path(const struct run *t, uint32_t level, char *out, struct err *e)
{
    char name[32];
    snprintf(name, sizeof name, "level%u.ckpt", level);
    return file_join(out, t->dir, name, e);
}

static enum err_code begin_paths(struct run *t, const char *base, struct err *e)
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
static enum err_code begin_write_config(const struct run *t, struct err *e)
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

static enum err_code begin_open_metrics(struct run *t, struct err *e)
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
static enum err_code begin_is_done(struct run *t, bool *done, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct train_cell_result was;
    struct err why = {0};
    *done = false;
    if ((t->cfg->overwrite && !t->job->reuse) || (t->cfg->resume && file_exists(t->resume_path)) ||
        done_read(t->dir, &was, &why))
        return ERR_OK;
    enum err_code rc = begin_level_path(t, was.n_levels, path, e);
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
static enum err_code begin_forget_done(const struct run *t, struct err *e)
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
static enum err_code begin_earlier_levels(struct run *t, struct err *e)
{
    struct train_cell_result *r = t->result;
    enum err_code rc = ERR_OK;
    for (uint32_t i = 0; !rc && i < t->level.ctx.at; i++) {
        char path[FILE_PATH_MAX];
        rc = begin_level_path(t, i + 1, path, e);
        if (!rc)
            rc = state_read_level(path, &r->n_gaussians[i], &r->psnr_db[i], &r->ssim[i], e);
        if (rc)
            err_add(e, "level %u of the run to go on with: leave out --resume to start anew",
                    i + 1);
    }
    return rc;
}

static enum err_code begin_start(struct run *t, struct err *e)
{
    struct gauss g = {0};
    struct level *l = &t->level;
    if (t->cfg->resume && file_exists(t->resume_path)) {
        enum err_code rc = state_load(&l->model, &l->ctx, &l->budget, t->resume_path, e);
        if (!rc)
            rc = begin_earlier_levels(t, e);
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
    enum err_code rc = t->job->coarse ? init_coarse(&first, t->job->coarse, &g, e) : ERR_OK;
    if (!rc && !g.n) /* no coarse model, or nothing of it is seen here */
        rc = init_gauss(&first, &g, e);
    if (!rc && appearance_train_is_on(&l->ctx.appearance) && !g.embed_len)
        rc = appearance_train_embed(&l->ctx.appearance, (uint64_t)t->cfg->seed, &g, e);
    if (!rc)
        rc = level_open(l, &g, e);
    gauss_free(&g);
    return rc;
}

/* Which photographs train, and how many Gaussians each level may have. */
static enum err_code begin_budget(struct run *t, struct err *e)
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
    if (t->cfg->budget_rule == BUDGET_AUTO && !n_held)
        log_warn("train", "%zu photographs are too few to hold any out: --budget-rule fit is used",
                 job->n_images);
    enum err_code rc = schedule_make(t->cfg, l->ctx.n_images, &l->ctx.cell, l->ctx.schedule, e);
    if (!rc)
        rc = init_count_points(l->ctx.scene, l->ctx.images, l->ctx.n_images, &l->ctx.cell,
                               &n_points, e);
    for (uint32_t i = 0; i < l->ctx.n_levels; i++)
        l->budget.table[i] = l->ctx.schedule[i].budget;
    size_t around = !rc && t->job->coarse
                        ? init_count_around(t->job->coarse, l->ctx.scene, l->ctx.images,
                                            l->ctx.n_images, &l->ctx.cell)
                        : 0;
    for (uint32_t i = 0; i < l->ctx.n_levels; i++)
        l->ctx.schedule[i].around = around;
    if (!rc)
        budget_limit(l->ctx.scene, l->ctx.images, l->ctx.n_images, t->cfg, n_points,
                     l->ctx.schedule);
    return rc;
}

/* What people need to know before days of computing. */
static void begin_tell_memory(const struct run *t)
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
static void begin_tell_length(const struct run *t)
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
             t->cfg->iterations.one ? "" : ": the full method; --iterations N makes it shorter");
}

/* A network that is warmed up for longer than its level learns nothing. */
static enum err_code begin_check_warmup(const struct run *t, struct err *e)
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
static enum err_code begin_poses(struct run *t, struct err *e)
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

/* What the sparse points and photographs say about where there can be Gaussians. */
static enum err_code begin_ground(struct run *t, struct err *e)
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
    return trim_open(t->job->scene, &t->ground, BEGIN_SURE, t->cfg->free_space * t->ground.height_m,
                     &t->rim, e);
}

enum err_code begin_run(struct run *t, bool *done, struct err *e)
{
    const struct run_cell *job = t->job;
    enum err_code rc = begin_budget(t, e);
    if (!rc)
        rc = begin_paths(t, job->base_dir, e);
    if (!rc && appearance_train_wanted(job->cfg))
        rc = appearance_train_open(&t->level.ctx.appearance, job->cfg, job->scene, job->images,
                                   job->n_images, job->shared, e);
    if (!rc)
        rc = begin_check_warmup(t, e);
    if (!rc)
        rc = done_lock(t->dir, &t->lock_fd, e);
    if (!rc)
        rc = begin_is_done(t, done, e);
    if (rc || *done)
        return rc;
    rc = begin_forget_done(t, e);
    if (rc)
        return rc;
    begin_tell_memory(t);
    begin_tell_length(t);
    rc = begin_ground(t, e);
    if (!rc)
        rc = begin_poses(t, e);
    if (!rc)
        rc = begin_start(t, e);
    if (!rc)
        rc = begin_write_config(t, e);
    return rc ? rc : begin_open_metrics(t, e);
}
