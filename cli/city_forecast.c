/* The forecast of a city: see city.h.
 *
 * A step's processor seconds follow from number and size of the photographs, by what was measured
 * (docs/scale.md), and from the speed of this machine. How fast it is, and how much other programs
 * take of it, is measured by a second of the same arithmetic on all cores. Processor seconds hardly
 * depend on other programs; seconds by the clock do.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "cli/city.h"
#include "cli/scene/align_work.h"
#include "core/pool.h"
#include "train/expect.h"

enum { PACE_FLOATS = 4096, PACE_ROUNDS = 20000, PACE_TASKS = 8, PACE_RUNS = 3 };
/* Processor seconds of a run of all tasks, on the machine of docs/scale.md. */
static const double pace_usual_s = 0.15;
static const double ingest_read_s = 0.06, ingest_write_s = 0.075; /* of a megapixel */
static const double stereo_s = 16;                                /* of a megapixel of a map */
static const double tile_s = 3e-6;                                /* of a Gaussian of all levels */
static const double store_bytes = 61, photo_bytes = 0.5, depth_bytes = 4.7, feature_bytes = 180;
enum { CITY_STEREO_PX = 800, CITY_TEST_EVERY = 8, CITY_STAGES = 5 };

struct city_stage {
    const char *name;
    double cpu_s, clock_s; /* without other programs */
};
struct city_need {
    struct city_stage stage[CITY_STAGES];
    struct align_pace pace;
    struct align_plan plan;
    struct align_forecast align;
    struct expect train;
    size_t n_train;
    double gaussians, store, scene, depth, work; /* Gaussians of all levels; bytes */
};

/* ---- the machine ---- */

static enum err_code city_pace_task(void *user, size_t i, struct err *e)
{
    float *out = user, x[PACE_FLOATS];
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    for (size_t k = 0; k < PACE_FLOATS; k++)
        x[k] = (float)(k + i) * 1e-3f;
    for (size_t r = 0; r < PACE_ROUNDS; r++)
        for (size_t k = 0; k < PACE_FLOATS; k++)
            x[k] = x[k] * 0.75f + 0.1f / (1.0f + x[k] * x[k]);
    out[i] = x[PACE_FLOATS / 2];
    return ERR_OK;
}

/* The fastest of some runs: a run may be disturbed for a moment. */
static enum err_code city_measure_pace(struct align_pace *out, struct err *e)
{
    float results[PACE_TASKS];
    enum err_code rc = ERR_OK;
    *out = (struct align_pace){.cores = pool_cores(), .slow = HUGE_VAL, .load = HUGE_VAL};
    for (size_t k = 0; !rc && k < PACE_RUNS; k++) {
        double cpu_s = clock_cpu_s(), now_s = clock_s();
        rc = pool_for(PACE_TASKS, 0, city_pace_task, results, e);
        cpu_s = clock_cpu_s() - cpu_s;
        now_s = clock_s() - now_s;
        out->slow = fmin(out->slow, cpu_s / pace_usual_s);
        out->load = fmin(out->load, now_s * (double)out->cores / cpu_s);
    }
    out->load = fmax(out->load, 1);
    return rc;
}

/* ---- the steps ---- */

static enum err_code city_expect_align(struct city *c, struct city_need *n, struct err *e)
{
    struct align_options o;
    enum err_code rc = options_defaults(align_options(), &o, &c->arena, e);
    if (!rc)
        rc = align_plan_pairs(&n->plan, (size_t)o.neighbours, (size_t)o.next, e);
    if (rc || c->sparse)
        return rc;
    n->align = align_plan_afford(&n->plan, 0, 0, &n->pace, 60 * c->o->minutes);
    const struct align_pace rest = {n->pace.cores, n->pace.slow, 1};
    double look = align_plan_look_s(&n->plan, n->pace.slow);
    n->stage[0] =
        (struct city_stage){"align", align_plan_cpu_s(&n->align) + look,
                            align_plan_clock_s(&n->align, &rest) + look / (double)n->pace.cores};
    double features = (double)n->align.features * (double)n->plan.n_usable;
    n->work = feature_bytes * features;
    return ERR_OK;
}

/* Size of a picture whose longest edge has so many pixels at most. */
static void city_shrink(const struct align_plan *p, double most, uint32_t size[2])
{
    double w = 1, h = 1;
    for (size_t i = 0; i < p->n; i++)
        if (align_plan_usable(&p->photos[i])) {
            w = fmax(w, p->photos[i].width_px);
            h = fmax(h, p->photos[i].height_px);
        }
    double k = fmin(1, most / fmax(w, h));
    size[0] = (uint32_t)fmax(1, w * k + 0.5);
    size[1] = (uint32_t)fmax(1, h * k + 0.5);
}

