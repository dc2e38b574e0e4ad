/* Training as a whole on a toy: the loss falls as recorded, runs repeat bit by bit, a stopped run
 * continues as if it had not been stopped, and broken scenes give one clear error.
 *
 * The toy is coloured blobs on a patch of ground, photographed from above by cameras on a ring. The
 * renderer draws the photographs, so a perfect fit exists. It is one long file, because all of it
 * trains that toy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "render/render.h"
#include "scene/cells/cell.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "scene/cells/share.h"
#include "tests/stability/toy.h"
#include "train/base/run_cell.h"
#include "train/base/schedule.h"
#include "train/loss/photometric.h"
#include "train/model/init.h"
#include "train/photographs/inputs.h"
#include "train/photographs/photo_loader.h"
#include "train/train.h"
#include "train/train_scene.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

enum { BLOBS = 60, PHOTOS = 9, WIDTH = 64, HEIGHT = 48 };
#define GROUND_M 6.0
#define TOY_PSNR_DB 19.0 /* 20.3 when written */
/* Golden numbers were made on one CPU; another one's exp() or fused operations may differ by this
 * much. */
#define GOLDEN_REL 2e-3

static struct dev dev; /* one for all tests: kernels are built once */
static char scene_dir[FILE_PATH_MAX];

/* ---- the toy ---- */

static void blobs_gauss(struct gauss *g)
{
    struct err e = {0};
    kit_ok(gauss_alloc(g, BLOBS, 0, 0, &e), e);
    g->n = BLOBS;
    g->antialiased = true;
    for (size_t i = 0; i < BLOBS; i++) {
        for (size_t k = 0; k < 3; k++) {
            double half = k < 2 ? GROUND_M : 0.3;
            g->mean_m[3 * i + k] = (float)(half * (2.0 * rng_unit(11, 1, 3 * i + k) - 1.0));
            g->scale_log[3 * i + k] = logf((float)(0.3 + 0.7 * rng_unit(11, 2, 3 * i + k)));
            g->sh[3 * i + k] = (float)((rng_unit(11, 3, 3 * i + k) - 0.5) / GAUSS_SH_C0);
        }
        for (size_t k = 0; k < 4; k++)
            g->quat_wxyz[4 * i + k] = (float)rng_normal(11, 4, 4 * i + k);
        g->opacity_logit[i] = 2.0f;
    }
}

static struct camera blobs_camera(size_t i)
{
    double angle = 2.0 * 3.14159265358979 * (double)i / PHOTOS;
    double eye[3] = {6.0 * cos(angle), 6.0 * sin(angle), 10.0}, target[3] = {0.0, 0.0, 0.0};
    return camera_look_at(eye, target, 0.9, WIDTH, HEIGHT);
}

static void blobs_photo(struct render *r, const struct render_model *m, const struct camera *cam,
                        const char *path)
{
    struct err e = {0};
    struct image img = {0};
    struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    float *rgb = mem_array(WIDTH * HEIGHT * 3, sizeof(float));
    assert_non_null(rgb);
    kit_ok(render_forward(r, m, cam, &ro, rgb, NULL, &e), e);
    kit_ok(image_alloc(WIDTH, HEIGHT, 3, &img, &e), e);
    for (size_t i = 0; i < WIDTH * HEIGHT * 3; i++)
        img.px[i] = (uint8_t)(fminf(fmaxf(rgb[i], 0.0f), 1.0f) * 255.0f + 0.5f);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    image_free(&img);
    mem_free(rgb);
}

/* Scene folder with PHOTOS photographs, the first one for tests. */
static void blobs_write(const char *dir, bool with_points)
{
    struct err e = {0};
    struct gauss g = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    struct scene s = {.scale = 1.0, .rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}, .n_images = PHOTOS};
    struct scene_image images[PHOTOS];
    struct scene_point points[BLOBS];
    char names[PHOTOS][16], sub[FILE_PATH_MAX], path[FILE_PATH_MAX];
    blobs_gauss(&g);
    kit_ok(file_join(sub, dir, "images", &e), e);
    kit_ok(file_mkdir(sub, &e), e);
    kit_ok(render_open(&dev, &r, &e), e);
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    for (size_t i = 0; i < PHOTOS; i++) {
        snprintf(names[i], sizeof names[i], "p%zu.png", i);
        images[i] = (struct scene_image){.name = names[i],
                                         .cam = blobs_camera(i),
                                         .split = i ? SCENE_TRAIN : SCENE_TEST,
                                         .group = (uint32_t)i,
                                         .gps_enu_m = {(double)NAN, (double)NAN, (double)NAN},
                                         .residual_m = (double)NAN};
        kit_ok(file_join(path, sub, names[i], &e), e);
        blobs_photo(r, &m, &images[i].cam, path);
    }
    for (size_t i = 0; i < BLOBS; i++) {
        points[i] = (struct scene_point){.error_px = 0.5f, .track_length = 3};
        for (size_t k = 0; k < 3; k++) {
            points[i].enu_m[k] = (double)g.mean_m[3 * i + k];
            points[i].rgb[k] = (uint8_t)(255.0 * rng_unit(11, 3, 3 * i + k));
        }
    }
    s.images = images;
    s.points = points;
    s.n_points = with_points ? BLOBS : 0;
    kit_ok(scene_write(dir, &s, &e), e);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
}

/* train_run into a result that is in use. */
static enum err_code train_again(const char *dir, const struct train_config *c,
                                 struct train_result *r, struct err *e)
{
    train_result_free(r);
    return train_run(dir, c, r, e);
}

/* ---- pieces ---- */

static void cameras_at_training_size_keep_the_view(void **state)
{
    (void)state;
    struct camera c = blobs_camera(0);
    c.width_px = 4000;
    c.height_px = 3000;
    struct camera s = photo_loader_camera(&c, 400, 2.0);
    assert_int_equal(s.width_px, 200);
    assert_int_equal(s.height_px, 150);
    assert_true(fabs(s.fx_px / c.fx_px - 0.05) < 1e-12);
    s = photo_loader_camera(&c, 0, 1.0);
    assert_int_equal(s.width_px, 4000);
    s = photo_loader_camera(&c, 9000, 1.0); /* never enlarged */
    assert_int_equal(s.width_px, 4000);
    c.width_px = c.height_px = 3;
    s = photo_loader_camera(&c, 0, 64.0);
    assert_int_equal(s.width_px, 1);
}

