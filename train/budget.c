/* Budgets that follow the photographs.
 *
 * A level with more Gaussians than its photographs can distinguish fits their noise and their wrong
 * poses. On 65 aerial photographs of 400 x 300 px, 7000 steps reach 33.7 dB with 240 k Gaussians.
 * With the 770 k that gradients alone ask for, they reach 32.3 dB in twice the time
 * (docs/decisions/006-density-control.md).
 *
 * Automatic budgets measure the held-out PSNR while the level grows, and growth continues while it
 * gains. Progress of the optimiser also counts as gain, so a run tends to grow too much, up to the
 * table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/budget.h"

#include <math.h>

#include "codec/scene.h"
#include "loss/metric.h"
#include "render/render.h"
#include "train/config.h"
#include "train/evaluate.h"
#include "train/gallery.h"
#include "train/half_image.h"
#include "train/model.h"
#include "train/photo_loader.h"
#include "train/schedule.h"
#include "train/stage.h"

#define BUDGET_RAISE_FACTOR 1.3
#define BUDGET_FULL 0.9  /* of the budget in use: only then is a higher one of use */
#define BUDGET_GREW 1.05 /* fewer new Gaussians than this say nothing about their worth */
enum { BUDGET_EVERY = 16, BUDGET_OFFSET = 8, BUDGET_LOOKS = 10, BUDGET_FIT_STEPS = 10 };

size_t budget_fit(const struct budget_photos *p, const struct train_config *cfg, double downsample,
                  size_t table)
{
    double sum = 0.0;
    for (size_t i = 0; i < p->n; i++) {
        struct camera c = photo_loader_camera(&p->scene->images[p->images[i]].cam,
                                              (uint32_t)cfg->max_edge_px, downsample);
        sum += (p->shares ? p->shares[i] : 1.0) * sqrt((double)c.width_px * c.height_px);
    }
    double fit = fmax(floor(cfg->budget_density * sum), (double)p->n_points);
    return fit < (double)table ? (size_t)fmax(fit, 1.0) : table;
}

void budget_limit(const struct budget_photos *p, const struct train_config *cfg,
                  struct schedule levels[TRAIN_LEVELS_MAX])
{
    size_t before = 0, n_points = p->n_points;
    for (int64_t i = 0; cfg->budget_rule != BUDGET_TABLE && i < cfg->level_count; i++) {
        struct schedule *l = &levels[i];
        size_t table = l->budget;
        size_t fit = budget_fit(p, cfg, l->downsample, table);
        if (cfg->budget_rule == BUDGET_AUTO)
            fit = fit / 2 > n_points ? fit / 2 : n_points < fit ? n_points : fit;
        l->budget = fit > before ? fit : before;
        before = l->budget;
        if (l->budget < table)
            log_info("train",
                     "level %u: at most %zu Gaussians, what %zu photographs of this size support; "
                     "--budget-rule table allows %zu",
                     l->level, l->budget, p->n, table);
    }
}

/* ---- automatic ---- */

void budget_hold_out(const struct train_config *cfg, const uint32_t *images, size_t n_images,
                     uint32_t *train, size_t *n_train, uint32_t *held, size_t *n_held)
{
    bool some = cfg->budget_rule == BUDGET_AUTO && n_images >= BUDGET_EVERY;
    *n_train = *n_held = 0;
    for (size_t i = 0; i < n_images; i++)
        if (some && i % BUDGET_EVERY == BUDGET_OFFSET)
            held[(*n_held)++] = images[i];
        else
            train[(*n_train)++] = images[i];
}

void budget_close(struct budget *b)
{
    photo_loader_close(&b->photos);
    half_image_close(&b->half);
    appearance_view_close(&b->view);
}

