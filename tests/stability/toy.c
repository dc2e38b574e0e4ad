/* The toy scene and the run of the stability tests; see toy.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/stability/toy.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "scene/cells/cell.h"
#include "train/base/config.h"
#include "train/base/run_cell.h"
#include "train/base/schedule.h"
#include "train/level.h"
#include "train/loss/photometric.h"
#include "train/model/appearance_train.h"
#include "train/model/init.h"
#include "train/photographs/evaluate.h"
#include "train/photographs/photo_loader.h"
#include "train/state.h"
#include "train/train.h"
#include "train/train_scene.h"

#define TOY_PI 3.14159265358979323846
enum { TOY_CACHE_BYTES = 64 << 20 };

/* ---- the scene ---- */

struct toy toy_spec(void)
{
    return (struct toy){
        .seed = 11,
        .n = 60,
        .half_m = {6.0, 6.0, 0.3},
        .sigma_min_m = 0.3,
        .sigma_max_m = 1.0,
        .photos = 12,
        .test_every = 4,
        .width_px = 64,
        .height_px = 48,
        .ring_m = 6.0,
        .height_m = 10.0,
        .fov_y_rad = 0.9,
        .points = true,
    };
}

void toy_gauss(const struct toy *t, struct gauss *out)
{
    struct err e = {0};
    size_t row = 3 * gauss_sh_count(t->sh_degree);
    kit_ok(gauss_alloc(out, t->n, t->sh_degree, 0, &e), e);
    out->n = t->n;
    out->antialiased = true;
    memcpy(out->origin_enu_m, t->center_enu_m, sizeof out->origin_enu_m);
    for (size_t i = 0; i < t->n; i++) {
        for (size_t k = 0; k < 3; k++) {
            double at = 2.0 * rng_unit(t->seed, 1, 3 * i + k) - 1.0;
            double size = rng_unit(t->seed, 2, 3 * i + k);
            out->mean_m[3 * i + k] = (float)(t->half_m[k] * at);
            out->scale_log[3 * i + k] =
                (float)log(t->sigma_min_m + (t->sigma_max_m - t->sigma_min_m) * size);
        }
        for (size_t k = 0; k < 4; k++)
            out->quat_wxyz[4 * i + k] = (float)rng_normal(t->seed, 4, 4 * i + k);
        for (size_t k = 0; k < row; k++)
            out->sh[row * i + k] =
                (float)(k < 3 ? (rng_unit(t->seed, 3, 3 * i + k) - 0.5) / GAUSS_SH_C0
                              : 0.1 * rng_normal(t->seed, 5, row * i + k));
        out->opacity_logit[i] = 2.0f;
    }
}

struct camera toy_camera(const struct toy *t, size_t i)
{
    double angle = 2.0 * TOY_PI * (double)i / (double)t->photos;
    double ring = i % 2 ? 0.5 * t->ring_m : t->ring_m;
    double eye[3] = {t->center_enu_m[0] + ring * cos(angle), t->center_enu_m[1] + ring * sin(angle),
                     t->center_enu_m[2] + t->height_m};
    return camera_look_at(eye, t->center_enu_m, t->fov_y_rad, t->width_px, t->height_px);
}

void toy_draw(const struct gauss *g, const struct camera *cam, double *rgb)
{
    struct err e = {0};
    struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    kit_ok(render_ref_forward(g, cam, &ro, rgb, NULL, &e), e);
}

static void toy_photo(const struct toy *t, const struct gauss *g, size_t i, const char *path)
{
    struct err e = {0};
    struct image img = {0};
    struct camera cam = toy_camera(t, i);
    size_t n = (size_t)t->width_px * t->height_px * 3;
    double *rgb = mem_array(n, sizeof *rgb);
    assert_non_null(rgb);
    if (!t->blank)
        toy_draw(g, &cam, rgb);
    if (t->paint)
        t->paint(t->user, i, &cam, rgb);
    kit_ok(image_alloc(t->width_px, t->height_px, 3, &img, &e), e);
    for (size_t k = 0; k < n; k++)
        img.px[k] = (uint8_t)(fmin(fmax(rgb[k], 0.0), 1.0) * 255.0 + 0.5);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    image_free(&img);
    mem_free(rgb);
}

