/* The clock of where a run's time goes: shares add up to the whole, and survive a file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>
#include <time.h>

#include <jansson.h>

#include "core/base.h"
#include "tests/kit.h"
#include "train/spent.h"

#define ROUNDING_S 1e-6 /* sums of a few differences of a clock of nanoseconds */
#define PAUSE_S 0.005   /* what a pause is at least */

static void pause_some(void)
{
    nanosleep(&(struct timespec){.tv_nsec = 6000000}, NULL);
}

static void test_shares_add_up(void **state)
{
    struct spent c;
    (void)state;
    double start = clock_s();
    spent_start(&c, SPENT_START);
    pause_some();
    assert_int_equal(spent_turn(&c, SPENT_STEP), SPENT_START);
    struct spent_times then = spent_now(&c);
    assert_int_equal(spent_turn(&c, SPENT_DENSIFY), SPENT_STEP);
    assert_int_equal(spent_turn(&c, SPENT_SCORE), SPENT_DENSIFY);
    pause_some();
    assert_int_equal(spent_turn(&c, SPENT_DENSIFY), SPENT_SCORE);
    assert_int_equal(spent_turn(&c, SPENT_STEP), SPENT_DENSIFY);
    double end = clock_s();
    struct spent_times all = spent_now(&c), later = spent_since(&all, &then);
    assert_true(spent_total(&all) >= end - start - ROUNDING_S);
    assert_true(spent_total(&all) <= clock_s() - start + ROUNDING_S);
    assert_true(all.s[SPENT_START] >= PAUSE_S && all.s[SPENT_SCORE] >= PAUSE_S);
    assert_true(all.s[SPENT_EVALUATE] == 0.0); /* exact: never turned to */
    assert_true(later.s[SPENT_START] == 0.0 && later.s[SPENT_SCORE] == all.s[SPENT_SCORE]);
    spent_add(&later, &then);
    for (size_t i = 0; i < SPENT_COUNT; i++)
        assert_true(later.s[i] - all.s[i] < ROUNDING_S && all.s[i] - later.s[i] < ROUNDING_S);
}

static void test_text(void **state)
{
    struct spent_times t = {0};
    char text[256], little[16];
    (void)state;
    t.s[SPENT_STEP] = 80.0;
    t.s[SPENT_DENSIFY] = 19.9;
    t.s[SPENT_SCORE] = 0.1; /* below half a per cent */
    spent_text(&t, text, sizeof(text));
    assert_string_equal(text, "steps 80.0 s (80 %), densification 19.9 s (20 %), all else 0.1 s");
    memset(little, 'x', sizeof(little));
    spent_text(&t, little, 10);
    assert_string_equal(little, "steps 80.");
    assert_int_equal(little[10], 'x');
    memset(&t, 0, sizeof(t));
    spent_text(&t, text, sizeof(text));
    assert_string_equal(text, "all else 0.0 s");
}

static void test_json(void **state)
{
    struct spent_times t, back;
    (void)state;
    for (size_t i = 0; i < SPENT_COUNT; i++)
        t.s[i] = 0.25 * (double)i;
    json_t *o = spent_json(&t);
    assert_non_null(o);
    assert_int_equal(json_object_size(o), SPENT_COUNT);
    spent_from_json(o, &back);
    assert_memory_equal(&t, &back, sizeof(t));
    json_object_set_new(o, spent_key(SPENT_STEP), json_string("long"));
    json_object_set_new(o, spent_key(SPENT_SCORE), json_real(-1.0));
    json_object_del(o, spent_key(SPENT_PRUNE));
    spent_from_json(o, &back);
    assert_true(back.s[SPENT_STEP] == 0.0 && back.s[SPENT_SCORE] == 0.0 &&
                back.s[SPENT_PRUNE] == 0.0);
    spent_from_json(NULL, &back);
    assert_true(spent_total(&back) == 0.0);
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