static void the_feed_shows_every_photograph_once_an_epoch_within_its_cache(void **state)
{
    (void)state;
    struct err e = {0};
    struct scene s;
    uint32_t *images;
    size_t n;
    kit_ok(scene_read(scene_dir, &s, &e), e);
    kit_ok(train_scene_images(&s, SCENE_TRAIN, true, &images, &n, &e), e);
    assert_int_equal(n, PHOTOS - 1);
    uint32_t order[2][4 * (PHOTOS - 1)];
    const size_t photo = WIDTH * HEIGHT * 3;
    const size_t caches[2] = {photo, 1 << 20};
    for (int k = 0; k < 2; k++) {
        struct photo_loader *f = NULL;
        struct photo_loader_config cfg = {.scene = &s,
                                          .images = images,
                                          .n_images = n,
                                          .downsample = 1.0,
                                          .cache_bytes = caches[k],
                                          .seed = 5,
                                          .level = 1};
        kit_ok(photo_loader_open(&cfg, &f, &e), e);
        for (uint32_t t = 1; t <= 4 * n; t++) {
            struct photo p;
            kit_ok(photo_loader_get(f, t, &p, &e), e);
            assert_true(photo_loader_bytes(f) <= cfg.cache_bytes);
            order[k][t - 1] = p.image;
            struct image want = {0};
            char path[FILE_PATH_MAX + 64];
            snprintf(path, sizeof path, "%s/images/%s", scene_dir, s.images[p.image].name);
            kit_ok(image_read(path, NULL, &want, &e), e);
            assert_memory_equal(want.px, p.px, photo);
            image_free(&want);
        }
        photo_loader_close(&f);
    }
    assert_memory_equal(order[0], order[1], sizeof order[0]); /* the cache does not matter */
    bool differs = false;
    for (size_t epoch = 0; epoch < 4; epoch++) {
        unsigned seen = 0;
        for (size_t i = 0; i < n; i++) {
            seen |= 1u << order[0][epoch * n + i];
            differs = differs || order[0][epoch * n + i] != order[0][i];
        }
        assert_int_equal(seen, 0x1fe); /* all but photograph 0, which is for tests */
    }
    assert_true(differs);
    scene_free(&s);
}

static void the_feed_cuts_photographs_to_their_windows(void **state)
{
    (void)state;
    struct err e = {0};
    struct scene s;
    uint32_t *images;
    size_t n;
    kit_ok(scene_read(scene_dir, &s, &e), e);
    kit_ok(train_scene_images(&s, SCENE_TRAIN, true, &images, &n, &e), e);
    struct camera_window windows[PHOTOS - 1];
    for (size_t i = 0; i < n; i++)
        windows[i] = (struct camera_window){0.05 * (double)i, 0.3, 0.5 + 0.05 * (double)i, 1.0};
    const struct photo_loader_config cfg = {.scene = &s,
                                            .images = images,
                                            .n_images = n,
                                            .windows = windows,
                                            .downsample = 1.0,
                                            .cache_bytes = 1 << 20,
                                            .level = 1};
    struct photo_loader *f = NULL;
    kit_ok(photo_loader_open(&cfg, &f, &e), e);
    for (size_t i = 0; i < n; i++) {
        const struct camera *full = &s.images[images[i]].cam;
        struct photo p;
        struct image want = {0};
        uint32_t at[4];
        char path[FILE_PATH_MAX + 64];
        camera_window_px(full, &windows[i], at);
        kit_ok(photo_loader_get_nth(f, i, &p, &e), e);
        assert_true(p.cam.width_px == at[2] && p.cam.height_px == at[3]);
        assert_true(at[2] < WIDTH && at[3] < HEIGHT);
        assert_true(fabs(p.cam.cx_px + at[0] - full->cx_px) < 1e-12);
        snprintf(path, sizeof path, "%s/images/%s", scene_dir, s.images[p.image].name);
        kit_ok(image_read(path, NULL, &want, &e), e);
        for (uint32_t y = 0; y < at[3]; y++)
            assert_memory_equal(want.px + 3 * ((at[1] + y) * WIDTH + at[0]),
                                p.px + 3 * (size_t)y * at[2], 3 * at[2]);
        image_free(&want);
    }
    photo_loader_close(&f);
    scene_free(&s);
}

/* ---- whole runs ---- */

static void assert_same_levels_to(unsigned finest, const char *a, const char *b)
{
    for (unsigned level = 1; level <= finest; level++) {
        struct ckpt x, y;
        toy_read_level(a, level, &x);
        toy_read_level(b, level, &y);
        assert_int_equal(x.g.n, y.g.n);
        assert_memory_equal(x.g.mean_m, y.g.mean_m, x.g.n * 12);
        assert_memory_equal(x.g.scale_log, y.g.scale_log, x.g.n * 12);
        assert_memory_equal(x.g.quat_wxyz, y.g.quat_wxyz, x.g.n * 16);
        assert_memory_equal(x.g.opacity_logit, y.g.opacity_logit, x.g.n * 4);
        assert_memory_equal(x.g.sh, y.g.sh, x.g.n * 12 * gauss_sh_count(x.g.sh_degree));
        ckpt_free(&x);
        ckpt_free(&y);
    }
}

static void assert_same_levels(const char *a, const char *b)
{
    assert_same_levels_to(3, a, b);
}

static void training_improves_keeps_budgets_and_repeats(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    char out[2][FILE_PATH_MAX];
    struct train_result r[2] = {0};
    for (int i = 0; i < 2; i++) {
        kit_tmpdir(out[i]);
        struct train_config c = toy_config(&a, out[i]);
        kit_ok(train_again(scene_dir, &c, &r[i], &e), e);
        assert_true(r[i].cells[0].n_gaussians[0] <= 80 && r[i].cells[0].n_gaussians[1] <= 100 &&
                    r[i].cells[0].n_gaussians[2] <= 150);
        assert_true(r[i].cells[0].n_gaussians[2] > r[i].cells[0].n_gaussians[0]);
        assert_true(r[i].cells[0].psnr_db[2] > TOY_PSNR_DB);
    }
    assert_same_levels(out[0], out[1]);
    struct ckpt c;
    toy_read_level(out[0], 2, &c);
    assert_true(c.g.antialiased);
    assert_int_equal(c.g.sh_degree, 1);
    assert_int_equal(json_integer_value(json_object_get(c.meta, "level")), 2);
    assert_true(json_number_value(json_object_get(json_object_get(c.meta, "test"), "psnr_db")) ==
                r[0].cells[0].psnr_db[1]);
    ckpt_free(&c);
    char path[FILE_PATH_MAX + 64];
    snprintf(path, sizeof path, "%s/cells/all/resume.ckpt", out[0]);
    assert_false(file_exists(path)); /* nothing is left to go on from */
    for (int i = 0; i < 2; i++) {
        kit_rmdir(out[i]);
        train_result_free(&r[i]);
    }
    arena_free(&a);
}

