/* Thinning: the choice worked out by hand, and the steps that it follows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>

#include "train/base/schedule.h"
#include "train/density/thin.h"
#include "train/refit.h"

static size_t choose(const float *rise, const uint16_t *views, size_t n, size_t most, bool all,
                     uint32_t *keep, double *given)
{
    struct err e = {0};
    size_t n_keep = 0;
    const struct thin_rule rule = {.all_drawn = all, .most = {most, 0}};
    kit_ok(thin_choose(rise, views, n, &rule, keep, &n_keep, given, &e), e);
    return n_keep;
}

static void the_cheapest_go(void **state)
{
    enum { N = 9 };
    const float rise[N] = {4.0f, 0.5f, 9.0f, 0.25f, 8.0f, 1.0f, 9.0f, 8.0f, 7.0f};
    const uint16_t views[N] = {3, 3, 3, 3, 3, 3, 3, 3, 3};
    uint32_t keep[N];
    double given;
    assert_int_equal(choose(rise, views, N, 3, true, keep, &given), N - 3);
    assert_true(keep[0] == 0 && keep[1] == 2 && keep[2] == 4 && keep[3] == 6 && given == 1.75);
    assert_int_equal(choose(rise, views, N, 2, true, keep, &given), N - 2);
    assert_true(keep[0] == 0 && keep[1] == 2 && keep[2] == 4 && keep[3] == 5 && given == 0.75);
    assert_int_equal(choose(rise, views, N, 0, true, keep, &given), N);
    assert_true(given == 0.0);
    assert_int_equal(choose(rise, views, 0, 0, true, keep, &given), 0);
}

static void equal_ones_go_in_the_order_of_rows(void **state)
{
    const float rise[7] = {1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f};
    const uint16_t views[7] = {1, 2, 1, 2, 1, 1, 1};
    uint32_t keep[7];
    double given;
    assert_int_equal(choose(rise, views, 7, 2, true, keep, &given), 5);
    for (uint32_t k = 0; k < 5; k++)
        assert_int_equal(keep[k], k + 2);
}

/* First if all photographs were drawn, else last. */
static void what_no_photograph_shows_goes_if_all_were_asked(void **state)
{
    const float rise[6] = {0.0f, 1.0f, 0.0f, 5.0f, 5.0f, 5.0f};
    const uint16_t views[6] = {0, 2, 1, 2, 2, 2};
    uint32_t keep[6];
    double given;
    assert_int_equal(choose(rise, views, 6, 2, true, keep, &given), 4);
    assert_true(keep[0] == 1 && keep[1] == 3);
    assert_int_equal(choose(rise, views, 6, 1, false, keep, &given), 5);
    assert_true(keep[0] == 0 && keep[1] == 1 && keep[2] == 3);
    assert_int_equal(choose(rise, views, 6, 5, false, keep, &given), 1);
    assert_true(keep[0] == 0 && given == 16.0);
}

/* Three times in the first half of the steps that follow densification, at the finest level. */
static void it_happens_while_steps_are_left(void **state)
{
    struct schedule s = {.level = 3, .n_levels = 3, .steps = 1000, .densify_until = 400};
    uint32_t n = 0;
    for (uint32_t step = 1; step <= s.steps; step++)
        n += schedule_thinning(&s, step) > 0;
    assert_int_equal(n, 3);
    assert_true(schedule_thinning(&s, 400) == 1 && schedule_thinning(&s, 500) == 2 &&
                schedule_thinning(&s, 600) == 3);
    s.level = 2; /* the next level would fill the gaps */
    assert_int_equal(schedule_thinning(&s, 400), 0);
    s.level = 3;
    s.densify_until = 1000; /* no step would be left to recover */
    assert_int_equal(schedule_thinning(&s, 1000), 0);
    s.densify_until = 0; /* of a last fit */
    for (uint32_t step = 1; step <= s.steps; step++)
        assert_int_equal(schedule_thinning(&s, step), 0);
}

