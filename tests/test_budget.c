/* Budgets that follow the photographs: the numbers of a case worked out by hand, the decision of
 * --budget-rule auto, which photographs are held out, and the presets' tables.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cells/cell.h"
#include "codec/image.h"
#include "codec/mask.h"
#include "codec/scene.h"
#include "core/options.h"
#include "render/render.h"
#include "tests/kit.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/densify_apply.h"
#include "train/gallery.h"
#include "train/importance.h"
#include "train/model.h"
#include "train/schedule.h"
#include "train/stage.h"
#include "train/timing.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { PHOTOS = 40 };

static void scene_make(struct scene *s, struct scene_image images[PHOTOS])
{
    *s = (struct scene){.images = images, .n_images = PHOTOS};
    for (size_t i = 0; i < PHOTOS; i++)
        images[i] = (struct scene_image){
            .cam = {.width_px = 400, .height_px = 225, .fx_px = 300.0, .fy_px = 300.0}};
}

static void defaults(struct train_config *c, struct arena *a)
{
    struct err e = {0};
    kit_ok(options_defaults(train_options(), c, a, &e), e);
}

static size_t fit(const struct scene *s, const uint32_t *list, size_t n, size_t n_points,
                  const struct train_config *c, size_t table)
{
    return budget_fit(&(struct budget_photos){s, list, NULL, n, n_points}, c, 1.0, table);
}

static void limit(const struct scene *s, const uint32_t *list, size_t n_points,
                  const struct train_config *c, struct schedule levels[TRAIN_LEVELS_MAX])
{
    budget_limit(&(struct budget_photos){s, list, NULL, PHOTOS, n_points}, c, levels);
}

static void what_fits_is_worked_out_by_hand(void **state)
{
    (void)state;
    struct arena a = {0};
    struct train_config c;
    struct scene s;
    struct scene_image images[PHOTOS];
    uint32_t list[PHOTOS];
    defaults(&c, &a);
    scene_make(&s, images);
    for (uint32_t i = 0; i < PHOTOS; i++)
        list[i] = i;
    c.budget_density = 10.0;
    /* sqrt(400 * 225) = 300; 40 photographs: 10 * 40 * 300. */
    assert_int_equal(fit(&s, list, PHOTOS, 500, &c, 1000000), 120000);
    assert_int_equal(fit(&s, list, 10, 500, &c, 1000000), 30000);
    assert_int_equal(fit(&s, list, PHOTOS, 130000, &c, 1000000), 130000); /* points */
    assert_int_equal(fit(&s, list, PHOTOS, 130000, &c, 90000), 90000);    /* table */
    /* Cells that share the photographs share their Gaussians. */
    double part[PHOTOS], rest[PHOTOS];
    for (size_t i = 0; i < PHOTOS; i++) {
        part[i] = (double)(i + 1) / (PHOTOS + 1);
        rest[i] = 1.0 - part[i];
    }
    const struct budget_photos mine = {&s, list, part, PHOTOS, 0},
                               others = {&s, list, rest, PHOTOS, 0};
    size_t a_cell = budget_fit(&mine, &c, 1.0, 1000000),
           another = budget_fit(&others, &c, 1.0, 1000000);
    assert_in_range(a_cell + another, 119998, 120000);
    assert_in_range(a_cell, 59999, 60001);
    c.max_edge_px = 200; /* half the edge, half the Gaussians */
    assert_in_range(fit(&s, list, PHOTOS, 0, &c, 1000000), 59800, 60300);
    c.max_edge_px = 0;

    struct schedule levels[TRAIN_LEVELS_MAX] = {{.level = 1, .downsample = 4.0, .budget = 20000},
                                                {.level = 2, .downsample = 2.0, .budget = 819200},
                                                {.level = 3, .downsample = 1.0, .budget = 100000}};
    c.budget_rule = BUDGET_TABLE;
    limit(&s, list, 0, &c, levels);
    assert_int_equal(levels[1].budget, 819200);
    c.budget_rule = BUDGET_FIT;
    limit(&s, list, 0, &c, levels);
    assert_int_equal(levels[0].budget, 20000);
    assert_in_range(levels[1].budget, 59700, 60300);
    assert_int_equal(levels[2].budget, 100000);
    c.budget_rule = BUDGET_AUTO;
    levels[2].budget = 1000000;
    limit(&s, list, 9000, &c, levels);
    assert_int_equal(levels[0].budget, 10000); /* half of the table's 20000 */
    assert_int_equal(levels[2].budget, 60000); /* half of 120000 */
    arena_free(&a);
}

