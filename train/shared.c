/* The shared appearance model of a plan's cells; see shared.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/shared.h"

#include <math.h>
#include <string.h>

#include "cells/cell.h"
#include "codec/ckpt.h"
#include "codec/scene.h"
#include "train/appearance_train.h"
#include "train/config.h"
#include "train/result.h"
#include "train/run.h"

bool shared_wanted(const struct train_config *cfg, size_t n_cells)
{
    return appearance_train_wanted(cfg) && cfg->appearance_shared && n_cells > 1;
}

/* Options of the coarse run: one level that is like the coarsest one of the cells. */
static struct train_config shared_config(const struct train_config *cells, const char *resume_path)
{
    struct train_config c = *cells;
    double total = 0.0;
    const int64_t steps[] = {cells->iterations_3, cells->iterations_2, cells->iterations_1};
    for (int64_t i = 0; i < cells->level_count; i++)
        total += (double)steps[i];
    c.iterations_1 = c.iterations_2 = c.iterations_3 = cells->appearance_iterations;
    if (cells->iterations > 0)
        c.iterations = (int64_t)fmax(
            floor((double)cells->appearance_iterations * (double)cells->iterations / total + 0.5),
            (double)cells->appearance_iterations_min);
    c.level_count = 1;
    c.downsample_2 = c.downsample_3 = c.downsample_1;
    c.densify_interval_2 = c.densify_interval_3 = c.densify_interval_1;
    c.densify_until_2 = c.densify_until_3 = c.densify_until_1;
    c.tau_2 = c.tau_3 = c.tau_1;
    c.budget_1 = c.budget_2 = c.budget_3 = cells->appearance_budget;
    c.absgrad_from = TRAIN_LEVELS_MAX + 1;
    c.appearance_levels = 1;
    c.appearance_only = false;
    c.cell = NULL;
    /* Complete or not, whatever is there with the same options is used; without --resume an
     * unfinished one is begun anew, as a cell is. */
    c.resume = cells->resume || !file_exists(resume_path);
    return c;
}

enum err_code shared_read_model(const struct ckpt *c, const char *path, struct appearance *out,
                                struct err *e)
{
    const struct ckpt_blob *b = ckpt_find(c, APPEARANCE_TRAIN_BLOB);
    *out = (struct appearance){0};
    if (!b)
        return ERR_OK;
    enum err_code rc = appearance_read(b->data, b->size_bytes, out, e);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

static enum err_code shared_load(const char *path, struct appearance *out, struct err *e)
{
    struct ckpt_rows *c = NULL;
    struct buf b = {0};
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &b, e);
    if (!rc && !b.data)
        rc = err_set(e, ERR_FORMAT, "%s: holds no appearance model", path);
    else if (!rc && appearance_read(b.data, b.size, out, e))
        rc = err_add(e, "%s", path);
    buf_free(&b);
    ckpt_rows_close(&c);
    return rc;
}

enum err_code shared_get(const struct run_cell *job, bool may_train, struct appearance *out,
                         struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], resume[FILE_PATH_MAX];
    struct train_cell_result result;
    struct run_cell whole = *job;
    *out = (struct appearance){0};
    enum err_code rc = file_join(dir, job->base_dir, "cells/" SHARED_ID, e);
    if (!rc)
        rc = file_join(path, dir, "level1.ckpt", e);
    if (!rc)
        rc = file_join(resume, dir, "resume.ckpt", e);
    if (rc)
        return rc;
    if (job->cfg->appearance_iterations < job->cfg->appearance_iterations_min)
        return err_set(e, ERR_ARG,
                       "shared appearance: %lld steps are too few for the network to learn from: "
                       "take --appearance-iterations of at least %lld",
                       (long long)job->cfg->appearance_iterations,
                       (long long)job->cfg->appearance_iterations_min);
    struct train_config cfg = shared_config(job->cfg, resume);
    whole.cfg = &cfg;
    whole.shared = NULL;
    whole.reuse = true;
    cell_whole(job->scene, job->images, job->n_images, &whole.cell);
    memcpy(whole.cell.id, SHARED_ID, sizeof(SHARED_ID));
    if (!may_train && (!file_exists(path) || file_exists(resume)))
        return err_set(e, ERR_NOENT,
                       "%s: the appearance model that all cells share is not trained yet: run "
                       "`citysplat train %s --appearance-only` with the same options once, before "
                       "the jobs of single cells",
                       path, job->scene->dir);
    if (may_train)
        rc = run_cell(&whole, &result, e);
    if (!rc && may_train && !result.was_done)
        log_info("train",
                 "appearance model of all cells gaussians=%zu photographs=%zu seconds=%.1f",
                 result.n_gaussians[0], job->n_images, result.seconds);
    return rc ? err_add(e, "shared appearance") : shared_load(path, out, e);
}
