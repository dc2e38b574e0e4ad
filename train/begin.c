/* Everything before the first step of a cell: where results go, whether they exist already, which
 * photographs train, how many Gaussians are allowed, what is known of the ground, and the first
 * Gaussians or those of an interrupted run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/begin.h"

#include <errno.h>
#include <stdio.h>
#include <unistd.h>

#include <jansson.h>

#include "codec/scene/scene.h"
#include "core/machine.h"
#include "scene/cells/window.h"
#include "train/base/config.h"
#include "train/base/result.h"
#include "train/base/run_cell.h"
#include "train/density/budget.h"
#include "train/done.h"
#include "train/memory.h"
#include "train/model/appearance_train.h"
#include "train/model/densify_plan.h"
#include "train/model/init.h"
#include "train/photographs/depth_prior.h"
#include "train/state.h"
#include "train/state_check.h"

enum { BEGIN_SURE = 5 /* photographs that know how far away a thing is */ };

enum err_code begin_finest_path(const struct begin *t, char *out, struct err *e)
{
    return file_join(out, t->dir, BEGIN_FINEST, e);
}

enum err_code begin_level_path(const struct begin *t, uint32_t level, char *out, struct err *e)
{
    char name[32];
    snprintf(name, sizeof name, "level%u.ckpt", level);
    return file_join(out, t->dir, name, e);
}

static enum err_code begin_paths(struct begin *t, const char *base, struct err *e)
{
    char cells[FILE_PATH_MAX];
    enum err_code rc = file_join(cells, base, "cells", e);
    if (!rc)
        rc = file_join(t->dir, cells, t->job->cell.id, e);
    if (!rc)
        rc = file_join(t->resume_path, t->dir, "resume.ckpt", e);
    if (!rc)
        rc = file_mkdir(t->dir, e);
    t->resumes = !rc && t->job->cfg->resume && file_exists(t->resume_path);
    return rc;
}

enum err_code begin_write_config(const struct begin *t, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *o = NULL;
    enum err_code rc = file_join(path, t->dir, "config.jsonc", e);
    if (!rc)
        rc = options_to_json(train_options(), t->job->cfg, &o, e);
    if (!rc)
        rc = jsonc_write(path, o, e);
    json_decref(o);
    return rc;
}

/* A folder that is complete: with these options there is nothing to do, with others its results are
 * replaced only when that was asked for. */
static enum err_code begin_is_done(const struct begin *t, struct train_cell_result *out, bool *done,
                                   struct err *e)
{
    char path[FILE_PATH_MAX];
    const struct train_config *cfg = t->job->cfg;
    const struct state_run run = {cfg, &t->job->cell, t->job->n_images, &t->inputs,
                                  &t->job->scene->origin};
    struct train_cell_result was;
    struct err why = {0};
    *done = false;
    if ((cfg->overwrite && !t->job->reuse) || t->resumes || done_read(t->dir, &was, &why))
        return ERR_OK;
    enum err_code rc = begin_level_path(t, was.n_levels, path, e);
    if (rc)
        return rc;
    if (state_check_result(&run, &t->appearance, path, &why))
        return cfg->overwrite
                   ? ERR_OK
                   : err_set(e, ERR_ARG,
                             "%s holds a finished run of other options or inputs (%s): --overwrite "
                             "replaces it, --output DIR keeps both",
                             t->dir, why.msg);
    *done = true;
    *out = was;
    out->was_done = true;
    return ERR_OK;
}

/* An unfinished run may be hours of work: it is not replaced unasked. */
static enum err_code begin_ask(const struct begin *t, struct err *e)
{
    const struct train_config *cfg = t->job->cfg;
    return t->resumes || cfg->overwrite || !file_exists(t->resume_path)
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "%s: an unfinished run is there: --resume goes on from it, --overwrite "
                         "begins anew, --output DIR keeps both",
                         t->resume_path);
}

/* What follows will not be what the done-file tells of, nor the residuals of another run. A state
 * that is not gone on with must not be taken for that of this run, should it end before its first
 * own. */