/* The number of "thin" lines of a run's metrics, and the smallest and the largest number of
 * Gaussians that its lines name. */
static size_t thinnings(const char *out, size_t *least, size_t *most)
{
    char path[FILE_PATH_MAX + 64], line[4096];
    size_t n = 0;
    snprintf(path, sizeof path, "%s/cells/all/metrics.jsonl", out);
    FILE *f = fopen(path, "r");
    assert_non_null(f);
    *least = SIZE_MAX;
    *most = 0;
    while (fgets(line, sizeof line, f)) {
        json_t *o = json_loads(line, 0, NULL);
        const char *event = json_string_value(json_object_get(o, "event"));
        if (event && strcmp(event, "thin") == 0) {
            size_t before = (size_t)json_integer_value(json_object_get(o, "before"));
            size_t left = before - (size_t)json_integer_value(json_object_get(o, "removed"));
            *most = before > *most ? before : *most;
            *least = left < *least ? left : *least;
            n++;
        }
        json_decref(o);
    }
    (void)fclose(f);
    return n;
}

/* From nothing to all that can go: a run ends, and never has more than its budget. More dB leave
 * fewer, at most a third goes at a time, and no Gaussian is added afterwards. */
static void thinning_leaves_what_the_option_says(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    static const double db[] = {0.0, 0.02, 0.05, 100.0};
    enum { RUNS = sizeof db / sizeof db[0], BUDGET = 150 };
    size_t left[RUNS];
    for (size_t i = 0; i < RUNS; i++) {
        struct train_result r = {0};
        char out[FILE_PATH_MAX];
        size_t least, most;
        kit_tmpdir(out);
        struct train_config c = toy_config(&a, out);
        c.thin_db = db[i];
        c.prune_contribution = 0.0;
        c.prune_support = 0;
        kit_ok(train_again(scene_dir, &c, &r, &e), e);
        assert_int_equal(thinnings(out, &least, &most), db[i] > 0.0 ? 3 : 0);
        left[i] = r.cells[0].n_gaussians[2];
        if (db[i] > 0.0)
            assert_true(most <= BUDGET && left[i] == least);
        assert_true(left[i] <= BUDGET && (i == 0 || left[i] < left[i - 1]));
        kit_rmdir(out);
        train_result_free(&r);
    }
    printf("thinned: %zu, %zu, %zu and %zu Gaussians\n", left[0], left[1], left[2], left[3]);
    assert_int_equal(left[RUNS - 1], 45); /* of 150: 100, 67, 45 */
    arena_free(&a);
}

/* A run that is stopped after each of these numbers of steps and resumed, but not to its end. */
static void train_in_pieces(struct train_config *c, const int64_t *pieces, size_t n)
{
    struct err e = {0};
    struct train_result r = {0};
    for (size_t i = 0; i < n; i++) {
        c->stop_after = pieces[i];
        c->resume = i > 0;
        c->overwrite = i == 0;
        kit_fails(train_again(scene_dir, c, &r, &e), ERR_CANCEL, e, "--resume goes on");
    }
    c->stop_after = 0;
    c->resume = true;
    train_result_free(&r);
}

static void stopped_run_goes_on(enum schedule_order order, const int64_t *pieces, size_t n_pieces)
{
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char whole[FILE_PATH_MAX], parts[FILE_PATH_MAX];
    kit_tmpdir(whole);
    kit_tmpdir(parts);
    struct train_config c = toy_config(&a, whole);
    c.level_order = order;
    c.defer_from = 1;
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    c.output = parts;
    train_in_pieces(&c, pieces, n_pieces);
    c.resume = false; /* it is not thrown away unasked */
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_ARG, e, "an unfinished run is there");
    c.resume = true;
    c.seed++;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_ARG, e, "seed");
    c.seed--;
    c.cache_mib = 1; /* may change: it cannot matter */
    double now = clock_s();
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    now = clock_s() - now;
    assert_same_levels(whole, parts);
    for (unsigned i = 0; i < 3; i++) { /* also of levels that other processes finished */
        struct ckpt level;
        toy_read_level(parts, i + 1, &level);
        assert_int_equal(r.cells[0].n_gaussians[i], level.g.n);
        assert_true(r.cells[0].psnr_db[i] == json_number_value(json_object_get(
                                                 json_object_get(level.meta, "test"), "psnr_db")));
        assert_true(r.cells[0].ssim[i] > 0.0);
        ckpt_free(&level);
    }
    assert_true(r.cells[0].seconds > now); /* and the time that they took */
    kit_rmdir(whole);
    kit_rmdir(parts);
    train_result_free(&r);
    arena_free(&a);
}

static void a_stopped_run_goes_on_as_if_it_had_not_been(void **state)
{
    (void)state;
    /* pieces of 1, 7, 30, ... steps: in the middle of levels, at their ends, around densifications
     * and between thinnings */
    static const int64_t up[] = {1, 7, 67, 2, 73, 40, 40, 8};
    stopped_run_goes_on(SCHEDULE_COARSE_TO_FINE, up, sizeof up / sizeof up[0]);
    /* 45, 45 and 150 steps, then 30 and 30 */
    static const int64_t both[] = {1, 44, 20, 100, 60, 30, 30, 8};
    stopped_run_goes_on(SCHEDULE_BOTH, both, sizeof both / sizeof both[0]);
}

/* PSNR of the training photographs at the last step of a level, by the run's metrics. */
static double last_psnr(const char *out, unsigned level)
{
    char path[FILE_PATH_MAX], line[4096];
    struct err e = {0};
    double db = (double)NAN;
    kit_ok(file_join(path, out, "cells/all/metrics.jsonl", &e), e);
    FILE *f = fopen(path, "re");
    assert_non_null(f);
    while (fgets(line, sizeof line, f)) {
        json_t *o = json_loads(line, 0, NULL);
        if (json_is_number(json_object_get(o, "psnr_mean_db")) &&
            json_integer_value(json_object_get(o, "level")) == (json_int_t)level)
            db = json_number_value(json_object_get(o, "psnr_mean_db"));
        json_decref(o);
    }
    fclose(f);
    return db;
}

