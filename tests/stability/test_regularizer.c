/* Stability of terms of the loss: sizes and needles (F4), statistics that do not contain them
 * (F16), maps of known depths (F21), resuming with terms on Gaussians (F30).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "codec/container/npy.h"
#include "codec/scene/scene.h"
#include "core/layout.h"
#include "tests/stability/toy.h"
#include "train/base/config.h"
#include "train/level.h"
#include "train/loss/depth_map.h"
#include "train/train.h"
#include "train/train_scene.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static char scene_dir[FILE_PATH_MAX];

/* ---- a scene ---- */

/* Flat, opaque, overlapping blobs on a ground with relief. */
static struct toy ground_spec(void)
{
    struct toy t = toy_spec();
    t.n = 650;
    t.half_m[0] = t.half_m[1] = 9.0; /* all that the cameras see */
    t.sigma_min_m = 0.5;
    t.sigma_max_m = 0.8;
    return t;
}

static void ground_gauss(const struct toy *t, struct gauss *g)
{
    static const float level[4] = {1.0f, 0.0f, 0.0f, 0.0f};
    toy_gauss(t, g);
    for (size_t i = 0; i < g->n; i++) {
        float *at = g->mean_m + 3 * i;
        at[2] = 0.6f * sinf(0.7f * at[0]) * cosf(0.7f * at[1]);
        g->scale_log[3 * i + 2] = logf(0.05f);
        memcpy(g->quat_wxyz + 4 * i, level, sizeof level);
        g->opacity_logit[i] = 4.0f;
    }
}

static int ground_setup(void **state)
{
    struct toy t = ground_spec();
    struct gauss g = {0};
    (void)toy_open_device(state);
    kit_tmpdir(scene_dir);
    ground_gauss(&t, &g);
    toy_write(scene_dir, &t, &g);
    gauss_free(&g);
    return 0;
}

static int ground_teardown(void **state)
{
    kit_rmdir(scene_dir);
    return toy_close_device(state);
}

/* One level of so many steps in which Gaussians are neither added nor removed: what is left is what
 * the losses did. */
static struct train_config plain_config(struct arena *a, int64_t steps)
{
    struct train_config c = toy_config(a, NULL);
    c.level_count = 1;
    c.iterations.one = steps;
    c.budget.v[2] = 5000;
    c.densify_from = 1000000000;
    c.scale_weight = 0.0;
    /* they fade floaters as well */
    c.solid_spread = c.solid_light = c.solid_flat = 0.0;
    return c;
}

static void run_gauss(struct toy_run *r, struct gauss *g)
{
    struct err e = {0};
    kit_ok(model_gauss(&r->level.model, g, &e), e);
}

/* ---- F4: sizes and needles ---- */

enum { F4_STEPS = 500 };
#define F4_S_MAX_M 1.0
#define F4_SIZE_LIMIT 1.2 /* of s_max */
#define F4_RATIO_LIMIT 12.0
#define F4_COST_DB 0.5 /* of loss and removal, against neither */

static int f4_compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Largest axis in s_max, and the 99th percentile of largest over middle axis. */
static void f4_measure(const struct gauss *g, double *size, double *ratio)
{
    double *r = mem_array(g->n, sizeof *r);
    assert_non_null(r);
    *size = 0.0;
    for (size_t i = 0; i < g->n; i++) {
        double s[3];
        for (size_t k = 0; k < 3; k++)
            s[k] = exp((double)g->scale_log[3 * i + k]);
        qsort(s, 3, sizeof *s, f4_compare);
        *size = fmax(*size, s[2] / F4_S_MAX_M);
        r[i] = s[2] / s[1];
    }
    qsort(r, g->n, sizeof *r, f4_compare);
    *ratio = r[(size_t)(0.99 * (double)(g->n - 1))];
    mem_free(r);
}

static void f4_train(const struct train_config *c, const struct gauss *first, double *size,
                     double *ratio, double *psnr)
{
    struct toy_run r;
    struct gauss g = {0};
    toy_run_open_from(&r, scene_dir, c, first);
    toy_run_steps(&r, F4_STEPS);
    run_gauss(&r, &g);
    assert_true(toy_finite(&g));
    f4_measure(&g, size, ratio);
    *psnr = toy_run_score(&r, 1.0).psnr_db;
    gauss_free(&g);
    toy_run_close(&r);
}