static enum err_code begin_forget_done(const struct begin *t, struct err *e)
{
    const char *const names[] = {"done.json", "residuals.json", BEGIN_FINEST, "resume.ckpt"};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < (t->resumes ? 1 : sizeof names / sizeof *names); i++) {
        char path[FILE_PATH_MAX];
        rc = file_join(path, t->dir, names[i], e);
        if (!rc && unlink(path) && errno != ENOENT)
            rc = err_errno(e, ERR_IO, "%s: cannot be removed", path);
    }
    return rc;
}

enum err_code begin_earlier_levels(const struct begin *t, const struct stage *at,
                                   struct train_cell_result *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (uint32_t i = 0; !rc && i < at->n_levels; i++) {
        char path[FILE_PATH_MAX];
        if (at->at < at->n_levels && (at->turned ? i <= at->at : i >= at->at))
            continue;
        rc = begin_level_path(t, i + 1, path, e);
        if (!rc)
            rc = state_read_level(path, &out->n_gaussians[i], &out->psnr_db[i], &out->ssim[i], e);
        if (rc)
            err_add(e, "level %u of the run to go on with: --overwrite begins anew", i + 1);
    }
    return rc;
}

/* Points fused from known depths, where the options ask for them. */
static enum err_code begin_dense(const struct run_cell *job, float **out, size_t *n, struct err *e)
{
    char dir[FILE_PATH_MAX];
    *n = 0;
    enum err_code rc = depth_prior_dir(job->cfg, job->scene, dir, e);
    return rc || !dir[0] ? rc : depth_prior_points(dir, out, n, e);
}

enum err_code begin_gauss(const struct begin *t, const struct appearance_train *appearance,
                          struct gauss *out, struct err *e)
{
    const struct run_cell *job = t->job;
    const struct train_config *cfg = job->cfg;
    float *dense = NULL;
    struct init_input first = {.scene = job->scene,
                               .images = job->images,
                               .windows = t->windows,
                               .n_images = job->n_images,
                               .cell = &job->cell,
                               .ground = t->ground.nx ? &t->ground : NULL,
                               .ground_share = INIT_GROUND_SHARE,
                               .dense_share = INIT_DENSE_SHARE,
                               .no_masks = !cfg->masks,
                               .sh_degree = (uint32_t)cfg->sh_degree,
                               .limit = t->levels[0].budget,
                               .seed = (uint64_t)cfg->seed};
    enum err_code rc = job->coarse ? init_coarse(&first, job->coarse, out, e) : ERR_OK;
    if (!rc && !out->n) { /* no coarse model, or nothing of it is seen here */
        rc = begin_dense(job, &dense, &first.n_dense, e);
        first.dense = dense;
        rc = rc ? rc : init_gauss(&first, out, e);
    }
    mem_free(dense);
    if (!rc && appearance_train_is_on(appearance) && !out->embed_len)
        rc = appearance_train_embed(appearance, (uint64_t)cfg->seed, out, e);
    return rc;
}

/* Photographs that are kept for scores have no look of their own, which appearance would need. */
bool begin_wants_last(const struct begin *t)
{
    const struct train_config *cfg = t->job->cfg;
    return cfg->final_all && t->job->n_test && !appearance_train_wanted(cfg);
}

/* All photographs that any part of the run draws. */
static enum err_code begin_list_all(struct begin *t, struct err *e)
{
    const struct run_cell *job = t->job;
    size_t n_test = begin_wants_last(t) ? job->n_test : 0;
    t->n_all = job->n_images + n_test;
    t->all = mem_array(t->n_all, sizeof *t->all);
    if (!t->all)
        return err_set(e, ERR_MEM, "train: out of memory for %zu photographs", t->n_all);
    for (size_t i = 0; i < job->n_images; i++)
        t->all[i] = job->images[i];
    for (size_t i = 0; i < n_test; i++)
        t->all[job->n_images + i] = job->test_images[i];
    return ERR_OK;
}

