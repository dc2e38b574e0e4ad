/* Contribution pruning: the choice, worked out by hand.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include "train/density/prune.h"

#include <math.h>

static void the_faintest_hundredth_goes(void **state)
{
    /* All weight: 100. A hundredth is 1: 0, 0.25 and 0.5 fit (0.75 together), 1.25 more does not.
     */
    float sum[6] = {50.0f, 0.25f, 48.0f, 0.0f, 1.25f, 0.5f};
    const uint16_t views[6] = {1, 1, 1, 0, 1, 1};
    const uint8_t want[6] = {1, 0, 1, 0, 1, 0};
    double scratch[6];
    uint8_t keep[6];
    struct prune_report r = {0};
    prune_choose(sum, views, 6, &(struct prune_rule){0.01, 0}, scratch, keep, &r);
    assert_memory_equal(keep, want, sizeof keep);
    assert_int_equal(r.faint, 3);
    assert_int_equal(r.unsupported, 0);
}

static void nothing_goes_when_nothing_may(void **state)
{
    float sum[3] = {0.0f, 1.0f, 2.0f};
    const uint16_t views[3] = {0, 1, 2};
    double scratch[3];
    uint8_t keep[3];
    struct prune_report r = {0};
    prune_choose(sum, views, 3, &(struct prune_rule){0.0, 0}, scratch, keep, &r);
    assert_true(keep[0] && keep[1] && keep[2]);
    assert_int_equal(r.faint + r.unsupported, 0);
}

static void few_photographs_are_no_support(void **state)
{
    float sum[4] = {30.0f, 30.0f, 40.0f, 0.0f};
    const uint16_t views[4] = {3, 2, 7, 1};
    double scratch[4];
    uint8_t keep[4];
    struct prune_report r = {0};
    prune_choose(sum, views, 4, &(struct prune_rule){1e-3, 3}, scratch, keep, &r);
    assert_true(keep[0] && !keep[1] && keep[2] && !keep[3]);
    assert_int_equal(r.faint, 1); /* counted once, for its contribution */
    assert_int_equal(r.unsupported, 1);
}

/* A Gaussian at the rim weighs as much in its two photographs as another in each of its twenty. */
static void few_photographs_do_not_make_faint(void **state)
{
    float sum[4] = {20.0f, 2.0f, 1.0f, 20.0f};
    const uint16_t views[4] = {20, 2, 20, 20};
    double scratch[4];
    uint8_t keep[4];
    struct prune_report r = {0};
    prune_choose(sum, views, 4, &(struct prune_rule){0.02, 0}, scratch, keep, &r);
    assert_true(keep[0] && keep[1] && !keep[2] && keep[3]);
    assert_int_equal(r.faint, 1);
}

/* Where what is lost is a power of the scores, three trials come near the aim. Where nothing is
 * known of scores, it is a bisection. */
static void trials_follow_a_power(void **state)
{
    enum { N = 1000 };
    double sum[N + 1] = {0};
    for (size_t k = 0; k < N; k++)
        sum[k + 1] = sum[k] + (double)k * (double)k;
    for (int p = 2; p <= 4; p++) { /* powers 1 to 2 of scores */
        double power = p / 2.0, aim = 0.02, scale = 0.08 / pow(sum[N], power);
        struct prune_trial lo = {0}, hi = {N, 0.08};
        bool near = false;
        for (int k = 0; k < 3 && !near; k++) {
            size_t go = prune_next(sum, &lo, &hi, aim);
            double lost = scale * pow(sum[go], power);
            assert_true(go > lo.go && go < hi.go);
            near = fabs(lost - aim) < 0.1 * aim;
            *(lost <= aim ? &lo : &hi) = (struct prune_trial){go, lost};
        }
        assert_true(near);
    }
    const double nothing[N + 1] = {0};
    const struct prune_trial none = {0}, all = {N, 1.0}, next = {1, 1.0}, two = {2, 1.0};
    assert_int_equal(prune_next(nothing, &none, &all, 0.02), N / 2);
    assert_int_equal(prune_next(sum, &none, &all, 0.0), N / 2);
    assert_int_equal(prune_next(sum, &none, &two, 0.02), 1);
    assert_int_equal(prune_next(sum, &next, &(struct prune_trial){3, 1.0}, 0.02), 2);
    /* far off: halfway between the scores 2 and 18, each lost as a power of 1 */
    const double few[] = {0, 2, 4, 6, 9, 18};
    assert_int_equal(
        prune_next(few, &(struct prune_trial){1, 0.01}, &(struct prune_trial){5, 9.0}, 0.02), 3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_faintest_hundredth_goes),
        cmocka_unit_test(nothing_goes_when_nothing_may),
        cmocka_unit_test(few_photographs_are_no_support),
        cmocka_unit_test(trials_follow_a_power),
        cmocka_unit_test(few_photographs_do_not_make_faint),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