/* Levels that are made of the finer one: few enough, better on their own pictures than merging
 * alone, and the same in every run. */
static void coarser_levels_are_made_of_the_finest(void **state)
{
    (void)state;
    enum { MERGED, TUNED, AGAIN, RUNS };
    struct err e = {0};
    struct arena a = {0};
    struct train_result r[RUNS] = {{0}};
    struct ckpt level[2];
    char out[RUNS][FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    for (int i = 0; i < RUNS; i++) {
        kit_tmpdir(out[i]);
        struct train_config c = toy_config(&a, out[i]);
        c.level_order = SCHEDULE_BOTH;
        c.solid_spread = c.solid_light = c.solid_flat = 0.0; /* 30 Gaussians close no ground */
        /* 100, 100 and 400 steps, then 100 and 100; or 200, 200 and 400, then 1 and 1 */
        c.tune_share = i == MERGED ? 0.001 : 1.0;
        c.iterations.one = 800;
        c.budget.v[0] = 30;
        c.budget.v[1] = 60;
        kit_ok(train_again(scene_dir, &c, &r[i], &e), e);
        const struct train_cell_result *cell = &r[i].cells[0];
        assert_true(cell->n_gaussians[0] <= 30 && cell->n_gaussians[1] <= 60);
        assert_true(cell->n_gaussians[0] < cell->n_gaussians[1] &&
                    cell->n_gaussians[1] < cell->n_gaussians[2]);
        snprintf(path, sizeof path, "%s/cells/all/finest.ckpt", out[i]);
        assert_false(file_exists(path));
    }
    for (unsigned k = 0; k < 2; k++) {
        double merged = last_psnr(out[MERGED], k + 1), tuned = last_psnr(out[TUNED], k + 1);
        printf("level %u: merged %.2f dB, fine-tuned %.2f dB\n", k + 1, merged, tuned);
        assert_true(tuned > merged + 1.0);
    }
    assert_same_levels(out[TUNED], out[AGAIN]);
    for (unsigned k = 0; k < 2; k++) {
        toy_read_level(out[TUNED], k + 1, &level[k]);
        assert_int_equal(json_integer_value(json_object_get(level[k].meta, "level")), k + 1);
        assert_int_equal(json_integer_value(json_object_get(level[k].meta, "step")), 100);
    }
    assert_true(json_number_value(json_object_get(level[0].meta, "downsample")) == 2.0);
    /* Pixels of the coarser level are twice as large on the ground. */
    const double pixel_m = json_number_value(json_object_get(level[1].meta, "pixel_m"));
    assert_true(pixel_m > 0.0);
    const double coarser_m = json_number_value(json_object_get(level[0].meta, "pixel_m"));
    assert_true(fabs(coarser_m - 2.0 * pixel_m) < 1e-9 * pixel_m);
    for (int k = 0; k < 2; k++)
        ckpt_free(&level[k]);
    for (int i = 0; i < RUNS; i++) {
        kit_rmdir(out[i]);
        train_result_free(&r[i]);
    }
    arena_free(&a);
}

/* Levels at whose end Gaussians that contribute nothing were removed, as bits. */
static unsigned pruned_levels(const char *out)
{
    char path[FILE_PATH_MAX], line[4096];
    struct err e = {0};
    unsigned levels = 0;
    kit_ok(file_join(path, out, "cells/all/metrics.jsonl", &e), e);
    FILE *f = fopen(path, "re");
    assert_non_null(f);
    while (fgets(line, sizeof line, f)) {
        json_t *o = json_loads(line, 0, NULL);
        const char *event = json_string_value(json_object_get(o, "event"));
        if (event && !strcmp(event, "prune") &&
            json_integer_value(json_object_get(o, "removed")) > 0)
            levels |= 1u << (json_integer_value(json_object_get(o, "level")) - 1);
        json_decref(o);
    }
    fclose(f);
    return levels;
}

/* A level that is made of the finest one keeps what little its own photographs show of it: they are
 * coarse, and it would leave gaps in other views. */
static void levels_that_are_trained_once_are_pruned(void **state)
{
    (void)state;
    static const struct {
        enum schedule_order order;
        unsigned pruned;
    } runs[] = {{SCHEDULE_COARSE_TO_FINE, 7}, {SCHEDULE_BOTH, 4}};
    for (size_t i = 0; i < sizeof runs / sizeof *runs; i++) {
        struct err e = {0};
        struct arena a = {0};
        struct train_result r = {0};
        char out[FILE_PATH_MAX];
        kit_tmpdir(out);
        struct train_config c = toy_config(&a, out);
        c.level_order = runs[i].order;
        c.prune_contribution = 0.1;
        c.prune_loss_db = 100.0;
        kit_ok(train_again(scene_dir, &c, &r, &e), e);
        assert_int_equal(pruned_levels(out), runs[i].pruned);
        train_result_free(&r);
        kit_rmdir(out);
        arena_free(&a);
    }
}

/* They take over its network, which does not change any more. */
static void coarser_levels_have_the_finest_network(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    struct ckpt level[3];
    char whole[FILE_PATH_MAX], parts[FILE_PATH_MAX];
    kit_tmpdir(whole);
    kit_tmpdir(parts);
    struct train_config c = toy_config(&a, whole);
    c.level_order = SCHEDULE_BOTH;
    c.appearance = true;
    c.iterations.one = 100;
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    c.output = parts;
    static const int64_t pieces[] = {30, 41, 2, 20}; /* 15, 15 and 50 steps, then 10 and 10 */
    train_in_pieces(&c, pieces, sizeof pieces / sizeof pieces[0]);
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_same_levels(whole, parts);
    const struct ckpt_blob *network[3];
    for (unsigned k = 0; k < 3; k++) {
        toy_read_level(parts, k + 1, &level[k]);
        network[k] = ckpt_find(&level[k], "appearance");
        assert_non_null(network[k]);
        assert_int_equal(network[k]->size_bytes, network[0]->size_bytes);
        assert_memory_equal(network[k]->data, network[0]->data, network[0]->size_bytes);
        assert_true(level[k].g.embed_len > 0);
    }
    for (unsigned k = 0; k < 3; k++)
        ckpt_free(&level[k]);
    kit_rmdir(whole);
    kit_rmdir(parts);
    train_result_free(&r);
    arena_free(&a);
}

/* The number of steps that a finished level of a run says it has made. */
static int steps_of(const char *out, unsigned level)
{
    struct ckpt c;
    toy_read_level(out, level, &c);
    int steps = (int)json_integer_value(json_object_get(c.meta, "steps"));
    ckpt_free(&c);
    return steps;
}

/* It ends by itself, and in the same bytes when it was stopped on the way. */
static void a_run_goes_on_while_that_gains(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char whole[FILE_PATH_MAX], parts[FILE_PATH_MAX];
    kit_tmpdir(whole);
    kit_tmpdir(parts);
    struct train_config c = toy_config(&a, parts);
    c.level_count = 1;
    c.budget.one = 80;
    c.budget.n = 1;
    c.defer_from = 1;
    c.iterations.one = 40;
    c.go_on_db = 99; /* more than tenths can gain: the rates fall after the third look */
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_int_equal(steps_of(parts, 1), 61); /* 40, 44, 49, 49 / (1 - 0.2) */
    c.overwrite = true;
    c.lr_end = 1; /* rates that do not fall: nothing follows the look */
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_int_equal(steps_of(parts, 1), 49);
    c.lr_end = 0.1;
    c.output = whole;
    c.go_on_db = 0.05;
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_true(steps_of(whole, 1) > 61 && steps_of(whole, 1) <= 30000);
    c.output = parts; /* in the steps planned, at looks, between them, and while rates fall */
    const int64_t pieces[] = {20, 20, 2, 2, 3, steps_of(whole, 1) - 47 - 4};
    train_in_pieces(&c, pieces, sizeof pieces / sizeof pieces[0]);
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_int_equal(steps_of(parts, 1), steps_of(whole, 1));
    assert_same_levels_to(1, whole, parts);
    c.iterations = (struct options_ints){.v = {20, 20, 40}}; /* a list */
    c.overwrite = true;
    c.resume = false;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_ARG, e, "--go-on-db needs one value");
    kit_rmdir(whole);
    kit_rmdir(parts);
    train_result_free(&r);
    arena_free(&a);
}

