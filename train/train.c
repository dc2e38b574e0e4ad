/* A whole training run of one scene: read it, make or resume the state, go through the levels, score and save
 * each, leave a state to resume from whenever the run is interrupted.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

#include "train/level.h"

enum { TRAIN_LOG_STEPS = 20, TRAIN_LINE_STEPS = 100 };

static const struct options_def train_defs[] = {
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct train_config, type, key, def, lo, hi, unit, help)
#include "train/options.def"
#undef OPT
};

static const struct options_spec train_spec = {
    .command = "train",
    .usage = "citysplat train SCENE [options]",
    .about = "Train Gaussians at several levels of detail from a scene that `citysplat ingest` or `citysplat "
             "synth` made. Results go to SCENE/cells/, measurements to SCENE/metrics.jsonl. Ctrl-C saves the "
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

/* ---- one run --------------------------------------------------------------------------------------- */

struct train { /* everything that lives as long as the run */
    const struct train_config *cfg;
    const char *scene_dir;
    struct scene scene;
    uint32_t *images, *test_images;
    size_t n_images, n_test;
    struct dev dev;
    bool dev_is_open;
    struct level level;
    char cell_dir[FILE_PATH_MAX], resume_path[FILE_PATH_MAX];
    struct progress progress;
    double start_s;
    uint64_t steps_run, last_saved; /* in this process */
    struct train_result *result;
};

static enum err_code train_paths(struct train *t, struct err *e)
{
    char cells[FILE_PATH_MAX];
    const char *base = t->cfg->output ? t->cfg->output : t->scene_dir;
    enum err_code rc = file_join(cells, base, "cells", e);
    if (!rc)
        rc = file_join(t->cell_dir, cells, t->level.cell.id, e);
    if (!rc)
        rc = file_join(t->resume_path, t->cell_dir, "resume.ckpt", e);
    return rc;
}

static enum err_code train_level_path(const struct train *t, uint32_t level, char *out, struct err *e)
{
    char name[32];
    snprintf(name, sizeof(name), "level%u.ckpt", level);
    return file_join(out, t->cell_dir, name, e);
}

/* The resolved options beside the results: feeding the file back repeats the run. */
static enum err_code train_write_config(const struct train *t, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *o = NULL;
    enum err_code rc = file_join(path, t->cfg->output ? t->cfg->output : t->scene_dir, "config.jsonc", e);
    if (!rc)
        rc = options_to_json(train_options(), t->cfg, &o, e);
    if (!rc)
        rc = jsonc_write(path, o, e);
    json_decref(o);
    return rc;
}

static enum err_code train_open_scene(struct train *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = scene_read(t->scene_dir, &t->scene, e);
    if (!rc)
        rc = train_images(&t->scene, SCENE_TRAIN, t->cfg->test_split, &t->images, &t->n_images, e);
    if (!rc)
        rc = train_images(&t->scene, SCENE_TEST, t->cfg->test_split, &t->test_images, &t->n_test, e);
    if (!rc && !t->n_images)
        rc = err_set(e, ERR_DATA, "%s: no photographs to train on", t->scene_dir);
    if (rc)
        return rc;
    l->cfg = t->cfg;
    l->scene = &t->scene;
    l->images = t->images;
    l->n_images = t->n_images;
    l->n_levels = (uint32_t)t->cfg->level_count;
    cell_whole(&t->scene, t->images, t->n_images, &l->cell);
    rc = schedule_make(t->cfg, t->n_images, l->cell.edge_m, l->schedule, e);
    return rc ? rc : train_paths(t, e);
}

static enum err_code train_open_device(struct train *t, struct err *e)
{
    enum err_code rc = dev_open(t->cfg->device, &t->dev, e);
    if (rc)
        return rc;
    t->dev_is_open = true;
    t->level.dev = &t->dev;
    rc = render_open(&t->dev, &t->level.render, e);
    return rc ? rc : loss_open(&t->dev, &t->level.loss, e);
}

static enum err_code train_start(struct train *t, struct err *e)
{
    struct gauss g = {0};
    struct level *l = &t->level;
    if (t->cfg->resume && file_exists(t->resume_path)) {
        enum err_code rc = state_load(l, t->resume_path, e);
        if (!rc)
            log_info("train", "resume level=%u step=%u gaussians=%u", l->at + 1, l->step, l->model.n);
        return rc;
    }
    if (file_exists(t->resume_path))
        log_warn("train", "%s of an unfinished run is ignored and will be replaced; --resume goes on from it",
                 t->resume_path);
    enum err_code rc = init_gauss(&t->scene, t->images, t->n_images, &l->cell, (uint32_t)t->cfg->sh_degree,
                                  l->schedule[0].budget, (uint64_t)t->cfg->seed, &g, e);
    if (!rc)
        rc = level_open(l, &g, e);
    gauss_free(&g);
    return rc;
}