/* What the photographs show of the cell. */
static enum err_code begin_windows(struct begin *t, struct err *e)
{
    const struct run_cell *job = t->job;
    struct window looked = {0};
    double area = 0.0;
    if (!job->cell.cut)
        return ERR_OK;
    t->windows = mem_array(t->n_all, sizeof *t->windows);
    t->shares = mem_array(t->n_all, sizeof *t->shares);
    if (!t->windows || !t->shares)
        return err_set(e, ERR_MEM, "train: out of memory for %zu photographs", t->n_all);
    enum err_code rc = window_open(job->scene, job->cell.plan, &looked, e);
    for (size_t i = 0; !rc && i < t->n_all; i++) {
        struct camera_window *w = &t->windows[i];
        rc = window_look(&looked, t->all[i], e);
        if (rc)
            break;
        (void)window_part(&looked, job->cell.index, w); /* none: all of it */
        t->shares[i] = window_share(&looked, job->cell.index);
        area += (w->x1 - w->x0) * (w->y1 - w->y0);
    }
    window_free(&looked);
    if (!rc)
        log_info("train", "cell=%s: %zu photographs are cut to %.0f %% of their pixels",
                 job->cell.id, t->n_all, 100.0 * area / (double)t->n_all);
    return rc;
}

/* How many Gaussians each level may have. */
enum err_code begin_budget(struct begin *t, struct err *e)
{
    const struct run_cell *job = t->job;
    const struct train_config *cfg = job->cfg;
    size_t n_points = 0, around = 0;
    enum err_code rc = begin_list_all(t, e);
    if (!rc)
        rc = begin_windows(t, e);
    if (!rc)
        rc = schedule_make(cfg, job->n_images, &job->cell, t->levels, e);
    if (!rc)
        rc = init_count_points(job->scene, job->images, job->n_images, &job->cell, &n_points, e);
    if (!rc && job->coarse)
        rc = init_count_around(job->coarse, job->scene, job->images, t->windows, job->n_images,
                               &job->cell, &around, e);
    if (t->shares && job->coarse)
        n_points = 0; /* it begins with as many of the coarse model as are allowed */
    for (int64_t i = 0; i < cfg->level_count; i++)
        t->levels[i].around = around;
    const struct budget_photos photos = {job->scene, job->images, t->shares, job->n_images,
                                         n_points};
    if (!rc)
        budget_limit(&photos, cfg, t->levels);
    return rc;
}

/* What people need to know before days of computing. */
static enum err_code begin_memory(struct begin *t, struct err *e)
{
    const struct run_cell *job = t->job;
    struct memory_need m =
        memory_estimate(job->cfg, job->scene, job->images, job->n_images, t->levels,
                        (uint32_t)job->cfg->level_count, job->cell.whole);
    log_info("train",
             "cell=%s memory_mib<=%.0f beside the program: %zu Gaussians of %zu B, %zu pixels of "
             "%zu B, photographs %.0f MiB, neighbours %.0f MiB",
             job->cell.id, (double)m.total / 1048576.0, m.gaussians, m.per_gaussian, m.pixels,
             m.per_pixel, (double)m.photo_bytes / 1048576.0, (double)m.group_bytes / 1048576.0);
    size_t memory;
    enum err_code rc = machine_memory_parse(job->cfg->memory, machine_memory(), &memory, e);
    const double need = (double)m.total + MEMORY_PROGRAM_BYTES;
    if (!rc && !job->cell.whole && need > (double)memory) /* train/auto_plan.c tells of others */
        log_warn("train",
                 "cell=%s may need %.2f GB, --memory is %.2f GB: a smaller --budget, or smaller "
                 "cells (`citysplat plan`), need less",
                 job->cell.id, 1e-9 * need, 1e-9 * (double)memory);
    return rc;
}

