/* The schedule: ceilings, steps of densification, learning rates, short and long runs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/cell.h"
#include "tests/kit.h"
#include "train/base/config.h"
#include "train/base/schedule.h"
#include "train/base/stage.h"

#include <math.h>
#include <string.h>

#define EDGE_M 100.0
static const struct cell cell = {
    .id = "all", .whole = true, .edge_m = EDGE_M, .extent_m = EDGE_M, .scene_extent_m = EDGE_M};
#define LR_TOL 1e-12    /* exp and log of doubles */
#define LR_FINAL 1.6e-6 /* of positions at the end of a level, half cell edges; 3DGS */

static struct train_config defaults(struct arena *a)
{
    struct train_config c;
    struct err e = {0};
    kit_ok(options_defaults(train_options(), &c, a, &e), e);
    c.level_order = SCHEDULE_COARSE_TO_FINE; /* the published order */
    memcpy(c.iterations.v, (int64_t[]){15000, 15000, 30000}, sizeof c.iterations.v);
    return c;
}

/* Nothing asked for: the default's sum, shared as ever, which grows with the photographs and is as
 * good as asked for otherwise. */
static void the_default_is_short(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c, one;
    struct schedule s[3], asked[3];
    kit_ok(options_defaults(train_options(), &c, &a, &e), e);
    one = c;
    one.iterations.one = 7000;
    one.iterations.n = 1;
    kit_ok(schedule_make(&c, 600, &cell, s, &e), e);
    kit_ok(schedule_make(&one, 600, &cell, asked, &e), e);
    assert_memory_equal(s, asked, sizeof s);
    assert_int_equal(schedule_asked(&c, 901), 10570); /* 1.51 times */
    assert_int_equal(schedule_asked(&one, 901), 7000);
    kit_ok(schedule_make(&c, 901, &cell, s, &e), e);
    assert_int_equal(s[0].steps + s[1].steps + s[2].steps + s[0].tuned + s[1].tuned, 10570);
    assert_true(fabs(s[2].kappa - 10570.0 / 60000.0) < 1e-12);
    assert_true(schedule_full(&c) == 60000.0);
    c.level_count = 1;
    assert_int_equal(schedule_asked(&c, 60), 3500);
    c.iterations = (struct options_ints){.v = {15000, 15000, 30000}, .n = 3}; /* as published */
    assert_int_equal(schedule_asked(&c, 60), 0);
    c.level_count = 3;
    kit_ok(schedule_make(&c, 60, &cell, s, &e), e);
    assert_true(s[2].steps == 30000 && s[2].kappa == 1.0);
    arena_free(&a);
}

static void cap_rises_from_start_to_exactly_the_budget(void **state)
{
    /* S = 60,000, B = 409,600, 49 steps: values by hand from S + (B - S)(2u - u^2), u = x / 48 */
    assert_int_equal(schedule_cap(60000, 409600, 0, 49), 60000);
    assert_int_equal(schedule_cap(60000, 409600, 1, 49), 74414);
    assert_int_equal(schedule_cap(60000, 409600, 24, 49), 322200);
    assert_int_equal(schedule_cap(60000, 409600, 48, 49), 409600);
    for (uint32_t n = 2; n < 200; n += 7) {
        size_t last = 0;
        for (uint32_t x = 0; x < n; x++) {
            size_t cap = schedule_cap(123, 98765, x, n);
            assert_true(cap >= last && cap <= 98765);
            last = cap;
        }
        assert_int_equal(last, 98765);
    }
}

static void cap_has_no_edge_that_divides_by_zero_or_shrinks(void **state)
{
    assert_int_equal(schedule_cap(500, 400, 3, 10), 500); /* over budget: no growth, no cut */
    assert_int_equal(schedule_cap(400, 400, 0, 10), 400);
    assert_int_equal(schedule_cap(100, 400, 0, 1), 400); /* a single densification may fill it */
    assert_int_equal(schedule_cap(100, 400, 0, 0), 400);
    assert_int_equal(schedule_cap(100, 400, 99, 10), 400);
    assert_int_equal(schedule_cap(0, (size_t)1 << 40, 5, 11),
                     (size_t)(0.75 * (double)((size_t)1 << 40)));
}