/* 1 % of the Gaussians begin 50 times too large, 5 % as needles of 100 to 1. */
static void giants_and_needles_shrink(void **state)
{
    struct arena a = {0};
    struct gauss first = {0};
    struct toy t = ground_spec();
    double size[4], ratio[4], psnr[4];
    struct train_config c = plain_config(&a, F4_STEPS);
    c.scale_max_m = F4_S_MAX_M;
    c.scale_from = 0;
    ground_gauss(&t, &first);
    for (size_t i = 0; i < first.n; i++)
        for (size_t k = 0; k < 3; k++) {
            if (i % 100 == 0)
                first.scale_log[3 * i + k] = (float)log(50.0 * F4_S_MAX_M);
            else if (i % 20 == 0)
                first.scale_log[3 * i + k] = (float)log(k == i / 20 % 3 ? 0.5 : 0.005);
        }
    f4_measure(&first, &size[0], &ratio[0]);
    f4_train(&c, &first, &size[1], &ratio[1], &psnr[1]);
    c.scale_weight = 0.05;
    f4_train(&c, &first, &size[2], &ratio[2], &psnr[2]);
    c.densify_from = 0; /* as it is used: with removal by size */
    c.budget.v[2] =
        (int64_t)first.n; /* removal alone: more Gaussians would learn 9 photographs by heart */
    c.tau.v[2] = 1e3;     /* nothing grows */
    f4_train(&c, &first, &size[3], &ratio[3], &psnr[3]);
    toy_figure("F4",
               "size_before=%.1f size_none=%.2f size_loss=%.2f size_loss_prune=%.2f limit=%.1f "
               "ratio_before=%.0f ratio_none=%.1f ratio_loss=%.1f ratio_loss_prune=%.1f limit=%.0f "
               "psnr_none_db=%.2f psnr_loss_db=%.2f psnr_loss_prune_db=%.2f",
               size[0], size[1], size[2], size[3], F4_SIZE_LIMIT, ratio[0], ratio[1], ratio[2],
               ratio[3], F4_RATIO_LIMIT, psnr[1], psnr[2], psnr[3]);
    assert_true(size[3] < F4_SIZE_LIMIT);
    assert_true(ratio[2] < F4_RATIO_LIMIT && ratio[3] < F4_RATIO_LIMIT);
    assert_true(size[2] < 0.8 * size[1]); /* it is the loss's doing */
    assert_true(psnr[2] >= psnr[1] - F4_COST_DB && psnr[3] >= psnr[1] - F4_COST_DB);
    assert_true(size[1] > F4_SIZE_LIMIT && ratio[1] > F4_RATIO_LIMIT);
    gauss_free(&first);
    arena_free(&a);
}

/* ---- F16: statistics of densification ---- */

enum { F16_STEPS = 20, F16_STATS = 4 };

/* Statistics after some steps, and the parameters: [F16_STATS][n] and the model's floats. */
static float *f16_train(const struct train_config *c, uint32_t steps, size_t *floats)
{
    struct toy_run r;
    struct err e = {0};
    toy_run_open(&r, scene_dir, c);
    (void)toy_run_steps(&r, steps);
    const struct render_model *m = &r.level.model.gauss;
    size_t n = m->n, params = layout_floats(n, m->planes);
    float *out = mem_array(F16_STATS * n + params, sizeof *out);
    assert_non_null(out);
    cl_mem stats[F16_STATS] = {r.level.model.stats.grad, r.level.model.stats.absg,
                               r.level.model.stats.count, r.level.model.stats.radius};
    for (size_t i = 0; i < F16_STATS; i++)
        kit_ok(dev_read(&toy_dev, stats[i], 0, n * sizeof *out, out + i * n, &e), e);
    kit_ok(dev_read(&toy_dev, m->params, 0, params * sizeof *out, out + F16_STATS * n, &e), e);
    *floats = F16_STATS * n + params;
    toy_run_close(&r);
    return out;
}

static size_t f16_differing(const float *a, const float *b, size_t n)
{
    size_t bits = 0;
    for (size_t i = 0; i < n; i++)
        bits += memcmp(a + i, b + i, sizeof *a) != 0;
    return bits;
}

