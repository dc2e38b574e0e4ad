/* Which job runs next, and where: bounded queues, classes, clients that take turns, threads that
 * draw.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/jobs/job_bench.h"

/* What is predicted to take long leaves one of several threads to what is quick, as long as such
 * work comes: with none for a second, all threads take slow work. */
static void test_slow_work_leaves_a_thread(void **state)
{
    enum { THREADS = 3, SLOW = 6, TICK_MS = 100 };
    struct bench b;
    struct job_stats st;
    bench_cost = item_cost;
    bench_open(&b, THREADS, false, 1, 100);
    gate(&b, true);
    submit(&b, 0, JOB_TILE, 70000);
    await(&b, &b.woken, 1);
    gate(&b, false);
    for (int i = 1; i <= SLOW; i++)
        submit(&b, i, JOB_TILE, 1000 * i + 9);
    await(&b, &b.runs, 1 + THREADS - 1);
    job_count(b.jobs, &st);
    assert_int_equal(st.running[JOB_SLOW], THREADS - 1);
    submit(&b, SLOW + 1, JOB_TILE, 50000);
    await(&b, &b.runs, 1 + THREADS);
    assert_int_equal(b.order[THREADS], 50000); /* before four that were there earlier */
    gate(&b, true);
    await(&b, &b.woken, SLOW + 2);
    gate(&b, false);
    for (int i = 0; i < THREADS; i++)
        submit(&b, SLOW + 2 + i, JOB_TILE, 100009 + 10 * i);
    for (int i = 0; i < 50 && st.running[JOB_SLOW] < THREADS; i++) {
        nap_ms(TICK_MS);
        job_tick(b.jobs, clock_s());
        job_count(b.jobs, &st);
    }
    assert_int_equal(st.running[JOB_SLOW], THREADS);
    gate(&b, true);
    await(&b, &b.woken, SLOW + 2 + THREADS);
    bench_close(&b);
    bench_cost = NULL;
}

/* A stream that is behind with its part of the time gets picture after picture, although another's
 * long one waits each time. Then the long one begins, without a sign from the stream. */
static void test_long_work_waits_for_a_stream(void **state)
{
    enum { TRIES = 30, LONG_MS = 150, LATER_MS = 10, SHORT = 7000, LONG = 9009 };
    bool held = false;
    bench_cost = item_cost;
    for (int i = 0; i < TRIES && !held; i++) {
        struct bench b;
        bench_open(&b, 0, true, 8, 8);
        submit(&b, 0, JOB_MOTION, LONG);
        await(&b, &b.runs, 1);
        nap_ms(LONG_MS);
        gate(&b, true);
        await(&b, &b.woken, 1);
        submit(&b, 1, JOB_MOTION, SHORT);
        await(&b, &b.woken, 2);
        const double since_s = clock_s();
        submit(&b, 2, JOB_MOTION, LONG + 10);
        nap_ms(LATER_MS);
        submit(&b, 3, JOB_MOTION, SHORT + 1);
        const bool early = clock_s() - since_s < 0.04; /* else the wait may be over: again */
        await(&b, &b.woken, 4);
        held = early && b.order[2] == SHORT + 1 && b.order[3] == LONG + 10;
        assert_true(held || !early);
        bench_close(&b);
    }
    assert_true(held);
    bench_cost = NULL;
}

/* Several threads draw at the same time. Of what takes long one of them begins nothing, as long as
 * quick work comes; then all do. */
