/* The clock of a run: shares add up to the whole, and survive a file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>
#include <time.h>

#include <jansson.h>

#include "core/base.h"
#include "tests/kit.h"
#include "train/base/timing.h"

#define ROUNDING_S 1e-6 /* sums of a few differences of a clock of nanoseconds */
#define PAUSE_S 0.005   /* what a pause is at least */

static void pause_some(void)
{
    nanosleep(&(struct timespec){.tv_nsec = 6000000}, NULL);
}

static void test_shares_add_up(void **state)
{
    struct timing c;
    double before = clock_s(); /* the clock of the run starts between the two */
    timing_start(&c, TIMING_START);
    double start = clock_s();
    pause_some();
    assert_int_equal(timing_turn(&c, TIMING_STEP), TIMING_START);
    struct timing_seconds then = timing_now(&c);
    assert_int_equal(timing_turn(&c, TIMING_DENSIFY), TIMING_STEP);
    assert_int_equal(timing_turn(&c, TIMING_IMPORTANCE), TIMING_DENSIFY);
    pause_some();
    assert_int_equal(timing_turn(&c, TIMING_DENSIFY), TIMING_IMPORTANCE);
    assert_int_equal(timing_turn(&c, TIMING_STEP), TIMING_DENSIFY);
    double end = clock_s();
    struct timing_seconds all = timing_now(&c), later = timing_since(&all, &then);
    assert_true(timing_total(&all) >= end - start - ROUNDING_S);
    assert_true(timing_total(&all) <= clock_s() - before + ROUNDING_S);
    assert_true(all.s[TIMING_START] >= PAUSE_S && all.s[TIMING_IMPORTANCE] >= PAUSE_S);
    assert_true(all.s[TIMING_EVALUATE] == 0.0); /* exact: never turned to */
    assert_true(later.s[TIMING_START] == 0.0 &&
                later.s[TIMING_IMPORTANCE] == all.s[TIMING_IMPORTANCE]);
    timing_add(&later, &then);
    for (size_t i = 0; i < TIMING_COUNT; i++)
        assert_true(later.s[i] - all.s[i] < ROUNDING_S && all.s[i] - later.s[i] < ROUNDING_S);
}

static void test_text(void **state)
{
    struct timing_seconds t = {0};
    char text[256], little[16];
    t.s[TIMING_STEP] = 80.0;
    t.s[TIMING_DENSIFY] = 19.9;
    t.s[TIMING_IMPORTANCE] = 0.1; /* below half a per cent */
    timing_text(&t, text, sizeof text);
    assert_string_equal(text, "steps 80.0 s (80 %), densification 19.9 s (20 %), all else 0.1 s");
    memset(little, 'x', sizeof little);
    timing_text(&t, little, 10);
    assert_string_equal(little, "steps 80.");
    assert_int_equal(little[10], 'x');
    memset(&t, 0, sizeof t);
    timing_text(&t, text, sizeof text);
    assert_string_equal(text, "all else 0.0 s");
}

static void test_json(void **state)
{
    struct timing_seconds t, back;
    for (size_t i = 0; i < TIMING_COUNT; i++)
        t.s[i] = 0.25 * (double)i;
    json_t *o = timing_json(&t);
    assert_non_null(o);
    assert_int_equal(json_object_size(o), TIMING_COUNT);
    timing_from_json(o, &back);
    assert_memory_equal(&t, &back, sizeof t);
    json_object_set_new(o, "step", json_string("long"));
    json_object_set_new(o, "importance", json_real(-1.0));
    json_object_del(o, "prune");
    timing_from_json(o, &back);
    assert_true(back.s[TIMING_STEP] == 0.0 && back.s[TIMING_IMPORTANCE] == 0.0 &&
                back.s[TIMING_PRUNE] == 0.0);
    timing_from_json(NULL, &back);
    assert_true(timing_total(&back) == 0.0);
    json_decref(o);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_shares_add_up),
        cmocka_unit_test(test_text),
        cmocka_unit_test(test_json),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
