/* The training of a scene: its options, and its cells one after the other.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>

#include "cells/cell.h"
#include "cells/cell_plan.h"
#include "cells/partition.h"
#include "codec/scene.h"
#include "core/appearance.h"
#include "core/pool.h"
#include "loss/photometric.h"
#include "render/render.h"
#include "train/config.h"
#include "train/run.h"
#include "train/shared.h"
#include "train/train.h"
#include "train/train_scene.h"

static const struct options_def train_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct train_config, type, key, def, lo, hi, unit, help)
#include "train/options.def"
#undef OPT
};

static const struct options_spec train_spec = {
    .command = "train",
    .usage = "citysplat train SCENE [options]",
    .about = "Train Gaussians at several levels of detail from a scene that `citysplat ingest` or "
             "`citysplat "
             "synth` made. Results and measurements go to SCENE/cells/<id>/, one folder a cell of "
             "`citysplat plan`, or cells/all/ without a plan. Ctrl-C saves the "
             "state and --resume goes on from it. configs/ holds presets with their reasons.",
    .example = "citysplat train scene --iterations 2000 --max-edge-px 400   # a few minutes\n"
               "citysplat train scene --config configs/demo.jsonc\n"
               "citysplat train scene                                       # the full method",
    .defs = train_defs,
    .n_defs = sizeof(train_defs) / sizeof(train_defs[0]),
    .min_args = 1,
    .max_args = 1,
};

const struct options_spec *train_options(void)
{
    return &train_spec;
}

uint64_t train_stream(enum train_stream_id id, uint32_t level, uint64_t step)
{
    return ((uint64_t)id << 56) | ((uint64_t)level << 48) | step;
}

enum err_code train_images(struct scene *s, enum scene_split split, bool test_split, uint32_t **out,
                           size_t *n, struct err *e)
{
    *n = 0;
    *out = arena_get(&s->arena, s->n_images ? s->n_images : 1, sizeof(**out));
    if (!*out)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu photographs", s->dir, s->n_images);
    for (size_t i = 0; i < s->n_images; i++)
        if (split == SCENE_TRAIN ? !test_split || s->images[i].split == SCENE_TRAIN
                                 : test_split && s->images[i].split == SCENE_TEST)
            (*out)[(*n)++] = (uint32_t)i;
    return ERR_OK;
}

/* ---- the scene and its cells ---- */

enum err_code train_scene_open(const char *dir, const struct train_config *cfg,
                               struct train_scene *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    *out = (struct train_scene){.cfg = cfg, .dir = dir};
    enum err_code rc = scene_read(dir, &out->scene, e);
    if (!rc)
        rc = file_join(path, dir, "plan.json", e);
    if (!rc && file_exists(path))
        rc = cell_plan_read(path, &out->scene, &out->plan, e);
    else if (!rc && cfg->cell)
        rc = err_set(e, ERR_NOENT, "%s: --cell needs a plan; `citysplat plan %s` makes it", path,
                     dir);
    if (rc)
        return rc;
    size_t n = out->plan.n_cells ? out->plan.n_cells : 1;
    out->cells = mem_array(n, sizeof(*out->cells));
    if (!out->cells)
        return err_set(e, ERR_MEM, "train: out of memory for %zu cells", n);
    for (size_t i = 0; i < n; i++) {
        const struct partition_cell *c = out->plan.n_cells ? &out->plan.cells[i] : NULL;
        if (!c || (c->parent < 0 && (!cfg->cell || !strcmp(cfg->cell, c->id))))
            out->cells[out->n_cells++] = i;
    }
    if (out->n_cells)
        return ERR_OK;
    return cfg->cell ? err_set(e, ERR_ARG, "--cell: %s/plan.json has no trained cell '%s'", dir,
                               cfg->cell)
                     : err_set(e, ERR_DATA,
                               "%s/plan.json: no cell has photographs enough to be trained", dir);
}

void train_scene_close(struct train_scene *s)
{
    mem_free(s->cells);
    partition_free(&s->plan);
    scene_free(&s->scene);
}

/* The photographs of a planned cell that train, those by location first; and the test photographs
 * taken from inside it. */
static enum err_code train_planned(struct train_scene *s, size_t index, struct run_cell *job,
                                   struct err *e)
{
    const struct partition_cell *c = &s->plan.cells[index];
    size_t n_location = 0, n = 0, n_test = 0;
    uint32_t *images = arena_get(&s->scene.arena, c->n_images + 1, sizeof(*images));
    if (!images)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu photographs", s->dir, c->n_images);
    for (size_t i = 0; i < c->n_images; i++) {
        if (s->cfg->test_split && s->scene.images[c->images[i]].split == SCENE_TEST)
            continue;
        images[n++] = c->images[i];
        n_location += i < c->n_location;
    }
    job->images = images;
    job->n_images = n;
    cell_planned(&s->scene, &s->plan, index, images, n_location ? n_location : n, &job->cell);
    for (size_t i = 0; i < job->n_test; i++) {
        double at[3];
        camera_center(&s->scene.images[job->test_images[i]].cam, at);
        if (cell_distance(&job->cell, at[0], at[1]) <= 0.0)
            job->test_images[n_test++] = job->test_images[i];
    }
    job->n_test = n_test;
    return ERR_OK;
}

