/* Budgets that follow the photographs: the numbers of a case worked out by hand, and the presets'
 * tables.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/scene.h"
#include "core/options/options.h"
#include "scene/cells/cell.h"
#include "tests/kit.h"
#include "train/base/config.h"
#include "train/base/schedule.h"
#include "train/density/budget.h"

#include <math.h>
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
    struct arena a = {0};
    struct train_config c;
    struct scene s;
    struct scene_image images[PHOTOS];
    uint32_t list[PHOTOS];
    defaults(&c, &a);
    scene_make(&s, images);
    for (uint32_t i = 0; i < PHOTOS; i++)
        list[i] = i;
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
    /* A level that is thinned afterwards grows to what fits. */
    for (size_t i = 0; i < TRAIN_LEVELS_MAX; i++)
        levels[i] = (struct schedule){.level = (uint32_t)i + 1,
                                      .n_levels = TRAIN_LEVELS_MAX,
                                      .steps = 1000,
                                      .densify_until = 500,
                                      .downsample = 4.0 / pow(2.0, (double)i),
                                      .budget = 100000};
    limit(&s, list, 0, &c, levels);
    assert_in_range(levels[1].budget, 59700, 60300);
    assert_int_equal(levels[2].budget, 80000);
    assert_int_equal(schedule_grows(&levels[2]), 120000);
    arena_free(&a);
}

/* Table 6 of the supplement of REUrbanGS: budgets, intervals and picture sizes of a cell of 600
 * photographs. */
static void presets_are_the_published_table(void **state)
{
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
        assert_true(c.appearance && c.embed_len > 0);
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
        cmocka_unit_test(presets_are_the_published_table),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