/* The text of a hash of the run's inputs, as a level's file has it. */
static void level_input(const char *out, const char *key, char hash[64])
{
    struct ckpt c;
    toy_read_level(out, 3, &c);
    const json_t *inputs = json_object_get(c.meta, "inputs");
    snprintf(hash, 64, "%s", json_string_value(json_object_get(inputs, key)));
    ckpt_free(&c);
}

/* With --level-order both, levels' files say nothing of the steps before they were made again. */
static int64_t steps_before_again(const struct train_config *c)
{
    struct err e = {0};
    const struct cell cell = {.edge_m = 100, .extent_m = 100, .whole = true};
    struct schedule s[TRAIN_LEVELS_MAX];
    kit_ok(schedule_make(c, PHOTOS, &cell, s, &e), e);
    return c->level_order == SCHEDULE_BOTH ? (int64_t)s[0].steps + s[1].steps : 0;
}

static void last_fit(enum schedule_order order, int64_t go_on_from)
{
    enum { PLAIN, WHOLE, PARTS, OUTS };
    struct err e = {0};
    struct arena a = {0};
    struct train_result r[2] = {0};
    struct ckpt level[2];
    char out[OUTS][FILE_PATH_MAX], hash[2][64];
    int64_t steps = 0;
    for (int i = 0; i < OUTS; i++)
        kit_tmpdir(out[i]);
    struct train_config c = toy_config(&a, out[PLAIN]);
    c.level_order = order;
    c.go_on_db = go_on_from ? 99 : 0;
    c.iterations.one = go_on_from ? go_on_from : c.iterations.one;
    kit_ok(train_again(scene_dir, &c, &r[PLAIN], &e), e);
    c.final_all = true;
    c.output = out[WHOLE];
    kit_ok(train_again(scene_dir, &c, &r[WHOLE], &e), e);
    for (unsigned i = 0; i < 3; i++) {
        assert_true(r[PLAIN].cells[0].psnr_db[i] == r[WHOLE].cells[0].psnr_db[i]);
        toy_read_level(out[PLAIN], i + 1, &level[0]);
        toy_read_level(out[WHOLE], i + 1, &level[1]);
        assert_int_equal(level[0].g.n, level[1].g.n);
        bool same = !memcmp(level[0].g.mean_m, level[1].g.mean_m, level[0].g.n * 12);
        steps += json_integer_value(json_object_get(level[0].meta, "steps"));
        assert_true(same == (i < 2));
        assert_true(json_equal(json_object_get(level[0].meta, "test"),
                               json_object_get(level[1].meta, "test")));
        assert_true(json_equal(json_object_get(level[0].meta, "steps"),
                               json_object_get(level[1].meta, "steps")));
        ckpt_free(&level[0]);
        ckpt_free(&level[1]);
    }
    steps += steps_before_again(&c);
    level_input(out[PLAIN], "photographs", hash[0]); /* the test photograph counts now */
    level_input(out[WHOLE], "photographs", hash[1]);
    assert_string_not_equal(hash[0], hash[1]);
    kit_ok(train_again(scene_dir, &c, &r[WHOLE], &e), e);
    assert_true(r[WHOLE].cells[0].was_done);

    c.output = out[PARTS];
    c.stop_after = steps + 2;
    kit_fails(train_again(scene_dir, &c, &r[WHOLE], &e), ERR_CANCEL, e,
              "trains with all photographs");
    c.stop_after = 0;
    c.resume = true;
    kit_ok(train_again(scene_dir, &c, &r[WHOLE], &e), e);
    assert_same_levels(out[WHOLE], out[PARTS]);
    for (unsigned i = 0; i < 3; i++) {
        toy_read_level(out[PARTS], i + 1, &level[0]);
        assert_true(r[WHOLE].cells[0].psnr_db[i] == r[PLAIN].cells[0].psnr_db[i] &&
                    r[WHOLE].cells[0].n_gaussians[i] == level[0].g.n);
        ckpt_free(&level[0]);
    }
    for (int i = 0; i < OUTS; i++)
        kit_rmdir(out[i]);
    train_result_free(&r[0]);
    train_result_free(&r[1]);
    arena_free(&a);
}

/* Scores and coarser levels are those of a run without it. It can be stopped and repeats. */
static void a_last_fit_takes_all_photographs(void **state)
{
    (void)state;
    last_fit(SCHEDULE_COARSE_TO_FINE, 0);
    last_fit(SCHEDULE_BOTH, 0);
    last_fit(SCHEDULE_BOTH, 150); /* after a level that went on */
}