static enum err_code budget_open_photos(struct budget *b, const struct gallery *g,
                                        const struct schedule *s, struct err *e)
{
    struct photo_loader_config f = {
        .scene = g->scene,
        .images = b->held,
        .n_images = b->n_held,
        .windows = b->windows,
        .max_edge_px = (uint32_t)g->cfg->max_edge_px,
        .downsample = s->downsample,
        .exposure = g->cfg->exposure ? PHOTO_LOADER_TO_MEAN : PHOTO_LOADER_AS_TAKEN,
        .no_masks = !g->cfg->masks,
        .cache_bytes = (size_t)g->cfg->cache_mib << 16, /* a sixteenth, as of the photographs */
        .level = s->level,
    };
    return b->photos ? ERR_OK : photo_loader_open(&f, &b->photos, e);
}

/* A whole photograph, drawn as `ro` says. */
static enum err_code budget_score(const struct photo *p, const struct model *m,
                                  const struct render_options *ro, double *db, struct err *e)
{
    float *rgb = mem_array((size_t)p->cam.width_px * p->cam.height_px * 3, sizeof *rgb);
    enum err_code rc = rgb ? render_forward(m->render, &m->gauss, &p->cam, ro, rgb, NULL, e)
                           : err_set(e, ERR_MEM, "budget: out of memory");
    if (!rc)
        rc = metric_psnr(rgb, p->px, p->mask, p->cam.width_px, p->cam.height_px, db, e);
    mem_free(rgb);
    return rc;
}

/* Does the training learn this photograph's embedding, or was it given? */
static bool budget_is_learnt(const struct gallery *g, uint32_t image)
{
    const struct appearance_train *a = g->appearance;
    bool learnt = a->shared;
    for (size_t i = 0; i < g->n_images; i++)
        learnt |= a->alike[a->row[g->images[i]]] == a->alike[a->row[image]];
    return learnt;
}

static enum err_code budget_open_half(struct budget *b, const struct gallery *g, struct err *e)
{
    const struct half_image_config c = {.dev = g->engine.dev,
                                        .render = g->engine.render,
                                        .loss = g->engine.loss,
                                        .appearance = &b->view,
                                        .steps = BUDGET_FIT_STEPS,
                                        .lr = HALF_IMAGE_LR,
                                        .lr_end = HALF_IMAGE_LR_END};
    if (b->half)
        return ERR_OK;
    enum err_code rc = appearance_view_open(&b->view, &g->appearance->model, g->scene, e);
    return rc ? rc : half_image_open(&c, &b->half, e);
}

/* A photograph that carries no gradient has an appearance of its own all the same: a few steps on
 * its left half go on with its row of the table, and the right half is scored. */
static enum err_code budget_score_half(struct budget *b, const struct photo *p,
                                       const struct model *m, const struct gallery *g,
                                       const struct stage *at, double *db, struct err *e)
{
    struct render_options ro = gallery_options(g, at);
    struct evaluate_score score = {0};
    float image[APPEARANCE_IMAGE_MAX];
    appearance_train_get(g->appearance, p->image, image);
    enum err_code rc = budget_open_half(b, g, e);
    if (!rc)
        rc = half_image_fit(b->half, p, &m->gauss, &ro, HALF_IMAGE_LEFT, image, e);
    if (!rc)
        rc = half_image_score(b->half, p, &m->gauss, &ro, HALF_IMAGE_RIGHT, image, &score, e);
    if (!rc)
        appearance_train_set(g->appearance, p->image, image);
    *db = score.psnr_db;
    return rc;
}

/* Mean PSNR of the held-out photographs, each in its own appearance; NaN where masks leave nothing
 * of any. */