static void toy_points(const struct toy *t, const struct gauss *g, struct scene_point *points)
{
    size_t row = 3 * gauss_sh_count(g->sh_degree);
    for (size_t i = 0; i < g->n; i++) {
        points[i] = (struct scene_point){.error_px = 0.5f, .track_length = 3};
        for (size_t k = 0; k < 3; k++) {
            double c = 0.5 + GAUSS_SH_C0 * (double)g->sh[row * i + k];
            points[i].enu_m[k] = g->origin_enu_m[k] + (double)g->mean_m[3 * i + k] +
                                 t->point_noise_m * rng_normal(t->seed, 6, 3 * i + k);
            points[i].rgb[k] = (uint8_t)(255.0 * fmin(fmax(c, 0.0), 1.0) + 0.5);
        }
    }
}

void toy_write(const char *dir, const struct toy *t, const struct gauss *g)
{
    struct err e = {0};
    struct scene s = {.scale = 1.0, .rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}, .n_images = t->photos};
    struct scene_image images[TOY_PHOTOS_MAX];
    char names[TOY_PHOTOS_MAX][32], sub[FILE_PATH_MAX], path[FILE_PATH_MAX];
    assert_true(t->photos <= TOY_PHOTOS_MAX);
    kit_ok(file_join(sub, dir, "images", &e), e);
    kit_ok(file_mkdir(sub, &e), e);
    for (size_t i = 0; i < t->photos; i++) {
        bool test = t->test_every && i % t->test_every == 0;
        snprintf(names[i], sizeof names[i], "p%02zu.png", i);
        images[i] = (struct scene_image){.name = names[i],
                                         .cam = toy_camera(t, i),
                                         .split = test ? SCENE_TEST : SCENE_TRAIN,
                                         .group = (uint32_t)i,
                                         .gps_enu_m = {(double)NAN, (double)NAN, (double)NAN},
                                         .residual_m = (double)NAN};
        kit_ok(file_join(path, sub, names[i], &e), e);
        if (!t->drawn)
            toy_photo(t, g, i, path);
        if (t->pose)
            t->pose(t->user, i, &images[i].cam);
    }
    s.images = images;
    s.n_points = t->points ? g->n : 0;
    s.points = mem_array(g->n, sizeof *s.points);
    assert_non_null(s.points);
    toy_points(t, g, s.points);
    kit_ok(scene_write(dir, &s, &e), e);
    mem_free(s.points);
}

/* ---- a run ---- */

void toy_read_level(const char *dir, unsigned level, struct ckpt *out)
{
    struct err e = {0};
    char path[FILE_PATH_MAX + 64];
    snprintf(path, sizeof path, "%s/cells/all/level%u.ckpt", dir, level);
    kit_ok(ckpt_read(path, out, &e), e);
}

struct train_config toy_config(struct arena *a, const char *out)
{
    struct train_config c;
    struct err e = {0};
    kit_ok(options_defaults(train_options(), &c, a, &e), e);
    c.output = out;
    c.iterations.one = 300;
    c.downsample.v[0] = 2.0;
    c.downsample.v[1] = 1.0;
    c.budget.v[0] = 80;
    c.budget.v[1] = 100;
    c.budget.v[2] = 150;
    c.densify_interval_min = 8;
    c.coarse_iterations_min = 1;
    c.sh_degree = 1;
    return c;
}

struct dev toy_dev;

int toy_open_device(void **state)
{
    struct err e = {0};
    progress_quiet(true);
    log_set_level(LOG_ERROR);
    kit_ok(dev_open(NULL, &toy_dev, &e), e);
    return 0;
}

int toy_close_device(void **state)
{
    dev_close(&toy_dev);
    return 0;
}

static void toy_run_prepare(struct toy_run *r, const char *dir, const struct train_config *cfg)
{
    struct err e = {0};
    *r = (struct toy_run){0};
    kit_ok(scene_read(dir, &r->scene, &e), e);
    kit_ok(train_scene_images(&r->scene, SCENE_TRAIN, true, &r->images, &r->n_images, &e), e);
    kit_ok(train_scene_images(&r->scene, SCENE_TEST, true, &r->tests, &r->n_tests, &e), e);
    struct run_cell job = {.cfg = cfg, .scene = &r->scene, .dev = &toy_dev};
    cell_whole(&r->scene, r->images, r->n_images, &job.cell);
    kit_ok(render_open(&toy_dev, &job.render, &e), e);
    kit_ok(photometric_open(&toy_dev, &job.loss, &e), e);
    level_init(&r->level, &job, r->images, r->n_images);
    kit_ok(schedule_make(cfg, r->n_images, &job.cell, r->level.stage.levels, &e), e);
    if (appearance_train_wanted(cfg))
        kit_ok(appearance_train_open(&r->level.appearance, cfg, &r->scene, r->images, r->n_images,
                                     NULL, &e),
               e);
}