static void full_run_has_the_published_numbers(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    kit_ok(schedule_make(&c, 600, &cell, s, &e), e);
    assert_int_equal(s[0].steps, 15000);
    assert_int_equal(s[1].steps, 15000);
    assert_int_equal(s[2].steps, 30000);
    assert_int_equal(s[0].interval, 300);
    assert_int_equal(s[1].interval, 200);
    assert_int_equal(s[2].interval, 100);
    assert_int_equal(s[2].densify_until, 15000);
    assert_int_equal(schedule_densify_count(&s[0]), 49);
    assert_false(s[0].absgrad || s[1].absgrad);
    assert_true(s[2].absgrad);
    assert_int_equal(schedule_densify_index(&s[0], 300), 0);
    assert_int_equal(schedule_densify_index(&s[0], 600), 1);
    assert_int_equal(schedule_densify_index(&s[0], 601), 0);
    assert_int_equal(schedule_densify_index(&s[0], 14700), 48);
    assert_int_equal(schedule_densify_index(&s[0], 15000), 0); /* the end of the level */
    assert_int_equal(schedule_densify_index(&s[2], 14900), schedule_densify_count(&s[2]) - 1);
    assert_int_equal(schedule_densify_index(&s[2], 15000), 0);
    /* huge Gaussians go after a fifth of the first level, and at later levels from the start */
    assert_false(schedule_limits_size(&s[0], 3000));
    assert_true(schedule_limits_size(&s[0], 3001) && schedule_limits_size(&s[1], 1));
    /* harmonics: a degree every 1000 steps at the first level, all of them afterwards */
    assert_int_equal(schedule_sh_degree(&s[0], 999), 0);
    assert_int_equal(schedule_sh_degree(&s[0], 1000), 1);
    assert_int_equal(schedule_sh_degree(&s[0], 9000), 3);
    assert_int_equal(schedule_sh_degree(&s[1], 1), 3);
    arena_free(&a);
}

static void every_index_from_one_to_the_last_is_used_once(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    for (int64_t iterations = 7; iterations < 70000; iterations = iterations * 3 + 1) {
        struct train_config c = defaults(&a);
        struct schedule s[3];
        c.iterations.one = iterations;
        kit_ok(schedule_make(&c, 75, &cell, s, &e), e);
        uint64_t total = 0;
        for (int l = 0; l < 3; l++) {
            uint32_t next = 1, n = schedule_densify_count(&s[l]);
            total += s[l].steps;
            for (uint32_t t = 1; t <= s[l].steps; t++) {
                uint32_t x = schedule_densify_index(&s[l], t);
                if (x)
                    assert_int_equal(x, next++);
            }
            assert_true(next == n || (next == 1 && n == 1));
        }
        assert_int_equal(total, iterations); /* exactly what was asked for */
    }
    arena_free(&a);
}

/* However short the run and however many its levels: some densification removes them. */
static void runs_of_any_length_remove_huge_gaussians(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    for (int64_t iterations = 500; iterations <= 60000; iterations += 100)
        for (int64_t levels = 1; levels <= 3; levels++) {
            struct train_config c = defaults(&a);
            struct schedule s[3];
            c.iterations.one = iterations;
            c.level_count = levels;
            kit_ok(schedule_make(&c, 75, &cell, s, &e), e);
            for (int64_t l = 0; l < levels; l++) {
                uint32_t removals = 0;
                for (uint32_t t = 1; t <= s[l].steps; t++)
                    removals += schedule_densify_index(&s[l], t) && schedule_limits_size(&s[l], t);
                assert_true(removals > 0);
            }
        }
    arena_free(&a);
}

static void many_photographs_stretch_and_short_runs_shrink(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    kit_ok(schedule_make(&c, 901, &cell, s, &e), e); /* 901 / 600 = 1.5017, two decimals up: 1.51 */
    assert_int_equal(s[0].steps, 22650);
    assert_int_equal(s[0].interval, 453);
    assert_int_equal(s[2].interval, 151);
    assert_int_equal(s[0].densify_from, 755);
    c.iterations.one = 2000;
    kit_ok(schedule_make(&c, 901, &cell, s, &e), e);
    assert_int_equal(s[0].steps, 500);
    assert_int_equal(s[1].steps, 500);
    assert_int_equal(s[2].steps, 1000);
    for (int l = 0; l < 3; l++) {
        assert_true(s[l].interval >= 50);
        assert_true(schedule_densify_count(&s[l]) > 1);
    }
    assert_int_equal(schedule_sh_degree(&s[0], 500), 3);
    arena_free(&a);
}

static void fewer_levels_take_the_finest_rows(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    c.level_count = 1;
    kit_ok(schedule_make(&c, 10, &cell, s, &e), e);
    assert_int_equal(s[0].level, 1);
    assert_int_equal(s[0].steps, 30000);
    assert_true(s[0].downsample == 1.0);
    assert_true(s[0].absgrad);
    assert_int_equal(s[0].budget, c.budget.v[2]);
    assert_int_equal(schedule_sh_degree(&s[0], 1), 0); /* it is the first level all the same */
    arena_free(&a);
}