static void statistics_do_not_see_terms_on_gaussians(void **state)
{
    struct arena a = {0};
    struct train_config c = plain_config(&a, F16_STEPS + 30);
    size_t n, k, stats;
    c.absgrad_from = 1;
    c.scale_from = 0;
    c.scale_max_m = 0.1;
    float *plain = f16_train(&c, F16_STEPS, &n);
    c.scale_weight = 1e-300; /* computed, and 0 as a float */
    float *forced = f16_train(&c, F16_STEPS, &k);
    assert_int_equal(n, k);
    size_t weightless = f16_differing(plain, forced, n);
    mem_free(plain);
    mem_free(forced);
    /* With a weight parameters part ways after the first step: until then statistics are equal. */
    c.scale_weight = 0.5;
    forced = f16_train(&c, 1, &k);
    c.scale_weight = 0.0;
    plain = f16_train(&c, 1, &k);
    struct toy t = ground_spec();
    stats = F16_STATS * t.n;
    size_t weighted = f16_differing(plain, forced, stats);
    size_t moved = f16_differing(plain + stats, forced + stats, k - stats);
    toy_figure("F16", "differing_weight0=%zu differing_stats=%zu limit=0 params_moved=%zu",
               weightless, weighted, moved);
    assert_int_equal(weightless, 0);
    assert_int_equal(weighted, 0);
    assert_true(moved > t.n); /* the loss did act */
    mem_free(plain);
    mem_free(forced);
    arena_free(&a);
}

/* ---- F21: maps of known depths ---- */

enum { NOT_KNOWN = 4 /* rows of a map, the last */ };

/* Inverse depths of a photograph, 1 / m: cameras are 10 m high. */
static void truth_depth(size_t image, double *depth)
{
    struct toy t = ground_spec();
    for (size_t p = 0; p < (size_t)t.width_px * t.height_px; p++)
        depth[p] = 0.1 + 0.02 * sin(0.01 * (double)p + (double)image);
}

static void maps_write(const char *dir, const struct scene *s, const uint32_t *images, size_t n)
{
    struct toy t = ground_spec();
    size_t pixels = (size_t)t.width_px * t.height_px, shape[2] = {t.height_px, t.width_px};
    double *truth = mem_array(pixels, sizeof *truth);
    float *map = mem_array(pixels, sizeof *map);
    char path[FILE_PATH_MAX + 32];
    struct err e = {0};
    assert_true(truth && map);
    for (size_t i = 0; i < n; i++) {
        truth_depth(images[i], truth);
        for (size_t p = 0; p < pixels; p++)
            map[p] = p < pixels - NOT_KNOWN * t.width_px ? (float)truth[p] : NAN;
        snprintf(path, sizeof path, "%s/%s.npy", dir, s->images[images[i]].name);
        kit_ok(npy_write(path, map, 2, shape, &e), e);
    }
    mem_free(truth);
    mem_free(map);
}

/* A photograph without a map has no target; a part of a photograph has the part of its map. */
static void maps_are_read_and_left_out(void **state)
{
    struct toy t = ground_spec();
    struct scene s;
    struct depth_map *maps = NULL;
    struct depth_target target, whole;
    struct err e = {0};
    struct buf junk = {0};
    uint32_t *images;
    size_t n, pixels = (size_t)t.width_px * t.height_px, known = pixels - NOT_KNOWN * t.width_px;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 32];
    double *truth = mem_array(pixels, sizeof *truth);
    assert_non_null(truth);
    kit_tmpdir(dir);
    kit_ok(scene_read(scene_dir, &s, &e), e);
    kit_ok(train_scene_images(&s, SCENE_TRAIN, true, &images, &n, &e), e);
    maps_write(dir, &s, images, n);
    snprintf(path, sizeof path, "%s/%s.npy", dir, s.images[images[0]].name);
    assert_int_equal(remove(path), 0);
    const struct depth_map_config cfg = {.scene = &s, .images = images, .n_images = n, .dir = dir};
    kit_ok(depth_map_open(&cfg, &maps, &e), e);
    for (size_t i = 0; i < n; i++) {
        kit_ok(depth_map_target(maps, images[i], &s.images[images[i]].cam, NULL, &target, &e), e);
        /* between a row that is known and one that is not, nothing is */
        assert_in_range(target.n_known, i ? known - t.width_px : 0, i ? known : 0);
        truth_depth(images[i], truth);
        for (size_t p = 0; i && p < pixels; p++) {
            double is = (double)target.t[p] / target.unit_m;
            assert_true(p < known ? target.t[p] < 0.0f || fabs(is - truth[p]) < 1e-6
                                  : target.t[p] < 0.0f);
        }
    }
    const struct camera *full = &s.images[images[n - 1]].cam;
    const struct camera_window window = {0.21, 0.4, 0.83, 0.9};
    const struct camera part = camera_crop(full, &window);
    uint32_t at[4];
    camera_window_px(full, &window, at);
    kit_ok(depth_map_target(maps, images[n - 1], full, NULL, &whole, &e), e);
    for (size_t p = 0; p < pixels; p++)
        truth[p] = whole.t[p] < 0.0f ? -1.0 : (double)whole.t[p] / whole.unit_m;
    kit_ok(depth_map_target(maps, images[n - 1], &part, NULL, &target, &e), e);
    for (uint32_t y = 0; y < at[3]; y++)
        for (uint32_t x = 0; x < at[2]; x++) {
            double is = (double)target.t[y * at[2] + x] / target.unit_m,
                   was = truth[(at[1] + y) * full->width_px + at[0] + x];
            assert_true(was < 0.0 ? is < 0.0 : fabs(is - was) < 1e-5);
        }
    uint8_t *mask = mem_array(pixels, 1); /* all but a corner is a car */
    assert_non_null(mask);
    memset(mask, 255, 40);
    kit_ok(depth_map_target(maps, images[n - 1], full, mask, &target, &e), e);
    assert_int_equal(target.n_known, 40);
    assert_true(target.t[39] >= 0.0f && target.t[40] < 0.0f);
    mem_free(mask);
    snprintf(path, sizeof path, "%s/%s.npy", dir, s.images[images[1]].name);
    kit_ok(file_read(path, 0, &junk, &e), e);
    kit_ok(file_write(path, junk.data, junk.size / 2, &e), e);
    kit_fails(depth_map_target(maps, images[1], full, NULL, &target, &e), ERR_FORMAT, e,
              "truncated");
    assert_int_equal(remove(path), 0);
    kit_fails(depth_map_target(maps, images[1], full, NULL, &target, &e), ERR_NOENT, e, "has gone");
    depth_map_close(&maps);
    const struct depth_map_config none = {
        .scene = &s, .images = images, .n_images = n, .dir = scene_dir};
    kit_fails(depth_map_open(&none, &maps, &e), ERR_DATA, e, "no depth map can be used");
    buf_free(&junk);
    scene_free(&s);
    mem_free(truth);
    kit_rmdir(dir);
}