static void city_expect_scene(struct city *c, struct city_need *n)
{
    uint32_t full[2], map[2];
    double photos = (double)n->plan.n_usable, cores = (double)n->pace.cores;
    city_shrink(&n->plan, (double)c->o->max_edge_px, full);
    city_shrink(&n->plan, fmin((double)c->o->max_edge_px, CITY_STEREO_PX), map);
    double mp = 1e-6 * full[0] * full[1], map_mp = 1e-6 * map[0] * map[1] * (double)n->n_train;
    double ingest =
        n->pace.slow * photos * (ingest_read_s * n->plan.megapixels + ingest_write_s * mp);
    double stereo = n->pace.slow * stereo_s * map_mp;
    n->stage[1] = (struct city_stage){"ingest", ingest, ingest / cores};
    n->stage[2] = (struct city_stage){"stereo", stereo, stereo / cores};
    n->scene = photo_bytes * 1e6 * mp * photos;
    n->depth = depth_bytes * 1e6 * map_mp;
}

static enum err_code city_expect_train(struct city *c, struct city_need *n, struct err *e)
{
    struct train_config cfg;
    struct expect_photos photos = {
        .n_train = n->n_train, .n_test = n->plan.n_usable - n->n_train, .depths = true};
    uint32_t size[2];
    city_shrink(&n->plan, (double)c->o->max_edge_px, size);
    photos.width_px = size[0];
    photos.height_px = size[1];
    enum err_code rc = options_defaults(train_options(), &cfg, &c->arena, e);
    cfg.iterations.one = c->o->iterations;
    cfg.iterations.n = 1;
    cfg.final_all = true; /* as city_train */
    if (!rc)
        rc = expect_training(&cfg, &photos, &n->train, e);
    if (rc)
        return rc;
    double cores = (double)n->pace.cores, cpu = n->pace.slow * n->train.cpu_s;
    n->stage[3] = (struct city_stage){"train", cpu, cpu / (cores * EXPECT_BUSY)};
    for (size_t k = 0; k < TRAIN_LEVELS_MAX; k++)
        n->gaussians += (double)n->train.gaussians[k];
    double tile = n->pace.slow * tile_s * n->gaussians;
    n->stage[4] = (struct city_stage){"tile", tile, tile};
    n->store = store_bytes * n->gaussians;
    return ERR_OK;
}

/* ---- the text ---- */

static void city_print_stage(const struct city_stage *s, double load)
{
    printf("%-8s %14.1f %14.1f", s->name, s->cpu_s / 60, s->clock_s / 60);
    if (load > 1.2)
        printf(" %14.1f", load * s->clock_s / 60);
    printf("\n");
}

static void city_print(const struct city *c, const struct city_need *n)
{
    const struct align_plan *p = &n->plan;
    struct city_stage all = {.name = "all"};
    bool busy = n->pace.load > 1.2;
    printf("photos   %zu of %.1f Mpx, %zu with GPS; %zu train, %zu are kept for scores\n",
           p->n_usable, p->megapixels, p->n_gps, n->n_train, p->n_usable - n->n_train);
    printf("machine  %zu core%s, %.2f times the processor time of the usual one", n->pace.cores,
           n->pace.cores == 1 ? "" : "s", n->pace.slow);
    if (busy)
        printf("; others take %.0f %% of it now", 100 * (1 - 1 / n->pace.load));
    printf("\n\n%-8s %14s %14s", "minutes", "of a processor", "by the clock");
    printf(busy ? " %14s\n" : "\n", "as busy as now");
    for (size_t k = 0; k < CITY_STAGES; k++) {
        const struct city_stage *s = &n->stage[k];
        if (!s->name)
            continue;
        city_print_stage(s, n->pace.load);
        all.cpu_s += s->cpu_s;
        all.clock_s += s->clock_s;
    }
    city_print_stage(&all, n->pace.load);
    printf("\n");
    if (!c->sparse)
        printf("align    %zu pairs in pictures of %u px, %u features\n", p->n_pairs,
               n->align.edge_px, n->align.features);
    printf("train    %llu steps; at most", (unsigned long long)n->train.steps);
    for (size_t k = 0; k < TRAIN_LEVELS_MAX; k++)
        printf("%s %zu", k ? "," : "", n->train.gaussians[k]);
    printf(" Gaussians\n");
    printf("memory   %.1f GB at most, in training\n", 1e-9 * n->train.memory_bytes);
    printf("disk     %.2f GB: photographs %.2f, depths %.2f, trained levels %.2f, poses %.2f, "
           "tiles %.2f\n",
           1e-9 * (n->scene + n->depth + n->train.checkpoint_bytes + n->work + n->store),
           1e-9 * n->scene, 1e-9 * n->depth, 1e-9 * n->train.checkpoint_bytes, 1e-9 * n->work,
           1e-9 * n->store);
    printf("store    %.1f MB, which a server needs alone\n", 1e-6 * n->store);
}

enum err_code city_forecast(struct city *c, struct err *e)
{
    struct city_need n = {0};
    log_set_level(LOG_WARN); /* what training and its budgets tell when it begins */
    enum err_code rc = align_plan_read(c->images, &n.plan, e);
    if (!rc)
        rc = city_measure_pace(&n.pace, e);
    n.n_train = n.plan.n_usable - (n.plan.n_usable + CITY_TEST_EVERY - 1) / CITY_TEST_EVERY;
    if (!rc)
        rc = city_expect_align(c, &n, e);
    if (!rc) {
        city_expect_scene(c, &n);
        rc = city_expect_train(c, &n, e);
    }
    if (!rc)
        city_print(c, &n);
    align_plan_free(&n.plan);
    return rc;
}