static enum err_code budget_psnr(struct budget *b, const struct model *m, const struct gallery *g,
                                 const struct stage *at, double *mean_db, struct err *e)
{
    size_t n = 0;
    double sum = 0.0;
    enum err_code rc = budget_open_photos(b, g, stage_schedule(at), e);
    for (size_t i = 0; !rc && i < b->n_held; i++) {
        struct photo p;
        double db = 0.0;
        rc = photo_loader_get_nth(b->photos, i, &p, e);
        if (rc)
            break;
        struct render_options ro = gallery_photo_options(g, at, p.image);
        bool half = ro.appearance_frame && !budget_is_learnt(g, p.image);
        if (half ? !half_image_is_seen(&p) : evaluate_is_masked(&p))
            continue;
        rc = half ? budget_score_half(b, &p, m, g, at, &db, e) : budget_score(&p, m, &ro, &db, e);
        sum += db;
        n++;
    }
    *mean_db = n ? sum / (double)n : (double)NAN;
    return rc;
}

enum budget_step budget_decide(const struct budget_point *last, double n, double psnr_db,
                               size_t budget, double gain_db)
{
    if (last->stopped || !(last->n > 0.0) || n < BUDGET_GREW * last->n)
        return BUDGET_KEEP;
    if ((psnr_db - last->psnr_db) / log2(n / last->n) < gain_db)
        return BUDGET_STOP;
    return n >= BUDGET_FULL * (double)budget ? BUDGET_RAISE : BUDGET_KEEP;
}

/* No more than there are, inside of the cell and out. */
static void budget_stop(struct budget *b, struct schedule *s, size_t inside, size_t outside)
{
    b->at.stopped = s->stopped = true;
    s->budget = inside;
    s->budget_outside = outside;
}

void budget_next(const struct budget *b, struct stage *at)
{
    struct schedule *s = &at->levels[at->at];
    double least = floor(BUDGET_RAISE_FACTOR * (double)at->start);
    size_t table = b->table[at->at];
    size_t want = least < (double)table ? (size_t)least : table;
    if (!b->n_held || s->budget >= want)
        return;
    log_info("train", "level=%u budget raised from %zu to %zu: it starts with %zu Gaussians",
             s->level, s->budget, want, at->start);
    s->budget = want;
}

enum err_code budget_look(struct budget *b, const struct model *m, const struct gallery *g,
                          const struct cell *cell, struct stage *at, uint32_t x, struct err *e)
{
    struct schedule *s = &at->levels[at->at];
    uint32_t count = schedule_densify_count(s), every = count / BUDGET_LOOKS + 1;
    double psnr = 0.0;
    size_t inside = 0;
    if (!b->n_held || b->at.stopped || x % every)
        return ERR_OK;
    enum err_code rc = budget_psnr(b, m, g, at, &psnr, e);
    if (!rc)
        rc = model_count_inside(m, cell, &inside, e);
    if (rc)
        return rc;
    if (isnan(psnr)) {
        log_warn("train",
                 "level=%u step=%u: masks leave nothing of the held-out photographs: the budget "
                 "stays",
                 s->level, at->step);
        return ERR_OK;
    }
    double n = (double)inside;
    enum budget_step step = budget_decide(&b->at, n, psnr, s->budget, g->cfg->budget_gain_db);
    log_debug("train",
              "budget level=%u step=%u gaussians=%zu outside=%zu held_out_psnr_db=%.3f decision=%d",
              s->level, at->step, inside, m->gauss.n - inside, psnr, step);
    if (step == BUDGET_STOP) {
        budget_stop(b, s, inside, m->gauss.n - inside);
        log_info("train",
                 "level=%u densification stops at %u Gaussians (step %u): held-out photographs "
                 "gain less than "
                 "--budget-gain-db from more",
                 s->level, m->gauss.n, at->step);
    } else if (step == BUDGET_RAISE) {
        double up = floor(BUDGET_RAISE_FACTOR * (double)s->budget);
        s->budget = up < (double)b->table[at->at] ? (size_t)up : b->table[at->at];
    }
    if (!(b->at.n > 0.0) || n >= BUDGET_GREW * b->at.n) {
        b->at.n = n;
        b->at.psnr_db = psnr;
    }
    return ERR_OK;
}