static void position_rate_decays_exponentially_and_restarts(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    kit_ok(schedule_make(&c, 10, &cell, s, &e), e);
    double first = c.lr_mean * EDGE_M / 2, last = LR_FINAL * EDGE_M / 2;
    assert_true(fabs(schedule_lr_mean(&s[0], 0) - first) < LR_TOL);
    assert_true(fabs(schedule_lr_mean(&s[0], 15000) - last) < LR_TOL);
    assert_true(fabs(schedule_lr_mean(&s[0], 7500) - sqrt(first * last)) < LR_TOL);
    assert_true(fabs(schedule_lr_mean(&s[1], 0) - first * 0.5) < LR_TOL);
    c.lr_mean = 0.0;
    kit_ok(schedule_make(&c, 10, &cell, s, &e), e);
    assert_true(schedule_lr_mean(&s[0], 100) == 0.0); /* frozen positions are a valid wish */
    arena_free(&a);
}

static void impossible_plans_are_refused(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    c.iterations.one = 1;
    kit_fails(schedule_make(&c, 10, &cell, s, &e), ERR_ARG, e, "level 1 of 3");
    c.iterations.one = 0;
    c.budget.v[1] = c.budget.v[0] - 1;
    kit_fails(schedule_make(&c, 10, &cell, s, &e), ERR_ARG, e, "budgets must not fall");
    arena_free(&a);
}

/* One value: the finest budget with the default's proportion, the same interval everywhere. A list
 * has a value a level; values for levels that are not trained are refused. */
static void lists_have_one_value_or_one_a_level(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    c.budget = (struct options_ints){.v = {409600, 819200, 2048000}, .one = 100000, .n = 1};
    c.densify_until.one = 0.25;
    c.densify_until.n = 1;
    kit_ok(schedule_make(&c, 10, &cell, s, &e), e);
    assert_int_equal(s[0].budget, 20000);
    assert_int_equal(s[1].budget, 40000);
    assert_int_equal(s[2].budget, 100000);
    assert_int_equal(s[0].densify_until, s[0].steps / 4);
    assert_int_equal(s[2].densify_until, s[2].steps / 4);
    c.iterations = (struct options_ints){.v = {1, 200, 300}, .n = 2};
    kit_fails(schedule_make(&c, 10, &cell, s, &e), ERR_ARG, e,
              "--iterations has 2 values and --level-count is 3");
    c.level_count = 2;
    kit_ok(schedule_make(&c, 10, &cell, s, &e), e);
    assert_true(s[0].steps == 200 && s[1].steps == 300);
    c.level_count = 1;
    kit_fails(schedule_make(&c, 10, &cell, s, &e), ERR_ARG, e, "give one value, or one for each");
    arena_free(&a);
}

/* 60,000 steps have the published rates, a part of them kappa^-0.4 times those, five times at most;
 * positions end at the published last rate over kappa. Harmonics go no farther than in 100 looks at
 * each photograph. */
static void short_runs_take_larger_steps(void **state)
{
    const struct {
        int64_t steps;
        double factor;
        double last; /* of positions, in published ones */
        double sh;
    } want[] = {{120000, 1, 1, 0.05},
                {60000, 1, 1, 0.1},
                {15000, 1.7411011, 4, 0.4},
                {6000, 2.5118864, 10, 1},
                {1000, 5, 55.901699, 1}};
    for (size_t i = 0; i < sizeof want / sizeof *want; i++) {
        struct arena a = {0};
        struct train_config cfg;
        struct schedule s[TRAIN_LEVELS_MAX];
        struct cell whole = {.whole = true, .edge_m = 100};
        struct err e = {0};
        kit_ok(options_defaults(train_options(), &cfg, &a, &e), e);
        cfg.iterations.one = want[i].steps;
        kit_ok(schedule_make(&cfg, 60, &whole, s, &e), e);
        assert_true(fabs(s[2].lr_factor - want[i].factor) < 1e-6);
        assert_true(fabs(schedule_sh_factor(&cfg, &s[0], 60) - want[i].sh) < 1e-9);
        assert_true(fabs(s[0].lr_mean_first - want[i].factor * cfg.lr_mean * 50) < 1e-9);
        assert_true(fabs(s[2].lr_mean_last - want[i].last * LR_FINAL * 50) < 1e-9);
        cfg.lr_short = 1;
        kit_ok(schedule_make(&cfg, 60, &whole, s, &e), e);
        assert_true(fabs(s[2].lr_mean_last - LR_FINAL * 50) < 1e-12);
        arena_free(&a);
    }
}