static void growth_stops_when_it_does_not_pay(void **state)
{
    (void)state;
    struct budget_point none = {0}, last = {.n = 1000, .psnr_db = 30.0};
    assert_int_equal(budget_decide(&none, 1000, 30.0, 2000, 0.5), BUDGET_KEEP);
    /* 4 % more say nothing, whatever the gain. */
    assert_int_equal(budget_decide(&last, 1040, 29.0, 2000, 0.5), BUDGET_KEEP);
    /* Doubled: 0.49 dB is too little for 0.5 dB a doubling, 0.51 is enough. */
    assert_int_equal(budget_decide(&last, 2000, 30.49, 2000, 0.5), BUDGET_STOP);
    assert_int_equal(budget_decide(&last, 2000, 30.51, 2000, 0.5), BUDGET_RAISE);
    /* Four times as many have to gain twice that. */
    assert_int_equal(budget_decide(&last, 4000, 30.99, 4000, 0.5), BUDGET_STOP);
    assert_int_equal(budget_decide(&last, 4000, 31.01, 4000, 0.5), BUDGET_RAISE);
    /* A budget that is not used needs no raising. */
    assert_int_equal(budget_decide(&last, 2000, 31.0, 2300, 0.5), BUDGET_KEEP);
    last.stopped = true;
    assert_int_equal(budget_decide(&last, 2000, 35.0, 2000, 0.5), BUDGET_KEEP);
}

static void held_out_photographs_are_a_sixteenth(void **state)
{
    (void)state;
    struct arena a = {0};
    struct train_config c;
    uint32_t list[PHOTOS], train[PHOTOS], held[PHOTOS];
    size_t n_train, n_held;
    defaults(&c, &a);
    for (uint32_t i = 0; i < PHOTOS; i++)
        list[i] = 3 * i;
    c.budget_rule = BUDGET_AUTO;
    budget_hold_out(&c, list, PHOTOS, train, &n_train, held, &n_held);
    assert_int_equal(n_held, 2);
    assert_int_equal(held[0], 24);
    assert_int_equal(held[1], 72);
    assert_int_equal(n_train, PHOTOS - 2);
    for (size_t i = 0; i < n_train; i++)
        assert_true(train[i] != 24 && train[i] != 72);
    budget_hold_out(&c, list, 15, train, &n_train, held, &n_held);
    assert_int_equal(n_held, 0);
    c.budget_rule = BUDGET_FIT;
    budget_hold_out(&c, list, PHOTOS, train, &n_train, held, &n_held);
    assert_int_equal(n_held, 0);
    assert_int_equal(n_train, PHOTOS);
    arena_free(&a);
}

/* A cell whose Gaussians lie half outside of it, and held-out photographs of which a mask covers
 * the first. */
struct look {
    struct dev dev;
    struct render *render;
    struct arena texts;
    struct train_config cfg;
    struct scene_image images[2];
    struct scene scene;
    struct model model;
    struct cell cell;
    struct appearance_train appearance;
    struct gallery gallery;
    struct stage stage;
    struct budget budget;
    size_t n;
};
enum { LOOK_WIDTH = 32, LOOK_HEIGHT = 24, LOOK_GAUSSIANS = 200 };
static const uint32_t held[2] = {0, 1};
static char *photo_names[2] = {(char[]){"a.png"}, (char[]){"b.png"}};

static void look_picture(const char *dir, const char *folder, const char *name, uint8_t value,
                         uint8_t channels)
{
    struct err e = {0};
    struct image img = {0};
    char sub[FILE_PATH_MAX], path[FILE_PATH_MAX];
    kit_ok(file_join(sub, dir, folder, &e), e);
    kit_ok(file_mkdir(sub, &e), e);
    kit_ok(file_join(path, sub, name, &e), e);
    kit_ok(image_alloc(LOOK_WIDTH, LOOK_HEIGHT, channels, &img, &e), e);
    memset(img.px, value, (size_t)LOOK_WIDTH * LOOK_HEIGHT * channels);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    image_free(&img);
}