static enum err_code train_open_record(struct train *t, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct level *l = &t->level;
    /* The first thing written: nothing is left behind when the scene or the device cannot be opened. */
    enum err_code rc = file_mkdir(t->cell_dir, e);
    if (!rc)
        rc = file_join(path, t->cfg->output ? t->cfg->output : t->scene_dir, "metrics.jsonl", e);
    if (!rc)
        rc = record_open(path, t->cfg->resume, &l->record, e);
    if (rc)
        return rc;
    return record_line(l->record, t->cfg->resume ? "resume" : "start",
                        json_pack("{s:s, s:I, s:I, s:I, s:i, s:i, s:f, s:f}", "device", t->dev.name,
                                  "photographs", (json_int_t)t->n_images, "test_photographs",
                                  (json_int_t)t->n_test, "gaussians", (json_int_t)l->model.n, "level",
                                  (int)l->at + 1, "step", (int)l->step, "edge_m", l->cell.edge_m,
                                  "extent_m", l->cell.extent_m),
                        e);
}

/* ---- the loop ------------------------------------------------------------------------------------------ */

static enum err_code train_stop(struct train *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = state_save(l, t->resume_path, e);
    if (rc)
        return err_add(e, "stopped, but the state could not be saved");
    return err_set(e, ERR_CANCEL,
                   "stopped at level %u of %u, step %u of %u; the state is saved: the same command with "
                   "--resume goes on",
                   l->at + 1, l->n_levels, l->step, l->schedule[l->at].steps);
}

static enum err_code train_report(struct train *t, const struct loss_value *v, struct err *e)
{
    struct level *l = &t->level;
    char note[96];
    double psnr = l->mse_mean > 0.0 ? -10.0 * log10(l->mse_mean) : 0.0;
    snprintf(note, sizeof(note), "loss %.4f, PSNR %.2f dB, %.1f k Gaussians", l->loss_mean, psnr,
             l->model.n * 1e-3);
    progress_step(&t->progress, l->step, note);
    if (l->step % TRAIN_LINE_STEPS && l->step != l->schedule[l->at].steps)
        return ERR_OK;
    double now = clock_s(), seconds = now - l->step_s;
    l->step_s = now;
    json_t *o = json_pack("{s:i, s:i, s:f, s:f, s:f, s:f, s:I, s:f, s:I}", "level", (int)l->at + 1, "step",
                          (int)l->step, "loss", v->total, "l1", v->l1, "ssim", v->ssim, "psnr_mean_db",
                          psnr, "gaussians", (json_int_t)l->model.n, "s_since_last_line", seconds,
                          "feed_bytes", (json_int_t)feed_bytes(l->feed));
    return record_line(l->record, "step", o, e);
}

static enum err_code train_steps(struct train *t, struct err *e)
{
    struct level *l = &t->level;
    uint32_t steps = l->schedule[l->at].steps;
    while (l->step < steps) {
        struct loss_value v;
        uint32_t next = l->step + 1;
        bool look = next % TRAIN_LOG_STEPS == 0 || next == steps;
        enum err_code rc = level_step(l, look ? &v : NULL, e);
        t->steps_run++;
        if (!rc && look)
            rc = train_report(t, &v, e);
        if (rc)
            return rc;
        bool enough = t->cfg->stop_after > 0 && t->steps_run >= (uint64_t)t->cfg->stop_after;
        if (clock_stopping() || enough)
            return train_stop(t, e);
        if (t->steps_run - t->last_saved >= (uint64_t)t->cfg->checkpoint_interval && l->step < steps) {
            t->last_saved = t->steps_run;
            rc = state_save(l, t->resume_path, e);
            if (rc)
                return rc;
        }
    }
    return ERR_OK;
}