void toy_run_open_from(struct toy_run *r, const char *dir, const struct train_config *cfg,
                       const struct gauss *first)
{
    struct err e = {0};
    toy_run_prepare(r, dir, cfg);
    kit_ok(level_open(&r->level, first, &e), e);
    kit_ok(level_begin(&r->level, &e), e);
}

void toy_run_open(struct toy_run *r, const char *dir, const struct train_config *cfg)
{
    struct err e = {0};
    struct gauss g = {0};
    toy_run_prepare(r, dir, cfg);
    const struct init_input in = {.scene = &r->scene,
                                  .images = r->images,
                                  .n_images = r->n_images,
                                  .cell = &r->level.site.cell,
                                  .sh_degree = (uint32_t)cfg->sh_degree,
                                  .limit = stage_schedule(&r->level.stage)->budget,
                                  .seed = (uint64_t)cfg->seed};
    kit_ok(init_gauss(&in, &g, &e), e);
    if (appearance_train_is_on(&r->level.appearance))
        kit_ok(appearance_train_embed(&r->level.appearance, (uint64_t)cfg->seed, &g, &e), e);
    kit_ok(level_open(&r->level, &g, &e), e);
    kit_ok(level_begin(&r->level, &e), e);
    gauss_free(&g);
}

void toy_run_load(struct toy_run *r, const char *dir, const struct train_config *cfg,
                  const char *state_path)
{
    struct err e = {0};
    toy_run_prepare(r, dir, cfg);
    kit_ok(level_resume(&r->level, state_path, &e), e);
    kit_ok(level_begin(&r->level, &e), e);
}

double toy_run_steps(struct toy_run *r, uint32_t n)
{
    struct err e = {0};
    struct photometric_value v = {.total = (double)NAN};
    for (uint32_t i = 0; i < n; i++)
        kit_ok(level_step(&r->level, i + 1 == n ? &v : NULL, &e), e);
    return v.total;
}

double toy_run_level(struct toy_run *r)
{
    return toy_run_steps(r, r->level.stage.levels[r->level.stage.at].steps - r->level.stage.step);
}

void toy_run_next(struct toy_run *r)
{
    struct err e = {0};
    kit_ok(level_next(&r->level, &e), e);
}

struct evaluate_score toy_run_score(struct toy_run *r, double downsample)
{
    struct err e = {0};
    struct photo_loader *photos = NULL;
    struct level *l = &r->level;
    struct evaluate_score score;
    struct photo_loader_config f = {
        .scene = &r->scene,
        .images = r->n_tests ? r->tests : r->images,
        .n_images = r->n_tests ? r->n_tests : r->n_images,
        .max_edge_px = (uint32_t)l->cfg->max_edge_px,
        .downsample = downsample,
        .cache_bytes = TOY_CACHE_BYTES,
    };
    struct appearance_view look = {0};
    struct evaluate_model model = {l->engine.render, &l->model.gauss,
                                   gallery_options(&l->gallery, &l->stage),
                                   appearance_train_is_on(&l->appearance) ? &look : NULL};
    if (model.appearance)
        kit_ok(appearance_view_open(&look, &l->appearance.model, &r->scene, &e), e);
    struct evaluate_source source = {.draw = evaluate_draw_model, .user = &model};
    kit_ok(photo_loader_open(&f, &photos, &e), e);
    kit_ok(evaluate_run(photos, f.n_images, &source, &score, &e), e);
    photo_loader_close(&photos);
    appearance_view_close(&look);
    return score;
}

void toy_run_close(struct toy_run *r)
{
    level_close(&r->level);
    photometric_close(&r->level.engine.loss);
    render_close(&r->level.engine.render);
    scene_free(&r->scene);
}

/* ---- measures ---- */

static double toy_db(double sum, size_t n)
{
    return sum > 0.0 ? fmin(-10.0 * log10(sum / (double)n), 99.0) : 99.0;
}

double toy_psnr(const float *a, const float *b, size_t n)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++)
        sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
    return toy_db(sum, n);
}

double toy_psnr_d(const double *a, const double *b, size_t n)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++)
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    return toy_db(sum, n);
}

double toy_max_diff(const float *a, const float *b, size_t n)
{
    double worst = 0.0;
    for (size_t i = 0; i < n; i++) {
        double d = fabs((double)a[i] - (double)b[i]);
        if (!(d <= worst)) /* NaN counts as a difference */
            worst = d;
    }
    return worst;
}

bool toy_finite(const struct gauss *g)
{
    return gauss_count_bad(g, NULL) == 0;
}
