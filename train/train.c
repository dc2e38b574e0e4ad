/* The training of a scene: its cells one after the other, and what they share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/train.h"

#include "core/pool.h"
#include "render/render.h"
#include "train/base/config.h"
#include "train/coarse.h"
#include "train/loss/photometric.h"
#include "train/run.h"
#include "train/train_scene.h"

struct train { /* everything that lives as long as the run */
    struct train_scene scene;
    struct dev dev;
    bool dev_is_open;
    struct render *render;
    struct photometric *loss;
    struct coarse coarse;
    uint64_t steps; /* in this process, over all cells */
};

static enum err_code train_open(struct train *t, const char *scene_dir,
                                const struct train_config *cfg, struct err *e)
{
    mem_return_large();
    enum err_code rc = train_scene_open(scene_dir, NULL, cfg, &t->scene, e);
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
    coarse_free(&t->coarse);
    photometric_close(&t->loss);
    render_close(&t->render);
    if (t->dev_is_open)
        dev_close(&t->dev);
    train_scene_close(&t->scene);
}

/* The coarse model that all cells of the plan use, where one is wanted. */
static enum err_code train_coarse(struct train *t, struct err *e)
{
    struct train_scene *s = &t->scene;
    const struct train_config *cfg = s->cfg;
    if (!coarse_wanted(cfg, s->n_planned)) {
        if (cfg->coarse_only)
            log_info("train",
                     "no coarse model is needed: %zu cells, and with these options each begins on "
                     "its own",
                     s->n_planned ? s->n_planned : (size_t)1);
        return ERR_OK;
    }
    struct run_cell job = {
        .cfg = cfg,
        .base_dir = cfg->output ? cfg->output : s->dir,
        .scene = &s->scene,
        .dev = &t->dev,
        .render = t->render,
        .loss = t->loss,
        .steps = &t->steps,
    };
    enum err_code rc = train_scene_whole(s, &job, e);
    return rc ? rc : coarse_get(&job, !cfg->cell, &t->coarse, e);
}

static enum err_code train_cell(struct train *t, size_t index, struct train_cell_result *out,
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
        .shared = t->coarse.appearance.block ? &t->coarse.appearance : NULL,
        .coarse = t->coarse.gauss.n ? &t->coarse.gauss : NULL,
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
    out->cells = mem_array(t->scene.n_cells, sizeof *out->cells);
    if (!out->cells)
        return err_set(e, ERR_MEM, "train: out of memory for %zu cells", t->scene.n_cells);
    for (size_t i = 0; !rc && i < t->scene.n_cells; i++) {
        rc = train_cell(t, t->scene.cells[i], &out->cells[i], e);
        out->n_cells += !rc;
    }
    return rc;
}

bool train_needs_coarse(const struct train_config *cfg)
{
    return coarse_wanted(cfg, 2);
}

enum err_code train_run(const char *scene_dir, const struct train_config *cfg,
                        struct train_result *out, struct err *e)
{
    struct train *t = mem_array(1, sizeof *t);
    double start_s = clock_s();
    *out = (struct train_result){0};
    if (!t)
        return err_set(e, ERR_MEM, "train: out of memory");
    enum err_code rc = train_open(t, scene_dir, cfg, e);
    if (!rc)
        rc = train_coarse(t, e);
    if (!rc && !cfg->coarse_only)
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
