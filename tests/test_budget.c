/* Budgets that follow the photographs: the numbers of a case worked out by hand, the decision of
 * --budget auto, which photographs are held out, and the presets' tables.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cells/cell.h"
#include "codec/scene.h"
#include "core/options.h"
#include "tests/kit.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/schedule.h"

#include <stdio.h>

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
    assert_int_equal(budget_fit(&s, list, PHOTOS, &c, 1.0, 500, 1000000), 120000);
    assert_int_equal(budget_fit(&s, list, 10, &c, 1.0, 500, 1000000), 30000);
    assert_int_equal(budget_fit(&s, list, PHOTOS, &c, 1.0, 130000, 1000000), 130000); /* points */
    assert_int_equal(budget_fit(&s, list, PHOTOS, &c, 1.0, 130000, 90000), 90000);    /* table */
    c.max_edge_px = 200; /* half the edge, half the Gaussians */
    assert_in_range(budget_fit(&s, list, PHOTOS, &c, 1.0, 0, 1000000), 59800, 60300);
    c.max_edge_px = 0;

    struct schedule levels[TRAIN_LEVELS_MAX] = {{.level = 1, .downsample = 4.0, .budget = 20000},
                                                {.level = 2, .downsample = 2.0, .budget = 819200},
                                                {.level = 3, .downsample = 1.0, .budget = 100000}};
    c.budget = BUDGET_TABLE;
    budget_limit(&s, list, PHOTOS, &c, 0, levels);
    assert_int_equal(levels[1].budget, 819200);
    c.budget = BUDGET_FIT;
    budget_limit(&s, list, PHOTOS, &c, 0, levels);
    assert_int_equal(levels[0].budget, 20000);
    assert_in_range(levels[1].budget, 59700, 60300);
    assert_int_equal(levels[2].budget, 100000);
    c.budget = BUDGET_AUTO;
    levels[2].budget = 1000000;
    budget_limit(&s, list, PHOTOS, &c, 9000, levels);
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
    c.budget = BUDGET_AUTO;
    budget_hold_out(&c, list, PHOTOS, train, &n_train, held, &n_held);
    assert_int_equal(n_held, 2);
    assert_int_equal(held[0], 24);
    assert_int_equal(held[1], 72);
    assert_int_equal(n_train, PHOTOS - 2);
    for (size_t i = 0; i < n_train; i++)
        assert_true(train[i] != 24 && train[i] != 72);
    budget_hold_out(&c, list, 15, train, &n_train, held, &n_held);
    assert_int_equal(n_held, 0);
    c.budget = BUDGET_FIT;
    budget_hold_out(&c, list, PHOTOS, train, &n_train, held, &n_held);
    assert_int_equal(n_held, 0);
    assert_int_equal(n_train, PHOTOS);
    arena_free(&a);
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
        struct cell cell = {.id = "all", .whole = true, .edge_m = 100.0, .extent_m = 60.0};
        char train[] = "train", config[] = "--config", file[64], scene[] = "scene";
        snprintf(file, sizeof file, "%s", table[k].file);
        char *argv[] = {train, scene, config, file, NULL};
        kit_ok(options_parse(train_options(), 4, argv, &c, &args, &a, &e), e);
        assert_true(c.appearance && c.embed_len > 0 && c.depth_sparse && c.depth_weight > 0.0);
        kit_ok(schedule_make(&c, 600, &cell, s, &e), e);
        budget_limit(NULL, NULL, 0, &c, 0, s); /* a table: photographs are not asked */
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
        cmocka_unit_test(presets_are_the_published_table),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