static void look_open(struct look *l)
{
    struct err e = {0};
    struct gauss g;
    *l = (struct look){.n = 2};
    kit_ok(dev_open(NULL, &l->dev, &e), e);
    kit_ok(render_open(&l->dev, &l->render, &e), e);
    defaults(&l->cfg, &l->texts);
    l->scene = (struct scene){.images = l->images, .n_images = 2};
    kit_tmpdir(l->scene.dir);
    for (size_t i = 0; i < 2; i++) {
        double eye[3] = {0.0, 0.0, 30.0}, target[3] = {0.0, 0.1, 0.0};
        l->images[i].name = photo_names[i];
        l->images[i].cam = camera_look_at(eye, target, 0.9, LOOK_WIDTH, LOOK_HEIGHT);
        look_picture(l->scene.dir, "images", photo_names[i], (uint8_t)(60 + 60 * i), 3);
    }
    look_picture(l->scene.dir, "masks", "a.png.png", 0, 1);
    l->cell = (struct cell){.min_enu_m = {-50, -50},
                            .max_enu_m = {0, 50},
                            .edge_m = 50,
                            .extent_m = 30,
                            .scene_extent_m = 30};
    l->gallery = (struct gallery){.cfg = &l->cfg,
                                  .engine = {.dev = &l->dev, .render = l->render},
                                  .scene = &l->scene,
                                  .images = held,
                                  .n_images = 2,
                                  .appearance = &l->appearance,
                                  .near_m = RENDER_NEAR_M};
    l->stage = (struct stage){.levels = {{.level = 1,
                                          .n_levels = 1,
                                          .steps = 1000,
                                          .downsample = 1.0,
                                          .budget = 1000,
                                          .interval = 100,
                                          .densify_until = 1000,
                                          .tau = 2e-4}},
                              .n_levels = 1};
    l->budget = (struct budget){.held = held, .n_held = 2, .table = {1000}};
    kit_gauss(7, LOOK_GAUSSIANS, 10, 0, 0, &g);
    kit_ok(model_open(&l->model, &l->dev, l->render, &g, 1500, &e), e);
    kit_ok(model_fill(&l->model, &g, &e), e);
    gauss_free(&g);
}

static enum err_code look_once(struct look *l, struct err *e)
{
    return budget_look(&l->budget, &l->model, &l->gallery, &l->cell, &l->stage, 0, e);
}

static void look_close(struct look *l)
{
    budget_close(&l->budget);
    model_close(&l->model);
    render_close(&l->render);
    dev_close(&l->dev);
    kit_rmdir(l->scene.dir);
    arena_free(&l->texts);
}

static void photographs_that_a_mask_covers_whole_are_not_asked(void **state)
{
    struct look l;
    struct err e = {0};
    (void)state;
    look_open(&l);
    kit_ok(look_once(&l, &e), e);
    double both_db = l.budget.at.psnr_db;
    assert_true(both_db > 0.0);
    budget_close(&l.budget);
    l.budget = (struct budget){.held = held + 1, .n_held = 1, .table = {1000}};
    kit_ok(look_once(&l, &e), e);
    assert_true(l.budget.at.psnr_db == both_db);
    budget_close(&l.budget);
    l.budget = (struct budget){.held = held, .n_held = 1, .table = {1000}};
    log_set_level(LOG_ERROR); /* it warns that nothing is left */
    kit_ok(look_once(&l, &e), e);
    log_set_level(LOG_INFO);
    assert_true(l.budget.at.n == 0.0);
    assert_int_equal(l.stage.levels[0].budget, 1000);
    look_close(&l);
}

/* A level that starts with more Gaussians than its budget could never grow. */
static void a_level_can_grow_beyond_what_it_starts_with(void **state)
{
    struct budget b = {.held = held, .n_held = 2, .table = {1000, 2000, 4000}};
    struct stage at = {.n_levels = 3, .at = 1, .start = 900};
    (void)state;
    at.levels[1].budget = 500; /* half of what fits; the level before grew beyond it */
    budget_next(&b, &at);
    assert_int_equal(at.levels[1].budget, 1170);
    struct budget_point last = {.n = 900, .psnr_db = 25.0};
    assert_int_equal(budget_decide(&last, 1170, 26.0, 1170, 0.5), BUDGET_RAISE);
    budget_next(&b, &at); /* a budget that has room stays */
    assert_int_equal(at.levels[1].budget, 1170);
    at.start = 1900; /* never above the table */
    budget_next(&b, &at);
    assert_int_equal(at.levels[1].budget, 2000);
    b.n_held = 0; /* other modes: nothing */
    at.levels[1].budget = 500;
    budget_next(&b, &at);
    assert_int_equal(at.levels[1].budget, 500);
}

