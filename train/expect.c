/* The expectation is what training computes when it starts (train/begin.c, train/forecast.c), for a
 * scene of equal photographs without points. So a change of schedules or budgets changes it too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/expect.h"

#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "scene/cells/cell.h"
#include "train/base/run_cell.h"
#include "train/base/stage.h"
#include "train/begin.h"
#include "train/density/budget.h"
#include "train/forecast.h"
#include "train/memory.h"
#include "train/model/init.h"
#include "train/photographs/depth_prior.h"
#include "train/photographs/gallery.h"
#include "train/refit.h"

/* Processor seconds of a unit of train/forecast.h, without and with known depths. Fitted to runs on
 * two cores with AVX-512 (docs/scale.md). */
static const double unit_s = 0.95e-7, unit_known_s = 1.05e-7;
static const double ckpt_bytes = 236;   /* of a Gaussian in a level's checkpoint */
static const double sparse_share = 0.1; /* sparse points, of the first level's budget */

struct expect_scene {
    struct scene scene;
    uint32_t *train; /* [n_train] */
};

static enum err_code expect_scene_make(const struct expect_photos *p, struct expect_scene *out,
                                       struct err *e)
{
    struct scene *s = &out->scene;
    s->images = mem_array(p->n_train, sizeof *s->images);
    out->train = mem_array(p->n_train, sizeof *out->train);
    if (!s->images || !out->train)
        return err_set(e, ERR_MEM, "forecast: out of memory for %zu photographs", p->n_train);
    s->n_images = p->n_train;
    for (size_t i = 0; i < p->n_train; i++) {
        s->images[i].cam = (struct camera){.width_px = p->width_px,
                                           .height_px = p->height_px,
                                           .fx_px = p->width_px,
                                           .fy_px = p->width_px};
        out->train[i] = (uint32_t)i;
    }
    return ERR_OK;
}

/* Units of work of all levels, and of a last fit. first: Gaussians inside the cell that it begins
 * with. */
static double expect_work(const struct gallery *g, size_t n_test, bool whole, double first,
                          struct stage *at)
{
    struct forecast f;
    forecast_open(&f, g, at, n_test, whole);
    f.work = f.seconds = 1.0;
    double work = forecast_left_s(&f, at, forecast_all(&f, stage_schedule(at), first));
    if (g->cfg->final_all && n_test) {
        at->at = at->n_levels - 1;
        at->levels[at->at] = refit_schedule_last(&at->levels[at->at]);
        work += forecast_steps_s(
            &f, at, forecast_all(&f, &at->levels[at->at], (double)at->levels[at->at].budget));
    }
    return work;
}

/* Before the first step. */
static struct stage expect_stage(const struct train_config *cfg)
{
    return (struct stage){.n_levels = (uint32_t)cfg->level_count,
                          .again = cfg->level_order == SCHEDULE_BOTH};
}

/* From budgets that are known. known: depths are. The levels' `around` is for memory, the most;
 * around: those that there will be. */
static void expect_sum(const struct gallery *g, size_t n_test, bool whole, bool known, double first,
                       double around, struct stage *at, struct expect *out)
{
    for (uint32_t k = 0; k < at->n_levels; k++) {
        out->gaussians[k] = at->levels[k].budget;
        out->steps += at->levels[k].steps + at->levels[k].tuned;
        out->checkpoint_bytes += ckpt_bytes * (double)at->levels[k].budget;
    }
    struct memory_need m =
        memory_estimate(g->cfg, g->scene, g->images, g->n_images, at->levels, at->n_levels, whole);
    out->memory_bytes = (double)m.total + MEMORY_PROGRAM_BYTES;
    for (uint32_t k = 0; k < at->n_levels; k++)
        at->levels[k].around = (size_t)around;
    out->cpu_s = (known ? unit_known_s : unit_s) * expect_work(g, n_test, whole, first, at);
}

enum err_code expect_training(const struct train_config *cfg, const struct expect_photos *p,
                              struct expect *out, struct err *e)
{
    struct expect_scene in = {0};
    const struct cell cell = {.edge_m = 100, .extent_m = 100, .whole = true};
    struct stage at = expect_stage(cfg);
    *out = (struct expect){0};
    enum err_code rc = expect_scene_make(p, &in, e);
    if (!rc)
        rc = schedule_make(cfg, p->n_train, &cell, at.levels, e);
    if (!rc) {
        const struct budget_photos photos = {&in.scene, in.train, NULL, p->n_train, 0};
        const struct gallery g = {
            .cfg = cfg, .scene = &in.scene, .images = in.train, .n_images = p->n_train};
        bool known = p->depths && strcmp(cfg->depth_prior, "none") != 0;
        budget_limit(&photos, cfg, at.levels);
        double first =
            (double)at.levels[at.at].budget * (p->depths ? INIT_DENSE_SHARE : sparse_share);
        expect_sum(&g, p->n_test, true, known, first, 0.0, &at, out);
    }
    mem_free(in.train);
    mem_free(in.scene.images);
    return rc;
}

enum err_code expect_cell(const struct run_cell *job, size_t n_around, struct expect *out,
                          struct err *e)
{
    const struct train_config *cfg = job->cfg;
    struct begin b = {.job = job, .lock_fd = -1};
    struct stage at = expect_stage(cfg);
    char depths[FILE_PATH_MAX] = "";
    double inside = 0.0, around = 0.0;
    *out = (struct expect){0};
    enum err_code rc = depth_prior_dir(cfg, job->scene, depths, e);
    if (!rc)
        rc = begin_budget(&b, e);
    if (!rc && n_around)
        rc = init_point_shares(job->scene, job->images, b.windows, job->n_images, &job->cell,
                               &inside, &around, e);
    if (!rc) {
        const struct gallery g = {.cfg = cfg,
                                  .scene = job->scene,
                                  .images = job->images,
                                  .n_images = job->n_images,
                                  .windows = b.windows};
        memcpy(at.levels, b.levels, sizeof b.levels);
        for (uint32_t k = 0; k < at.n_levels; k++)
            at.levels[k].around = n_around;
        const double most = (double)at.levels[at.at].budget;
        double first = n_around ? fmin(inside * (double)n_around, most)
                                : most * (depths[0] ? INIT_DENSE_SHARE : sparse_share);
        expect_sum(&g, job->n_test, job->cell.whole, depths[0], first, around * (double)n_around,
                   &at, out);
    }
    begin_close(&b);
    return rc;
}