/* Which photographs are not trained on. */
static void begin_tell_tests(const struct begin *t)
{
    const struct run_cell *job = t->job;
    if (!job->n_test)
        return;
    log_info("train", "cell=%s %zu photographs train, %zu are kept for scores: %s", job->cell.id,
             job->n_images, job->n_test,
             begin_wants_last(t) ? "after the scores all of them train"
                                 : "--final-all trains on with all of them after the scores, "
                                   "--no-test-split trains with all and gives no scores");
    if (job->cfg->final_all && !begin_wants_last(t))
        log_warn("train", "--final-all is left out: with --appearance a photograph needs a look "
                          "that was learned");
}

/* And how long it is. */
static void begin_tell_length(const struct begin *t)
{
    char parts[64] = "", again[64] = "";
    double steps = 0.0, tuned = 0.0;
    size_t at = 0;
    for (int64_t i = 0; i < t->job->cfg->level_count; i++) {
        steps += t->levels[i].steps;
        tuned += t->levels[i].tuned;
        at += (size_t)snprintf(parts + at, sizeof parts - at, "%s%u", i ? " + " : "",
                               t->levels[i].steps);
    }
    if (tuned > 0.0)
        snprintf(again, sizeof again, ", + %.0f that make the coarser ones again", tuned);
    int64_t asked = schedule_asked(t->job->cfg, t->job->n_images);
    log_info("train", "cell=%s %.0f steps, by level %s%s%s", t->job->cell.id, steps + tuned, parts,
             again,
             t->job->cfg->iterations.one ? ""
             : asked                     ? ": the default; --iterations N asks for another length"
                                         : ": --iterations N makes it shorter");
}

/* A network that is warmed up for longer than its level learns nothing. */
static enum err_code begin_check_warmup(const struct begin *t, struct err *e)
{
    const struct appearance_train *a = &t->appearance;
    if (!appearance_train_is_on(a) || a->shared)
        return ERR_OK;
    const struct schedule *first = &t->levels[0];
    uint32_t warmup = appearance_train_warmup(a, t->job->cfg, first);
    return warmup < first->steps
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "the appearance network would learn nothing: its warm-up of %u steps is "
                         "not shorter than the %u steps of the first level: lower "
                         "--appearance-warmup or take more steps",
                         warmup, first->steps);
}

/* What the sparse points and photographs say about where there can be Gaussians. */
static enum err_code begin_ground(struct begin *t, struct err *e)
{
    enum err_code rc = footprint_of(t->job->scene, &t->ground, e);
    if (rc || !t->ground.nx)
        return rc;
    return trim_open(t->job->scene, &t->ground, BEGIN_SURE, DENSIFY_FREE_SPACE * t->ground.height_m,
                     &t->rim, e);
}

enum err_code begin_run(struct begin *t, struct train_cell_result *out, bool *done, struct err *e)
{
    const struct run_cell *job = t->job;
    enum err_code rc = begin_budget(t, e);
    if (!rc)
        rc = begin_paths(t, job->base_dir, e);
    if (!rc && appearance_train_wanted(job->cfg))
        rc = appearance_train_open(&t->appearance, job->cfg, job->scene, job->images, job->n_images,
                                   job->shared, e);
    if (!rc)
        rc = begin_check_warmup(t, e);
    if (!rc)
        rc = done_lock(t->dir, &t->lock_fd, e);
    if (!rc)
        rc = inputs_read(job, &t->inputs, e);
    if (!rc)
        rc = begin_is_done(t, out, done, e);
    if (!rc && !*done)
        rc = begin_ask(t, e);
    if (rc || *done)
        return rc;
    rc = begin_memory(t, e);
    if (!rc)
        rc = begin_forget_done(t, e);
    if (rc)
        return rc;
    begin_tell_length(t);
    begin_tell_tests(t);
    return begin_ground(t, e);
}

void begin_close(struct begin *t)
{
    done_unlock(&t->lock_fd);
    trim_free(&t->rim);
    footprint_free(&t->ground);
    appearance_train_close(&t->appearance);
    mem_free(t->windows);
    mem_free(t->shares);
    mem_free(t->all);
    t->all = NULL;
}