/* Outside of the cell, too; and a cell counts what is inside of it. */
static void growth_that_stops_stops_everywhere(void **state)
{
    struct look l;
    struct err e = {0};
    struct importance *importance = NULL;
    size_t inside = 0, n = LOOK_GAUSSIANS, after = 0;
    (void)state;
    look_open(&l);
    kit_ok(model_count_inside(&l.model, &l.cell, &inside, &e), e);
    assert_in_range(inside, n / 4, 3 * n / 4);
    l.budget.at = (struct budget_point){.n = (double)inside / 2, .psnr_db = 90.0};
    kit_ok(look_once(&l, &e), e);
    assert_true(l.budget.at.stopped);
    assert_int_equal(l.stage.levels[0].budget, inside);
    assert_int_equal(schedule_cap_outside(&l.stage.levels[0]), n - inside);
    float *grad = mem_array(n, sizeof *grad); /* all of them want to be two */
    assert_non_null(grad);
    for (size_t i = 0; i < n; i++)
        grad[i] = 1.0f;
    kit_ok(dev_write(&l.dev, l.model.stats.grad, 0, n * sizeof *grad, grad, &e), e);
    kit_ok(dev_write(&l.dev, l.model.stats.count, 0, n * sizeof *grad, grad, &e), e);
    mem_free(grad);
    l.cfg.prune_opacity = 0.0; /* and none is in the way */
    struct timing timing = {0};
    const struct site site = {.cell = l.cell};
    const struct densify_run run = {.gallery = &l.gallery,
                                    .site = &site,
                                    .at = &l.stage,
                                    .importance = &importance,
                                    .timing = &timing};
    kit_ok(densify_apply(&l.model, &run, 9, &e), e);
    kit_ok(model_count_inside(&l.model, &l.cell, &after, &e), e);
    printf("stopped at %zu inside and %zu outside: %zu and %zu\n", inside, n - inside, after,
           l.model.gauss.n - after);
    assert_true(after <= inside && l.model.gauss.n <= n);
    importance_free(&importance);
    look_close(&l);
}

/* Table 6 of the supplement of REUrbanGS: budgets, intervals and picture sizes of a cell of 600
 * photographs. */
static void presets_are_the_published_table(void **state)
{
    (void)state;
    static const struct {
        const char *file;
        size_t budget[3];
        uint32_t interval[3];
        double downsample[3];
    } table[] = {
        {"configs/train-rubble.jsonc", {409600, 819200, 1638400}, {300, 200, 100}, {3, 2, 1}},
        {"configs/train-jnu-zh.jsonc", {409600, 819200, 2048000}, {300, 200, 100}, {4, 2, 1}},
        {"configs/train-bigcity.jsonc", {204800, 819200, 2048000}, {300, 200, 100}, {4, 2, 1}},
    };
    static const uint32_t steps[3] = {15000, 15000, 30000};
    for (size_t k = 0; k < sizeof table / sizeof table[0]; k++) {
        struct err e = {0};
        struct arena a = {0};
        struct train_config c;
        struct options_args args;
        struct schedule s[TRAIN_LEVELS_MAX];
        struct cell cell = {
            .id = "all", .whole = true, .edge_m = 100.0, .extent_m = 60.0, .scene_extent_m = 60.0};
        char train[] = "train", config[] = "--config", file[64], scene[] = "scene";
        snprintf(file, sizeof file, "%s", table[k].file);
        char *argv[] = {train, scene, config, file, NULL};
        kit_ok(options_parse(train_options(), 4, argv, &c, &args, &a, &e), e);
        assert_true(c.appearance && c.embed_len > 0 && c.depth_sparse && c.depth_weight > 0.0);
        kit_ok(schedule_make(&c, 600, &cell, s, &e), e);
        budget_limit(&(struct budget_photos){0}, &c, s); /* a table: photographs are not asked */
        for (size_t i = 0; i < 3; i++) {
            assert_int_equal(s[i].budget, table[k].budget[i]);
            assert_int_equal(s[i].interval, table[k].interval[i]);
            assert_true(s[i].downsample == table[k].downsample[i]);
            assert_int_equal(s[i].steps, steps[i]);
        }
        assert_true(s[0].tau == 2e-4 && s[1].tau == 2e-4 && s[2].tau == 6e-4);
        assert_false(s[1].absgrad);
        assert_true(s[2].absgrad);
        arena_free(&a);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_fits_is_worked_out_by_hand),
        cmocka_unit_test(growth_stops_when_it_does_not_pay),
        cmocka_unit_test(held_out_photographs_are_a_sixteenth),
        cmocka_unit_test(photographs_that_a_mask_covers_whole_are_not_asked),
        cmocka_unit_test(a_level_can_grow_beyond_what_it_starts_with),
        cmocka_unit_test(growth_that_stops_stops_everywhere),
        cmocka_unit_test(presets_are_the_published_table),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