static void test_several_draw(void **state)
{
    enum { DRAW = 2, LONG = 4, TICK_MS = 100 };
    struct bench b;
    struct job_stats st = {0};
    bench_cost = item_cost;
    bench_open(&b, 0, DRAW, 100, 100);
    submit(&b, 0, JOB_VIEW, 1000);
    submit(&b, 1, JOB_MAP, 2000);
    await(&b, &b.runs, DRAW); /* both, at a closed gate */
    gate(&b, true);
    await(&b, &b.woken, DRAW);
    bool left = false;
    for (int i = 0; i < 20 && !left; i++) {
        gate(&b, false);
        b.runs = b.woken = 0;
        memset(b.c, 0, sizeof b.c);
        submit(&b, 0, JOB_MOTION, 50000 + 10 * i);
        const double since_s = clock_s();
        await(&b, &b.runs, 1);
        struct item *first = item_new(&b, 9000 + 100 * i + 9, ERR_OK, true); /* until it is left */
        assert_int_equal(ask(&b, &b.c[1], JOB_VIEW, first, 60), ERR_OK);
        await(&b, &b.runs, 2);
        for (int k = 2; k <= LONG; k++)
            submit(&b, k, JOB_VIEW, 1000 * k + 100 * i + 9);
        submit(&b, LONG + 1, JOB_VIEW, 60000 + 10 * i);
        gate(&b, true);
        await(&b, &b.runs, 3);
        const bool early = clock_s() - since_s < 0.9; /* else long work may begin: again */
        left = early && b.order[2] % 10 == 0;
        assert_true(left || !early);
        assert_true(job_leave(b.jobs, &b.c[1].w));
        await(&b, &b.woken, LONG + 1);
        for (int k = 0; k < LONG + 2; k++)
            body_drop(&b.c[k].w.result.body);
    }
    assert_true(left);
    gate(&b, false);
    b.runs = b.woken = 0;
    for (int i = 0; i < DRAW; i++)
        submit(&b, i, JOB_VIEW, 70009 + 1000 * i);
    for (int i = 0; i < 50 && st.running[JOB_VIEW] < DRAW; i++) {
        nap_ms(TICK_MS);
        job_count(b.jobs, &st);
    }
    assert_int_equal(st.running[JOB_VIEW], DRAW);
    gate(&b, true);
    await(&b, &b.woken, DRAW);
    bench_close(&b);
    bench_cost = NULL;
}

/* A thread that rests leaves all work to the others. */
static void test_a_drawer_rests(void **state)
{
    enum { PICTURES = 6 };
    struct bench b;
    struct job_stats st;
    bench_rests = first_rests;
    bench_open(&b, 0, 2, 100, 100);
    for (int i = 0; i < PICTURES; i++)
        submit(&b, i, JOB_VIEW, i);
    await(&b, &b.runs, 1);
    nap_ms(250); /* the other one has looked again */
    job_count(b.jobs, &st);
    assert_int_equal(st.running[JOB_VIEW], 1);
    gate(&b, true);
    await(&b, &b.woken, PICTURES);
    bench_close(&b);
    bench_rests = NULL;
}

static void test_a_full_queue_refuses(void **state)
{
    struct bench b;
    bench_open(&b, 2, false, 1, 8);
    size_t accepted = 0, refused = 0;
    for (int i = 0; i < 2; i++)
        accepted += ask(&b, &b.c[i], JOB_TILE, item_new(&b, i, ERR_OK, false), 60) == ERR_OK;
    await(&b, &b.runs, 2); /* both workers are held at the gate, the queue is empty */
    for (int i = 2; i < 40; i++) {
        enum err_code rc = ask(&b, &b.c[i], JOB_TILE, item_new(&b, i, ERR_OK, false), 60);
        accepted += !rc;
        refused += rc == ERR_BUSY;
        if (rc)
            assert_int_equal(b.c[i].w.result.end, JOB_SHED);
    }
    assert_int_equal(accepted, 10);
    assert_int_equal(refused, 30);
    assert_in_range(job_retry_after(b.jobs, JOB_TILE), 1, 10);
    gate(&b, true);
    await(&b, &b.woken, 10);
    bench_close(&b);
}