/* Of each side its number. */
static void each_side_is_thinned_to_its_number(void **state)
{
    struct err e = {0};
    const float rise[8] = {1.0f, 9.0f, 0.0f, 2.0f, 8.0f, 3.0f, 7.0f, 0.5f};
    const uint16_t views[8] = {1, 1, 0, 1, 1, 1, 1, 1};
    const uint8_t outside[8] = {0, 0, 0, 1, 1, 1, 0, 0};
    struct thin_rule rule = {.outside = outside, .most = {3, 2}};
    uint32_t keep[8];
    size_t n_keep = 0;
    double given = 0.0;
    kit_ok(thin_choose(rise, views, 8, &rule, keep, &n_keep, &given, &e), e);
    assert_true(n_keep == 3 && keep[0] == 1 && keep[1] == 2 && keep[2] == 4);
    assert_true(given == 1.0 + 0.5 + 7.0 + 2.0 + 3.0);
    rule.most[0] = 5;
    kit_ok(thin_choose(rise, views, 8, &rule, keep, &n_keep, &given, &e), e);
    assert_true(n_keep == 1 && keep[0] == 4);
    rule = (struct thin_rule){.all_drawn = true, .outside = outside, .most = {1, 0}};
    kit_ok(thin_choose(rise, views, 8, &rule, keep, &n_keep, &given, &e), e);
    assert_true(n_keep == 7 && keep[2] == 3); /* row 2 goes, for nothing */
}

/* What a level grew to goes in equal parts. One that did not grow beyond its budget keeps all. */
static void the_finest_level_ends_with_its_budget(void **state)
{
    const struct schedule s = {
        .level = 3, .n_levels = 3, .steps = 1000, .densify_until = 500, .budget = 8000};
    size_t n = schedule_grows(&s), few = 7000, far_too_many = 1000000;
    assert_int_equal(n, 12000);
    const size_t want[] = {10482, 9157, 8000};
    for (uint32_t nth = 1; nth <= SCHEDULE_THINNINGS; nth++) {
        n = thin_inside(&s, nth, n);
        assert_in_range(n, want[nth - 1] - 1, want[nth - 1] + 1);
        few = thin_inside(&s, nth, few);
        far_too_many = thin_inside(&s, nth, far_too_many);
    }
    assert_true(n == 8000 && few == 7000 && far_too_many == 8000);
}

/* Where nothing is thinned afterwards, nothing grows beyond the budget. */
static void a_level_that_is_not_thinned_does_not_grow_more(void **state)
{
    for (uint32_t until = 0; until <= 20; until++)
        for (uint32_t level = 1; level <= 2; level++) {
            const struct schedule s = {
                .level = level, .n_levels = 2, .steps = 20, .densify_until = until, .budget = 100};
            size_t thinnings = 0;
            for (uint32_t step = 1; step <= s.steps; step++)
                thinnings += schedule_thinning(&s, step) > 0;
            assert_int_equal(schedule_grows(&s), thinnings == SCHEDULE_THINNINGS ? 150 : 100);
            assert_true(thinnings == 0 || (level == 2 && thinnings == SCHEDULE_THINNINGS));
        }
}

/* A derived level has its share after the last thinning, inside as outside, but for what came from
 * the coarse model, and never more than its budget; also where its steps are fewer. */
static void a_derived_level_ends_with_its_share(void **state)
{
    for (uint32_t steps = 1; steps <= 400; steps = 2 * steps + 1) {
        struct schedule s = {.level = 2,
                             .n_levels = 3,
                             .steps = steps,
                             .budget = 400,
                             .around = 50,
                             .derived = true,
                             .thin_share = 0.4};
        size_t inside = 1000, outside = 150, over = 1100, n = 0;
        for (uint32_t step = 1; step <= steps; step++) {
            const uint32_t nth = schedule_thinning(&s, step);
            if (!nth)
                continue;
            assert_int_equal(nth, ++n);
            inside = thin_inside(&s, nth, inside);
            over = thin_inside(&s, nth, over);
            outside = thin_outside(&s, outside);
        }
        assert_int_equal(n, steps < 3 ? steps : 3);
        assert_true(inside <= 400 && inside >= 397 && over == 400);
        assert_true(outside <= 50 + 40 && outside >= 50 + 37);
        /* the network of the finest level, and a last fit, move what there is */
        const struct schedule refit = refit_schedule(&s), last = refit_schedule_last(&s);
        for (uint32_t step = 1; step <= steps; step++)
            assert_true(!schedule_thinning(&refit, step) && !schedule_thinning(&last, step));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_cheapest_go),
        cmocka_unit_test(equal_ones_go_in_the_order_of_rows),
        cmocka_unit_test(what_no_photograph_shows_goes_if_all_were_asked),
        cmocka_unit_test(it_happens_while_steps_are_left),
        cmocka_unit_test(each_side_is_thinned_to_its_number),
        cmocka_unit_test(the_finest_level_ends_with_its_budget),
        cmocka_unit_test(a_level_that_is_not_thinned_does_not_grow_more),
        cmocka_unit_test(a_derived_level_ends_with_its_share),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