enum err_code train_scene_cell(struct train_scene *s, size_t index, struct run_cell *job,
                               struct err *e)
{
    uint32_t *images;
    enum err_code rc =
        train_images(&s->scene, SCENE_TEST, s->cfg->test_split, &job->test_images, &job->n_test, e);
    if (!rc && s->plan.n_cells) {
        rc = train_planned(s, index, job, e);
    } else if (!rc) {
        rc = train_images(&s->scene, SCENE_TRAIN, s->cfg->test_split, &images, &job->n_images, e);
        job->images = images;
        if (!rc && job->n_images)
            cell_whole(&s->scene, images, job->n_images, &job->cell);
    }
    if (!rc && !job->n_images)
        rc = err_set(e, ERR_DATA, "%s: no photographs to train on", s->dir);
    return rc && s->plan.n_cells > 1 ? err_add(e, "cell %s", s->plan.cells[index].id) : rc;
}

/* ---- running them ---- */

struct train { /* everything that lives as long as the run */
    struct train_scene scene;
    struct dev dev;
    bool dev_is_open;
    struct render *render;
    struct photometric *loss;
    struct appearance shared; /* of all cells; empty: none */
    uint64_t steps;           /* in this process, over all cells */
};

static enum err_code train_open(struct train *t, const char *scene_dir,
                                const struct train_config *cfg, struct err *e)
{
    mem_return_large();
    enum err_code rc = train_scene_open(scene_dir, cfg, &t->scene, e);
    if (!rc)
        pool_limit((size_t)cfg->threads);
    if (!rc)
        rc = dev_open(cfg->device, &t->dev, e);
    if (rc)
        return rc;
    t->dev_is_open = true;
    rc = render_open(&t->dev, &t->render, e);
    return rc ? rc : photometric_open(&t->dev, &t->loss, e);
}

static void train_close(struct train *t)
{
    appearance_free(&t->shared);
    photometric_close(&t->loss);
    render_close(&t->render);
    if (t->dev_is_open)
        dev_close(&t->dev);
    train_scene_close(&t->scene);
}

/* The appearance model that all cells of the plan use, where one is wanted. */
static enum err_code train_shared(struct train *t, struct err *e)
{
    struct train_scene *s = &t->scene;
    const struct train_config *cfg = s->cfg;
    uint32_t *images;
    size_t n = 0;
    for (size_t i = 0; i < s->plan.n_cells; i++)
        n += s->plan.cells[i].parent < 0;
    if (!shared_wanted(cfg, n))
        return cfg->appearance_only
                   ? err_set(e, ERR_ARG,
                             "--appearance-only: nothing to train: it needs --appearance and "
                             "--appearance-shared, and a plan of several cells (%s/plan.json has "
                             "%zu)",
                             s->dir, n)
                   : ERR_OK;
    struct run_cell job = {
        .cfg = cfg,
        .base_dir = cfg->output ? cfg->output : s->dir,
        .scene = &s->scene,
        .dev = &t->dev,
        .render = t->render,
        .loss = t->loss,
        .steps = &t->steps,
    };
    enum err_code rc =
        train_images(&s->scene, SCENE_TEST, cfg->test_split, &job.test_images, &job.n_test, e);
    if (!rc)
        rc = train_images(&s->scene, SCENE_TRAIN, cfg->test_split, &images, &job.n_images, e);
    if (!rc && !job.n_images)
        rc = err_set(e, ERR_DATA, "%s: no photographs to train on", s->dir);
    if (rc)
        return rc;
    job.images = images;
    return shared_get(&job, !cfg->cell, &t->shared, e);
}

static enum err_code cell(struct train *t, size_t index, struct train_cell_result *out,
                          struct err *e)
{
    struct train_scene *s = &t->scene;
    struct run_cell job = {
        .cfg = s->cfg,
        .base_dir = s->cfg->output ? s->cfg->output : s->dir,
        .scene = &s->scene,
        .dev = &t->dev,
        .render = t->render,
        .loss = t->loss,
        .shared = t->shared.block ? &t->shared : NULL,
        .steps = &t->steps,
    };
    enum err_code rc = train_scene_cell(s, index, &job, e);
    if (rc)
        return rc;
    rc = run_cell(&job, out, e);
    return rc && s->plan.n_cells > 1 ? err_add(e, "cell %s", s->plan.cells[index].id) : rc;
}

static enum err_code train_cells(struct train *t, struct train_result *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    out->cells = mem_array(t->scene.n_cells, sizeof(*out->cells));
    if (!out->cells)
        return err_set(e, ERR_MEM, "train: out of memory for %zu cells", t->scene.n_cells);
    for (size_t i = 0; !rc && i < t->scene.n_cells; i++) {
        rc = cell(t, t->scene.cells[i], &out->cells[i], e);
        out->n_cells += !rc;
    }
    return rc;
}

enum err_code train_run(const char *scene_dir, const struct train_config *cfg,
                        struct train_result *out, struct err *e)
{
    struct train *t = mem_array(1, sizeof(*t));
    double start_s = clock_s();
    *out = (struct train_result){0};
    if (!t)
        return err_set(e, ERR_MEM, "train: out of memory");
    enum err_code rc = train_open(t, scene_dir, cfg, e);
    if (!rc)
        rc = train_shared(t, e);
    if (!rc && !cfg->appearance_only)
        rc = train_cells(t, out, e);
    out->seconds = clock_s() - start_s;
    out->peak_bytes = mem_peak_bytes();
    train_close(t);
    mem_free(t);
    return rc;
}

void train_result_free(struct train_result *r)
{
    mem_free(r->cells);
    *r = (struct train_result){0};
}