static void test_views_run_newest_first_and_shed_the_oldest(void **state)
{
    struct bench b;
    bench_open(&b, 1, true, 3, 8);
    submit(&b, 0, JOB_VIEW, 0);
    await(&b, &b.runs, 1);
    for (int i = 1; i < 6; i++) /* five ask, three fit: 1 and 2 make room */
        submit(&b, i, JOB_VIEW, i);
    await(&b, &b.woken, 2);
    assert_int_equal(b.c[1].w.result.end, JOB_SHED);
    assert_int_equal(b.c[2].w.result.end, JOB_SHED);
    gate(&b, true);
    await(&b, &b.woken, 6);
    const int want[] = {0, 5, 4, 3};
    assert_memory_equal(b.order, want, sizeof want);
    for (int i = 0; i < 6; i++)
        assert_int_equal(b.c[i].wakes, 1);
    bench_close(&b);
}

/* Numbers of a thousand and more belong to another client. One client fills the queue, a second one
 * asks once: he takes the place of the first one's oldest, which learns that it asked too much, and
 * his turn comes before the first one's. */
static void test_views_take_turns_between_clients(void **state)
{
    struct bench b;
    bench_open(&b, 1, true, 3, 8);
    submit(&b, 0, JOB_VIEW, 0);
    await(&b, &b.runs, 1);
    for (int i = 1; i < 4; i++)
        submit(&b, i, JOB_VIEW, i);
    submit(&b, 4, JOB_VIEW, 1000);
    await(&b, &b.woken, 1);
    assert_int_equal(b.c[1].w.result.end, JOB_SHED);
    assert_int_equal(b.c[1].w.result.code, ERR_BUSY); /* somebody else needed the room */
    submit(&b, 5, JOB_VIEW, 4);
    await(&b, &b.woken, 2);
    assert_int_equal(b.c[2].w.result.code, ERR_LIMIT); /* his own newer one did */
    gate(&b, true);
    await(&b, &b.woken, 6);
    const int want[] = {0, 1000, 4, 3};
    assert_memory_equal(b.order, want, sizeof want);
    bench_close(&b);
}

static void test_prefetch_runs_last_and_moves_up(void **state)
{
    struct bench b;
    bench_open(&b, 1, false, 1, 8);
    submit(&b, 0, JOB_TILE, 0);
    await(&b, &b.runs, 1);
    submit(&b, 1, JOB_PREFETCH, 1);
    submit(&b, 2, JOB_PREFETCH, 2);
    submit(&b, 3, JOB_TILE, 3);
    submit(&b, 4, JOB_TILE, 2);
    gate(&b, true);
    await(&b, &b.woken, 5);
    const int want[] = {0, 3, 2, 1};
    assert_memory_equal(b.order, want, sizeof want);
    bench_close(&b);
}

static void test_pictures_ahead_are_drawn_last_and_move_up(void **state)
{
    struct bench b;
    bench_open(&b, 1, true, 8, 8);
    submit(&b, 0, JOB_VIEW, 0);
    await(&b, &b.runs, 1);
    submit(&b, 1, JOB_AHEAD, 1);
    submit(&b, 2, JOB_AHEAD, 2);
    submit(&b, 3, JOB_MAP, 3);
    submit(&b, 4, JOB_VIEW, 2);
    gate(&b, true);
    await(&b, &b.woken, 5);
    const int want[] = {0, 3, 2, 1}; /* pictures and maps take turns */
    assert_memory_equal(b.order, want, sizeof want);
    bench_close(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_slow_work_leaves_a_thread),
        cmocka_unit_test(test_long_work_waits_for_a_stream),
        cmocka_unit_test(test_several_draw),
        cmocka_unit_test(test_a_drawer_rests),
        cmocka_unit_test(test_a_full_queue_refuses),
        cmocka_unit_test(test_views_run_newest_first_and_shed_the_oldest),
        cmocka_unit_test(test_views_take_turns_between_clients),
        cmocka_unit_test(test_prefetch_runs_last_and_moves_up),
        cmocka_unit_test(test_pictures_ahead_are_drawn_last_and_move_up),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
