/* The coarse run before a plan's cells; see coarse.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/coarse.h"

#include <math.h>
#include <string.h>

#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "scene/cells/cell.h"
#include "train/base/config.h"
#include "train/base/result.h"
#include "train/base/schedule.h"
#include "train/model/appearance_train.h"
#include "train/run.h"

static bool coarse_has_appearance(const struct train_config *cfg)
{
    return appearance_train_wanted(cfg) && cfg->appearance_shared;
}

bool coarse_wanted(const struct train_config *cfg, size_t n_cells)
{
    return (cfg->coarse_start || coarse_has_appearance(cfg)) && n_cells > 1;
}

/* The value of the coarsest level for all levels; one value holds at all levels already. */
static void coarse_first(struct options_ints *l, int64_t n_levels)
{
    size_t first = l->n > 1 ? TRAIN_LEVELS_MAX - (size_t)n_levels : 0;
    for (size_t i = 0; i < TRAIN_LEVELS_MAX; i++)
        l->v[i] = l->v[first];
    l->n = l->n == 1 ? 1 : 0;
}

static void coarse_first_num(struct options_nums *l, int64_t n_levels)
{
    size_t first = l->n > 1 ? TRAIN_LEVELS_MAX - (size_t)n_levels : 0;
    for (size_t i = 0; i < TRAIN_LEVELS_MAX; i++)
        l->v[i] = l->v[first];
    l->n = l->n == 1 ? 1 : 0;
}

/* Options of the coarse run: one level that is like the coarsest one of the cells. */
static struct train_config coarse_config(const struct train_config *cells, size_t n_photos,
                                         const char *resume_path)
{
    struct train_config c = *cells;
    const double total = schedule_full(cells), asked = (double)schedule_asked(cells, n_photos);
    c.iterations.v[0] = c.iterations.v[1] = c.iterations.v[2] = cells->coarse_iterations;
    if (asked > 0.0)
        c.iterations.one =
            (int64_t)fmax(floor((double)cells->coarse_iterations * asked / total + 0.5),
                          (double)cells->coarse_iterations_min);
    c.level_count = 1;
    c.level_order = SCHEDULE_COARSE_TO_FINE; /* of one level there is none */
    coarse_first(&c.densify_interval, cells->level_count);
    coarse_first_num(&c.densify_until, cells->level_count);
    coarse_first_num(&c.tau, cells->level_count);
    coarse_first_num(&c.downsample, cells->level_count);
    if (cells->downsample.n == 1) /* it is the finest level's */
        c.downsample = (struct options_nums){
            .one = cells->downsample.one * cells->downsample.v[0] / cells->downsample.v[2], .n = 1};
    for (size_t i = 0; i < TRAIN_LEVELS_MAX; i++)
        c.budget.v[i] = cells->coarse_budget;
    c.budget.n = c.iterations.n = 0;
    c.absgrad_from = TRAIN_LEVELS_MAX + 1;
    c.coarse_only = c.coarse_start = false;
    c.final_all = false; /* the cells that begin from it are scored */
    c.appearance = coarse_has_appearance(cells);
    c.cell = NULL;
    /* Whatever is complete with the same options is used. */
    c.resume = cells->resume || !file_exists(resume_path);
    return c;
}

enum err_code coarse_read_appearance(const struct ckpt *c, const char *path, struct appearance *out,
                                     struct err *e)
{
    const struct ckpt_blob *b = ckpt_find(c, APPEARANCE_TRAIN_BLOB);
    *out = (struct appearance){0};
    if (!b)
        return ERR_OK;
    enum err_code rc = appearance_read(b->data, b->size_bytes, out, e);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

static enum err_code coarse_load_appearance(const struct ckpt_rows *c, const char *path,
                                            struct appearance *out, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &b, e);
    if (!rc && !b.data)
        rc = err_set(e, ERR_FORMAT, "%s: holds no appearance model", path);
    else if (!rc && appearance_read(b.data, b.size, out, e))
        rc = err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}

static enum err_code coarse_load(const struct train_config *cfg, const char *path,
                                 struct coarse *out, struct err *e)
{
    struct ckpt_rows *c = NULL;
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc && coarse_has_appearance(cfg))
        rc = coarse_load_appearance(c, path, &out->appearance, e);
    if (!rc && cfg->coarse_start)
        rc = ckpt_rows_read(c, 0, ckpt_rows_count(c), &out->gauss, e);
    ckpt_rows_close(&c);
    if (rc)
        coarse_free(out);
    return rc;
}

void coarse_free(struct coarse *s)
{
    appearance_free(&s->appearance);
    gauss_free(&s->gauss);
}

void coarse_job(const struct run_cell *job, const char *resume_path, struct train_config *cfg,
                struct run_cell *out)
{
    *cfg = coarse_config(job->cfg, job->n_images, resume_path);
    *out = *job;
    out->cfg = cfg;
    out->shared = NULL;
    out->coarse = NULL;
    out->reuse = true;
    cell_whole(job->scene, job->images, job->n_images, &out->cell);
    memcpy(out->cell.id, TRAIN_COARSE_ID, sizeof(TRAIN_COARSE_ID));
}

enum err_code coarse_get(const struct run_cell *job, bool may_train, struct coarse *out,
                         struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], resume[FILE_PATH_MAX];
    struct train_cell_result result;
    struct run_cell whole;
    struct train_config cfg;
    *out = (struct coarse){0};
    enum err_code rc = file_join(dir, job->base_dir, "cells/" TRAIN_COARSE_ID, e);
    if (!rc)
        rc = file_join(path, dir, "level1.ckpt", e);
    if (!rc)
        rc = file_join(resume, dir, "resume.ckpt", e);
    if (rc)
        return rc;
    if (job->cfg->coarse_iterations < job->cfg->coarse_iterations_min)
        return err_set(e, ERR_ARG,
                       "coarse model of all cells: %lld steps are too few to learn from: take "
                       "--coarse-iterations of at least %lld, or lower --coarse-iterations-min",
                       (long long)job->cfg->coarse_iterations,
                       (long long)job->cfg->coarse_iterations_min);
    coarse_job(job, resume, &cfg, &whole);
    if (!may_train && (!file_exists(path) || file_exists(resume)))
        return err_set(e, ERR_NOENT,
                       "%s: the coarse model that all cells share is not trained yet: run "
                       "`citysplat train %s --coarse-only` with the same options once, before "
                       "the jobs of single cells",
                       path, job->scene->dir);
    if (may_train)
        rc = run_cell(&whole, &result, e);
    if (!rc && may_train && !result.was_done)
        log_info("train", "coarse model of all cells gaussians=%zu photographs=%zu seconds=%.1f",
                 result.n_gaussians[0], job->n_images, result.seconds);
    return rc ? err_add(e, "coarse model of all cells") : coarse_load(job->cfg, path, out, e);
}