static void a_damaged_state_is_refused(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char out[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    struct buf file = {0};
    kit_tmpdir(out);
    struct train_config c = toy_config(&a, out);
    c.stop_after = 3;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_CANCEL, e, "step 3");
    snprintf(path, sizeof path, "%s/cells/all/resume.ckpt", out);
    kit_ok(file_read(path, 0, &file, &e), e);
    c.resume = true;
    kit_ok(file_write(path, file.data, file.size - 5, &e), e);
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_FORMAT, e, "truncated");
    file.data[file.size - 1] ^= 1;
    kit_ok(file_write(path, file.data, file.size, &e), e);
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_FORMAT, e, "stat_radius");
    buf_free(&file);
    kit_rmdir(out);
    train_result_free(&r);
    arena_free(&a);
}

/* States of before have two arrays of floats where there is one of words now. */
static void a_state_with_wide_moments_is_refused(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    struct ckpt s;
    size_t found = 0;
    char out[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    kit_tmpdir(out);
    struct train_config c = toy_config(&a, out);
    c.stop_after = 3;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_CANCEL, e, "step 3");
    snprintf(path, sizeof path, "%s/cells/all/resume.ckpt", out);
    kit_ok(ckpt_read(path, &s, &e), e);
    for (size_t i = 0; i < s.n_blobs; i++)
        if (!strcmp(s.blobs[i].name, "adam")) {
            memcpy(s.blobs[i].name, "adam_m1", sizeof "adam_m1");
            found++;
        }
    assert_int_equal(found, 1);
    kit_ok(ckpt_write(path, s.meta, &s.g, s.blobs, s.n_blobs, &e), e);
    ckpt_free(&s);
    c.resume = true;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_FORMAT, e, "begin anew with --overwrite");
    c.resume = false;
    c.overwrite = true;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_CANCEL, e, "step 3");
    kit_rmdir(out);
    train_result_free(&r);
    arena_free(&a);
}

/* One byte more at the end of a file, which no decoder reads. */
static void lengthen(const char *dir, const char *name)
{
    struct err e = {0};
    struct buf b = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(file_read(path, 0, &b, &e), e);
    buf_u8(&b, 0);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

/* The second pose moves by a centimetre. */
static void move_a_camera(const char *dir)
{
    struct err e = {0};
    struct scene s;
    kit_ok(scene_read(dir, &s, &e), e);
    s.images[1].cam.trans[2] += 0.01;
    kit_ok(scene_write(dir, &s, &e), e);
    scene_free(&s);
}

static void write_mask(const char *dir, uint8_t value)
{
    struct err e = {0};
    struct image mask = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, "masks", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, dir, "masks/p1.png.png", &e), e);
    kit_ok(image_alloc(WIDTH, HEIGHT, 1, &mask, &e), e);
    memset(mask.px, 255, WIDTH * HEIGHT);
    memset(mask.px, value, WIDTH);
    kit_ok(image_write(path, &mask, 0, NULL, &e), e);
    image_free(&mask);
}

static void write_depths(const char *dir)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, "depth", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, dir, "depth/depths.json", &e), e);
    kit_ok(file_write(path, "{}", 2, &e), e);
}

static void remove_depths(const char *dir)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, "depth/depths.json", &e), e);
    assert_int_equal(unlink(path), 0);
}

/* A finished run, and one to go on with, of other photographs, masks, poses or depths are neither
 * "complete" nor gone on with. */