/* ---- F30 with terms on Gaussians ---- */

static void resume_train(const char *out, const int64_t *pieces, size_t n_pieces)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_result r = {0};
    struct train_config c = toy_config(&a, out);
    c.iterations.one = 330;
    c.scale_from = 0;
    c.scale_max_m = 0.5;
    c.budget.v[0] = 660;
    c.budget.v[1] = 700;
    c.budget.v[2] = 800;
    for (size_t i = 0; i < n_pieces; i++) {
        c.stop_after = pieces[i];
        c.resume = i > 0;
        kit_fails(train_run(scene_dir, &c, &r, &e), ERR_CANCEL, e, "--resume goes on");
        train_result_free(&r);
    }
    c.stop_after = 0;
    c.resume = n_pieces > 0;
    kit_ok(train_run(scene_dir, &c, &r, &e), e);
    train_result_free(&r);
    arena_free(&a);
}

static void resumed_runs_with_limited_sizes_are_the_same(void **state)
{
    /* in the middle of levels and around densifications */
    static const int64_t pieces[] = {37, 30, 45, 103};
    char *out[2];
    for (int i = 0; i < 2; i++) {
        out[i] = mem_array(FILE_PATH_MAX, 1);
        assert_non_null(out[i]);
        kit_tmpdir(out[i]);
        resume_train(out[i], pieces, i ? sizeof pieces / sizeof pieces[0] : 0);
    }
    for (int level = 1; level <= 3; level++) {
        struct ckpt c[2];
        struct err e = {0};
        for (int i = 0; i < 2; i++) {
            char path[FILE_PATH_MAX], name[64];
            snprintf(name, sizeof name, "cells/all/level%d.ckpt", level);
            kit_ok(file_join(path, out[i], name, &e), e);
            kit_ok(ckpt_read(path, &c[i], &e), e);
        }
        assert_int_equal(c[0].g.n, c[1].g.n);
        assert_memory_equal(c[0].g.mean_m, c[1].g.mean_m, c[0].g.n * 12);
        assert_memory_equal(c[0].g.scale_log, c[1].g.scale_log, c[0].g.n * 12);
        assert_memory_equal(c[0].g.opacity_logit, c[1].g.opacity_logit, c[0].g.n * 4);
        for (int i = 0; i < 2; i++)
            ckpt_free(&c[i]);
    }
    for (int i = 0; i < 2; i++) {
        kit_rmdir(out[i]);
        mem_free(out[i]);
    }
}

int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(giants_and_needles_shrink),
        cmocka_unit_test(statistics_do_not_see_terms_on_gaussians),
        cmocka_unit_test(maps_are_read_and_left_out),
        cmocka_unit_test(resumed_runs_with_limited_sizes_are_the_same),
    };
    return cmocka_run_group_tests(tests, ground_setup, ground_teardown);
}