static enum err_code train_score(struct train *t, struct evaluate_score *out, struct err *e)
{
    struct level *l = &t->level;
    struct feed *feed = NULL;
    struct feed_config f = {
        .scene = &t->scene,
        .images = t->test_images,
        .n_images = t->n_test,
        .max_edge_px = (uint32_t)t->cfg->max_edge_px,
        .downsample = l->schedule[l->at].downsample,
        .cache_bytes = (size_t)64 << 20,
    };
    struct evaluate_model model = {l->render, &l->model, level_render_options(l, l->step)};
    struct evaluate_source source = {evaluate_draw_model, &model, NULL};
    enum err_code rc = feed_open(&f, &feed, e);
    if (!rc)
        rc = evaluate_run(feed, t->n_test, &source, out, e);
    feed_close(&feed);
    return rc;
}

/* Score and save the level in work, and remove results of finer levels, which belong to an older run. */
static enum err_code train_finish_level(struct train *t, struct err *e)
{
    struct level *l = &t->level;
    struct evaluate_score score = {0};
    char path[FILE_PATH_MAX];
    uint32_t k = l->at + 1;
    enum err_code rc = t->n_test ? train_score(t, &score, e) : ERR_OK;
    if (rc == ERR_CANCEL)
        return train_stop(t, e);
    if (!rc)
        rc = train_level_path(t, k, path, e);
    if (!rc)
        rc = state_save_level(l, path, t->n_test ? &score : NULL, e);
    for (uint32_t j = k + 1; !rc && j <= TRAIN_LEVELS_MAX; j++) {
        rc = train_level_path(t, j, path, e);
        if (!rc)
            (void)unlink(path);
    }
    if (rc)
        return rc;
    double seconds = clock_s() - t->start_s;
    t->result->n_gaussians[l->at] = l->model.n;
    t->result->psnr_db[l->at] = t->n_test ? score.psnr_db : (double)NAN;
    t->result->ssim[l->at] = t->n_test ? score.ssim : (double)NAN;
    if (t->n_test)
        log_info("train", "level=%u done gaussians=%u test_psnr_db=%.3f test_ssim=%.4f seconds=%.1f", k,
                 l->model.n, score.psnr_db, score.ssim, seconds);
    else
        log_info("train", "level=%u done gaussians=%u seconds=%.1f", k, l->model.n, seconds);
    return record_line(l->record, "level",
                        json_pack("{s:i, s:I, s:I, s:f, s:f, s:f, s:f, s:f, s:I}", "level", (int)k,
                                  "gaussians", (json_int_t)l->model.n, "test_photographs",
                                  (json_int_t)t->n_test, "psnr_db", score.psnr_db, "ssim", score.ssim,
                                  "ssim_valid", score.ssim_valid, "ms_frame", score.ms_frame, "seconds",
                                  seconds, "peak_bytes", (json_int_t)mem_peak_bytes()),
                        e);
}

static enum err_code train_levels(struct train *t, struct err *e)
{
    struct level *l = &t->level;
    enum err_code rc = level_begin(l, e);
    while (!rc && l->at < l->n_levels) {
        char what[48];
        snprintf(what, sizeof(what), "train level %u/%u", l->at + 1, l->n_levels);
        progress_start(&t->progress, what, l->schedule[l->at].steps);
        rc = train_steps(t, e);
        progress_end(&t->progress, NULL);
        if (!rc)
            rc = train_finish_level(t, e);
        if (!rc)
            rc = level_next(l, e);
    }
    return rc;
}

static void train_close(struct train *t)
{
    level_close(&t->level);
    record_close(&t->level.record);
    loss_close(&t->level.loss);
    render_close(&t->level.render);
    if (t->dev_is_open)
        dev_close(&t->dev);
    scene_free(&t->scene);
}

enum err_code train_run(const char *scene_dir, const struct train_config *cfg, struct train_result *out,
                        struct err *e)
{
    struct train *t = mem_array(1, sizeof(*t));
    *out = (struct train_result){.n_levels = (uint32_t)cfg->level_count};
    if (!t)
        return err_set(e, ERR_MEM, "train: out of memory");
    t->cfg = cfg;
    t->scene_dir = scene_dir;
    t->start_s = clock_s();
    t->result = out;
    enum err_code rc = train_open_scene(t, e);
    if (!rc)
        rc = train_open_device(t, e);
    if (!rc)
        rc = train_start(t, e);
    if (!rc)
        rc = train_write_config(t, e);
    if (!rc)
        rc = train_open_record(t, e);
    if (!rc)
        rc = train_levels(t, e);
    if (!rc)
        (void)unlink(t->resume_path); /* nothing is left to go on from */
    out->seconds = clock_s() - t->start_s;
    out->peak_bytes = mem_peak_bytes();
    train_close(t);
    mem_free(t);
    return rc;
}