static void what_a_run_was_made_of_may_not_change(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char dir[FILE_PATH_MAX], half[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_tmpdir(half);
    blobs_write(dir, true);
    write_mask(dir, 255);
    struct train_config whole = toy_config(&a, NULL), part = toy_config(&a, half);
    whole.depth_prior = part.depth_prior = "auto";
    whole.iterations.one = 30;
    part.stop_after = 3;
    kit_ok(train_again(dir, &whole, &r, &e), e);
    kit_fails(train_again(dir, &part, &r, &e), ERR_CANCEL, e, "--resume goes on");
    part.resume = true;
    kit_ok(train_again(dir, &whole, &r, &e), e);
    assert_true(r.cells[0].was_done);
    kit_fails(train_again(dir, &part, &r, &e), ERR_CANCEL, e, "--resume goes on");
    for (int i = 0; i < 4; i++) {
        static const char *const said[] = {"photographs, or which of them train, have changed",
                                           "masks have changed", "poses, exposures or sparse",
                                           "had no known depths, now there are some"};
        if (i == 0)
            lengthen(dir, "images/p4.png");
        else if (i == 1)
            write_mask(dir, 0);
        else if (i == 2)
            move_a_camera(dir);
        else
            write_depths(dir);
        kit_fails(train_again(dir, &whole, &r, &e), ERR_ARG, e, said[i]);
        kit_expect_text(e.msg, "--overwrite", __FILE__, __LINE__);
        kit_fails(train_again(dir, &part, &r, &e), ERR_DATA, e, said[i]);
        kit_expect_text(e.msg, "--overwrite", __FILE__, __LINE__);
        if (i == 3) /* maps that say nothing: it would not train with them */
            continue;
        whole.overwrite = part.overwrite = true;
        part.resume = false;
        kit_ok(train_again(dir, &whole, &r, &e), e);
        assert_false(r.cells[0].was_done);
        kit_fails(train_again(dir, &part, &r, &e), ERR_CANCEL, e, "--resume goes on");
        whole.overwrite = part.overwrite = false;
        part.resume = true;
    }
    remove_depths(dir);
    kit_ok(train_again(dir, &whole, &r, &e), e);
    assert_true(r.cells[0].was_done);
    struct inputs none = {0}, some = {0};
    snprintf(some.hash[INPUTS_DEPTHS], sizeof some.hash[INPUTS_DEPTHS], "a hash");
    json_t *meta = json_pack("{s:o}", "inputs", inputs_to_json(&some));
    assert_int_equal(inputs_check(&some, "a.ckpt", meta, &e), ERR_OK);
    kit_fails(inputs_check(&none, "a.ckpt", meta, &e), ERR_DATA, e, "had known depths, now");
    json_decref(meta);
    kit_rmdir(dir);
    kit_rmdir(half);
    train_result_free(&r);
    arena_free(&a);
}

/* The trace of a level's first steps: any change of a formula on the way from photograph to
 * parameter shows. */
static void twenty_steps_give_the_golden_trace(void **state)
{
    (void)state;
    static const double golden[20] = {0.250743, 0.263665, 0.238544, 0.235704, 0.229938,
                                      0.225960, 0.230517, 0.223437, 0.222595, 0.216115,
                                      0.219659, 0.227272, 0.205244, 0.207920, 0.206061,
                                      0.203116, 0.201210, 0.204415, 0.203900, 0.191031};
    struct err e = {0};
    struct arena a = {0};
    struct scene s;
    uint32_t *images;
    size_t n;
    double got[20];
    struct gauss g = {0};
    struct train_config c = toy_config(&a, NULL);
    c.level_count = 1;
    c.iterations.one = 200;
    c.lr_short = 1;           /* the published rates */
    c.densify_from = 1000000; /* choices of who is split may tip over by rounding; steps may not */
    kit_ok(scene_read(scene_dir, &s, &e), e);
    kit_ok(train_scene_images(&s, SCENE_TRAIN, true, &images, &n, &e), e);
    struct level l;
    struct run_cell job = {.cfg = &c, .scene = &s, .dev = &dev};
    cell_whole(&s, images, n, &job.cell);
    kit_ok(render_open(&dev, &job.render, &e), e);
    kit_ok(photometric_open(&dev, &job.loss, &e), e);
    level_init(&l, &job, images, n);
    kit_ok(schedule_make(&c, n, &job.cell, l.stage.levels, &e), e);
    const struct init_input first = {.scene = &s,
                                     .images = images,
                                     .n_images = n,
                                     .cell = &job.cell,
                                     .sh_degree = 1,
                                     .limit = 1000,
                                     .seed = 1};
    kit_ok(init_gauss(&first, &g, &e), e);
    kit_ok(level_open(&l, &g, &e), e);
    kit_ok(level_begin(&l, &e), e);
    for (int i = 0; i < 20; i++) {
        struct photometric_value v;
        kit_ok(level_step(&l, &v, &e), e);
        got[i] = v.total;
    }
    kit_near_d("loss of the first 20 steps", got, golden, 20, 0.0, GOLDEN_REL);
    assert_true(got[19] < got[0]);
    level_close(&l);
    photometric_close(&job.loss);
    render_close(&job.render);
    gauss_free(&g);
    scene_free(&s);
    arena_free(&a);
}

static void a_scene_without_points_starts_from_random_ones(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char bare[FILE_PATH_MAX];
    kit_tmpdir(bare);
    blobs_write(bare, false);
    struct train_config c = toy_config(&a, NULL); /* results go into the scene folder */
    c.iterations.one = 12;
    c.budget.v[0] = 200;
    c.budget.v[1] = 200;
    c.budget.v[2] = 200;
    kit_ok(train_again(bare, &c, &r, &e), e);
    assert_true(r.cells[0].n_gaussians[2] >= 90);
    kit_rmdir(bare);
    train_result_free(&r);
    arena_free(&a);
}

/* SSIM over whole windows does not exist where a picture is smaller than the window: the level is
 * scored and written down without it. */
static void pictures_smaller_than_the_window_are_scored_without_it(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char out[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    struct buf lines = {0};
    kit_tmpdir(out);
    struct train_config c = toy_config(&a, out);
    c.iterations.one = 12;
    c.downsample.v[0] = 5.0; /* 13 x 10 px */
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_true(isfinite(r.cells[0].psnr_db[0]) && isfinite(r.cells[0].ssim[0]));
    snprintf(path, sizeof path, "%s/cells/all/metrics.jsonl", out);
    kit_ok(file_read(path, 0, &lines, &e), e);
    buf_u8(&lines, 0);
    assert_non_null(strstr((const char *)lines.data, "\"ssim_valid\":null"));
    buf_free(&lines);
    kit_rmdir(out);
    train_result_free(&r);
    arena_free(&a);
}

static void broken_scenes_are_one_clear_error(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char broken[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    kit_tmpdir(broken);
    struct train_config c = toy_config(&a, NULL);
    kit_fails(train_again(broken, &c, &r, &e), ERR_NOENT, e, "scene.json");
    blobs_write(broken, true);
    snprintf(path, sizeof path, "%s/images/p4.png", broken);
    assert_int_equal(unlink(path), 0);
    kit_fails(train_again(broken, &c, &r, &e), ERR_NOENT, e, "p4.png");
    kit_ok(file_write(path, "GIF89a", 6, &e), e);
    kit_fails(train_again(broken, &c, &r, &e), ERR_FORMAT, e, "p4.png");
    struct image small = {0};
    kit_ok(image_alloc(7, 5, 3, &small, &e), e);
    kit_ok(image_write(path, &small, 0, NULL, &e), e);
    image_free(&small);
    kit_fails(train_again(broken, &c, &r, &e), ERR_DATA, e, "7 x 5");
    kit_rmdir(broken);
    train_result_free(&r);
    arena_free(&a);
}

/* Two cells side by side from a plan: each is trained from its own photographs, the second one
 * alone gives the same bytes, and a finished cell is not trained again by --resume. */
static void cells_of_a_plan_are_trained_on_their_own(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char dir[FILE_PATH_MAX], one[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    struct scene s;
    struct partition plan = {0};
    struct partition_config pc = partition_defaults();
    struct ckpt x, y;
    kit_tmpdir(dir);
    kit_tmpdir(one);
    blobs_write(dir, true);
    kit_ok(scene_read(dir, &s, &e), e);
    pc.edge_m = 8.0;
    pc.images_few = pc.images_least = 2;
    pc.use_visibility = false;
    kit_ok(partition_make(&s, &pc, &plan, &e), e);
    kit_ok(share_photographs(&s, 0.02, &plan, &e), e);
    assert_true(plan.share_min > 0.0); /* photographs are cut */
    size_t trained = 0;
    for (size_t i = 0; i < plan.n_cells; i++)
        trained += plan.cells[i].parent < 0;
    assert_true(trained >= 2);
    snprintf(path, sizeof path, "%s/plan.json", dir);
    kit_ok(cell_plan_write(path, &s, &plan, &e), e);
    struct train_config c = toy_config(&a, NULL);
    c.iterations.one = 60;
    c.coarse_start = false;
    kit_ok(train_again(dir, &c, &r, &e), e);
    assert_int_equal(r.n_cells, trained);
    char last[32];
    snprintf(last, sizeof last, "%s", r.cells[trained - 1].id);
    c.cell = last;
    c.output = one;
    kit_ok(train_again(dir, &c, &r, &e), e);
    assert_int_equal(r.n_cells, 1);
    snprintf(path, sizeof path, "%s/cells/%s/level3.ckpt", dir, last);
    kit_ok(ckpt_read(path, &x, &e), e);
    snprintf(path, sizeof path, "%s/cells/%s/level3.ckpt", one, last);
    kit_ok(ckpt_read(path, &y, &e), e);
    assert_int_equal(x.g.n, y.g.n);
    assert_memory_equal(x.g.mean_m, y.g.mean_m, x.g.n * 12);
    assert_string_equal(json_string_value(json_object_get(y.meta, "cell")), last);
    c.resume = true;
    kit_ok(train_again(dir, &c, &r, &e), e);
    assert_true(r.cells[0].was_done);
    c.output = NULL;
    ckpt_free(&x);
    ckpt_free(&y);
    c.cell = "nowhere";
    kit_fails(train_again(dir, &c, &r, &e), ERR_ARG, e, "'nowhere'");
    c.cell = NULL;
    kit_ok(train_again(dir, &c, &r, &e), e);
    for (size_t i = 0; i < r.n_cells; i++)
        assert_true(r.cells[i].was_done);
    /* Another plan, whose cells have the same names but not the same ground: nothing of it is done.
     */
    for (size_t i = 0; i < plan.n_cells; i++)
        for (int k = 0; k < 2; k++) {
            plan.cells[i].min_m[k] += 0.25;
            plan.cells[i].max_m[k] += 0.25;
        }
    snprintf(path, sizeof path, "%s/plan.json", dir);
    kit_ok(cell_plan_write(path, &s, &plan, &e), e);
    c.stop_after = 5;
    kit_fails(train_again(dir, &c, &r, &e), ERR_ARG, e, "--overwrite");
    c.overwrite = true;
    kit_fails(train_again(dir, &c, &r, &e), ERR_CANCEL, e, "step 5");
    for (size_t i = 0; i < plan.n_cells; i++)
        plan.cells[i].max_m[0] += 0.25;
    kit_ok(cell_plan_write(path, &s, &plan, &e), e);
    kit_fails(train_again(dir, &c, &r, &e), ERR_DATA, e, "plan");
    partition_free(&plan);
    scene_free(&s);
    train_result_free(&r);
    kit_rmdir(dir);
    kit_rmdir(one);
    arena_free(&a);
}

/* Results are replaced only when that was asked for. */
static void a_finished_run_is_not_lost(void **state)
{
    (void)state;
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char out[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    struct buf first = {0}, again = {0};
    kit_tmpdir(out);
    struct train_config c = toy_config(&a, out);
    c.iterations.one = 12;
    c.prune_contribution = 0.0; /* photographs are ranked all the same */
    c.prune_support = 0;
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_false(r.cells[0].was_done);
    snprintf(path, sizeof path, "%s/cells/all/residuals.json", out);
    assert_true(file_exists(path));
    snprintf(path, sizeof path, "%s/cells/all/level3.ckpt", out);
    kit_ok(file_read(path, 0, &first, &e), e);
    kit_ok(train_again(scene_dir, &c, &r, &e), e); /* the same options: nothing to do */
    assert_true(r.cells[0].was_done);
    c.iterations.one = 15;
    for (int resume = 0; resume < 2; resume++) {
        c.resume = resume;
        kit_fails(train_again(scene_dir, &c, &r, &e), ERR_ARG, e, "iterations = 12, now it is 15");
        assert_non_null(strstr(e.msg, "--overwrite"));
    }
    kit_ok(file_read(path, 0, &again, &e), e);
    assert_int_equal(first.size, again.size);
    assert_memory_equal(first.data, again.data, first.size);
    c.resume = false;
    c.level_count = 2; /* and where the finest level has another number */
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_ARG, e, "--overwrite");
    c.level_count = 3;
    c.overwrite = true;
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_false(r.cells[0].was_done);
    c.overwrite = false;
    kit_ok(train_again(scene_dir, &c, &r, &e), e);
    assert_true(r.cells[0].was_done);
    c.overwrite = true; /* nothing is left that tells of the run before */
    c.stop_after = 2;
    kit_fails(train_again(scene_dir, &c, &r, &e), ERR_CANCEL, e, "stopped");
    snprintf(path, sizeof path, "%s/cells/all/residuals.json", out);
    assert_false(file_exists(path));
    buf_free(&first);
    buf_free(&again);
    kit_rmdir(out);
    train_result_free(&r);
    arena_free(&a);
}

/* What is left of the run counts all levels, each by its pixels and Gaussians. */
static int open_device(void **state)
{
    (void)state;
    struct err e = {0};
    progress_quiet(true);
    log_set_level(LOG_ERROR);
    kit_ok(dev_open(NULL, &dev, &e), e);
    kit_tmpdir(scene_dir);
    blobs_write(scene_dir, true);
    return 0;
}

static int close_device(void **state)
{
    (void)state;
    kit_rmdir(scene_dir);
    dev_close(&dev);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cameras_at_training_size_keep_the_view),
        cmocka_unit_test(the_feed_shows_every_photograph_once_an_epoch_within_its_cache),
        cmocka_unit_test(the_feed_cuts_photographs_to_their_windows),
        cmocka_unit_test(twenty_steps_give_the_golden_trace),
        cmocka_unit_test(training_improves_keeps_budgets_and_repeats),
        cmocka_unit_test(thinning_leaves_what_the_option_says),
        cmocka_unit_test(a_stopped_run_goes_on_as_if_it_had_not_been),
        cmocka_unit_test(coarser_levels_are_made_of_the_finest),
        cmocka_unit_test(levels_that_are_trained_once_are_pruned),
        cmocka_unit_test(coarser_levels_have_the_finest_network),
        cmocka_unit_test(a_run_goes_on_while_that_gains),
        cmocka_unit_test(a_last_fit_takes_all_photographs),
        cmocka_unit_test(a_damaged_state_is_refused),
        cmocka_unit_test(a_state_with_wide_moments_is_refused),
        cmocka_unit_test(what_a_run_was_made_of_may_not_change),
        cmocka_unit_test(a_scene_without_points_starts_from_random_ones),
        cmocka_unit_test(cells_of_a_plan_are_trained_on_their_own),
        cmocka_unit_test(pictures_smaller_than_the_window_are_scored_without_it),
        cmocka_unit_test(broken_scenes_are_one_clear_error),
        cmocka_unit_test(a_finished_run_is_not_lost),
    };
    return cmocka_run_group_tests_name("train", tests, open_device, close_device);
}