/* The levels go on from each other as from coarse to fine, and the steps that the coarser ones have
 * less come when these are made again. */
static void coarser_levels_can_be_made_again(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3], plain[3];
    c.iterations.one = 3000;
    kit_ok(schedule_make(&c, 60, &cell, plain, &e), e);
    c.level_order = SCHEDULE_BOTH;
    kit_ok(schedule_make(&c, 60, &cell, s, &e), e);
    assert_int_equal(s[2].tuned, 0);
    assert_int_equal(s[2].steps, plain[2].steps);
    assert_int_equal(s[2].densify_until, plain[2].densify_until);
    struct stage at = {.n_levels = 3, .again = true};
    memcpy(at.levels, s, sizeof s);
    uint32_t turn = 0, steps = 0;
    for (at.at = 0; at.at < at.n_levels; at.at = stage_after(&at, at.at)) {
        const struct schedule *now = stage_schedule(&at);
        assert_int_equal(now->turn, ++turn);
        assert_int_equal(now->level, at.at + 1);
        assert_true(now->derived == (turn > 3));
        steps += now->steps;
        if (turn < 3)
            assert_true(now->steps < plain[at.at].steps && now->fade_from == now->steps);
        if (turn > 3) {
            assert_int_equal(now->steps, s[at.at].tuned);
            assert_int_equal(s[at.at].steps + s[at.at].tuned, plain[at.at].steps);
            assert_true(fabs(schedule_fade(now, now->steps) - 0.1) < 1e-12);
            assert_true(now->thin_share == (double)now->budget / (double)s[at.at + 1].budget);
            for (uint32_t t = 1; t <= now->steps; t++)
                assert_false(schedule_densify_index(now, t));
        }
        if (turn == 3)
            stage_turn(&at, &c);
    }
    assert_int_equal(turn, 5);
    assert_int_equal(steps, 3000);
    c.iterations = (struct options_ints){.v = {3, 200, 300}, .n = 3};
    kit_ok(schedule_make(&c, 60, &cell, s, &e), e);
    assert_true(s[0].steps == 2 && s[0].tuned == 1 && s[1].steps == 140 && s[1].tuned == 60);
    arena_free(&a);
}

/* In the last fifth of the finest level. A level that goes on has the rates of a run as long as it
 * has become, and ends as others do. */
static void rates_fall_at_the_end(void **state)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_config c = defaults(&a);
    struct schedule s[3];
    c.iterations.one = 3000;
    kit_ok(schedule_make(&c, 60, &cell, s, &e), e);
    for (uint32_t t = 1; t <= 1200; t++)
        assert_true(schedule_fade(&s[2], t) == 1.0 && schedule_fade(&s[0], t) == 1.0);
    for (uint32_t t = 1201; t <= 1500; t++)
        assert_true(schedule_fade(&s[2], t) < schedule_fade(&s[2], t - 1));
    assert_true(fabs(schedule_fade(&s[2], 1350) - sqrt(0.1)) < 1e-12);
    assert_true(fabs(schedule_fade(&s[2], 1500) - 0.1) < 1e-12);
    assert_true(schedule_fade(&s[0], 750) == 1.0 && schedule_fade(&s[1], 750) == 1.0);
    arena_free(&a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rates_fall_at_the_end),
        cmocka_unit_test(coarser_levels_can_be_made_again),
        cmocka_unit_test(short_runs_take_larger_steps),
        cmocka_unit_test(the_default_is_short),
        cmocka_unit_test(cap_rises_from_start_to_exactly_the_budget),
        cmocka_unit_test(cap_has_no_edge_that_divides_by_zero_or_shrinks),
        cmocka_unit_test(full_run_has_the_published_numbers),
        cmocka_unit_test(every_index_from_one_to_the_last_is_used_once),
        cmocka_unit_test(runs_of_any_length_remove_huge_gaussians),
        cmocka_unit_test(many_photographs_stretch_and_short_runs_shrink),
        cmocka_unit_test(fewer_levels_take_the_finest_rows),
        cmocka_unit_test(position_rate_decays_exponentially_and_restarts),
        cmocka_unit_test(impossible_plans_are_refused),
        cmocka_unit_test(lists_have_one_value_or_one_a_level),
    };
    return cmocka_run_group_tests_name("schedule", tests, NULL, NULL);
}
