/* Jobs: one run for identical requests, and every waiter is woken exactly once in all cases:
 * errors, leaving, deadlines, the end. Which job runs next: test_job_order.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/jobs/job_bench.h"

static void test_identical_requests_share_a_run(void **state)
{
    struct bench b;
    bench_open(&b, 2, false, 1, 8);
    for (int i = 0; i < WAITERS; i++)
        submit(&b, i, JOB_TILE, 7);
    gate(&b, true);
    await(&b, &b.woken, WAITERS);
    assert_int_equal(b.runs, 1);
    size_t coalesced = 0;
    for (int i = 0; i < WAITERS; i++) {
        assert_int_equal(b.c[i].wakes, 1);
        assert_int_equal(b.c[i].w.result.end, JOB_OK);
        assert_ptr_equal(b.c[i].w.result.body, b.c[0].w.result.body);
        coalesced += b.c[i].w.result.coalesced;
    }
    assert_int_equal(coalesced, WAITERS - 1);
    assert_memory_equal(b.c[0].w.result.body->data, "made 7", 6);
    bench_close(&b);
}

static void test_errors_reach_every_waiter(void **state)
{
    static const enum err_code errors[] = {ERR_FORMAT, ERR_MEM,   ERR_IO,
                                           ERR_DEVICE, ERR_LIMIT, ERR_BUSY};
    struct bench b;
    bench_open(&b, 2, false, 1, 8);
    for (size_t k = 0; k < sizeof errors / sizeof *errors; k++) {
        memset(b.c, 0, sizeof b.c);
        b.woken = 0;
        gate(&b, false);
        int number = 100 + (int)k;
        for (int i = 0; i < WAITERS; i++)
            assert_int_equal(ask(&b, &b.c[i], JOB_TILE, item_new(&b, number, errors[k], false), 60),
                             ERR_OK);
        gate(&b, true);
        await(&b, &b.woken, WAITERS);
        for (int i = 0; i < WAITERS; i++) {
            assert_int_equal(b.c[i].wakes, 1);
            assert_int_equal(b.c[i].w.result.end, JOB_ERROR);
            assert_int_equal(b.c[i].w.result.code, errors[k]);
            assert_null(b.c[i].w.result.body);
            kit_expect_text(b.c[i].w.result.msg, "fails with", __FILE__, __LINE__);
        }
    }
    bench_close(&b);
}

/* Fifty clients at once with one request each all wait: the wait is below their deadline. One that
 * asks for more than its part of the time can make until its deadline is refused, is told when to
 * ask again, and refuses nobody else. */
static void test_the_wait_decides(void **state)
{
    enum { MANY = 50, DEAR = 20 };
    struct bench b;
    int refused = 0;
    bench_cost = item_cost;
    bench_open(&b, 1, false, 1, 1000);
    for (int i = 0; i < MANY; i++)
        submit(&b, i, JOB_TILE, 1000 * (i + 1));
    for (int i = MANY; i < MANY + DEAR; i++) {
        struct client *c = &b.c[i];
        enum err_code rc =
            ask(&b, c, JOB_TILE, item_new(&b, 99000 + 10 * (i - MANY) + 9, ERR_OK, false), 6);
        refused += rc == ERR_BUSY;
        if (rc) {
            assert_int_equal(c->w.result.end, JOB_SHED);
            assert_in_range(c->w.result.retry_s, 1, 60);
        }
    }
    assert_in_range(refused, DEAR - 7, DEAR - 2);
    submit(&b, MANY + DEAR, JOB_TILE, 77000);
    gate(&b, true);
    await(&b, &b.woken, (size_t)(MANY + DEAR + 1 - refused));
    for (int i = 0; i < MANY; i++)
        assert_int_equal(b.c[i].w.result.end, JOB_OK);
    bench_close(&b);
    bench_cost = NULL;
}

/* A failure is remembered for a moment, then tried again; one that memory caused is not remembered.
 */
static void test_failures_are_remembered(void **state)
{
    struct bench b;
    struct client c = {0};
    bench_open(&b, 1, false, 1, 8);
    gate(&b, true);
    assert_int_equal(ask(&b, &c, JOB_TILE, item_new(&b, 1, ERR_FORMAT, false), 60), ERR_OK);
    await(&b, &b.woken, 1);
    assert_int_equal(ask(&b, &c, JOB_TILE, item_new(&b, 1, ERR_FORMAT, false), 60), ERR_FORMAT);
    assert_int_equal(c.w.result.end, JOB_ERROR);
    kit_expect_text(c.w.result.msg, "number 1 fails", __FILE__, __LINE__);
    assert_int_equal(b.runs, 1);
    nap_ms(250);
    assert_int_equal(ask(&b, &c, JOB_TILE, item_new(&b, 1, ERR_OK, false), 60), ERR_OK);
    await(&b, &b.woken, 2);
    assert_int_equal(c.w.result.end, JOB_OK);
    body_drop(&c.w.result.body);
    assert_int_equal(ask(&b, &c, JOB_TILE, item_new(&b, 2, ERR_MEM, false), 60), ERR_OK);
    await(&b, &b.woken, 3);
    assert_int_equal(ask(&b, &c, JOB_TILE, item_new(&b, 2, ERR_OK, false), 60), ERR_OK);
    await(&b, &b.woken, 4);
    assert_int_equal(c.w.result.end, JOB_OK);
    body_drop(&c.w.result.body);
    bench_close(&b);
}

static void test_leaving(void **state)
{
    struct bench b;
    struct job_stats st;
    bench_open(&b, 1, true, 4, 8);
    /* a running picture is told to stop when its last client leaves, not before */
    assert_int_equal(ask(&b, &b.c[0], JOB_VIEW, item_new(&b, 0, ERR_OK, true), 60), ERR_OK);
    assert_int_equal(ask(&b, &b.c[1], JOB_VIEW, item_new(&b, 0, ERR_OK, true), 60), ERR_OK);
    await(&b, &b.runs, 1);
    assert_true(job_leave(b.jobs, &b.c[0].w));
    assert_false(job_leave(b.jobs, &b.c[0].w)); /* once */
    nap_ms(20);
    assert_int_equal(b.cancelled_seen, 0);
    assert_true(job_leave(b.jobs, &b.c[1].w));
    await(&b, &b.cancelled_seen, 1);
    assert_int_equal(b.c[0].w.result.end, JOB_CANCELLED);
    assert_int_equal(b.woken, 0); /* who leaves is not woken */
    /* a queued tile is forgotten, a running one is finished for the cache */
    submit(&b, 2, JOB_TILE, 2);
    await(&b, &b.runs, 2);
    submit(&b, 3, JOB_TILE, 3);
    assert_true(job_leave(b.jobs, &b.c[3].w));
    assert_true(job_leave(b.jobs, &b.c[2].w));
    gate(&b, true);
    for (int i = 0; i < 500 && !job_idle(b.jobs); i++)
        nap_ms(10);
    job_count(b.jobs, &st);
    assert_int_equal(st.ended[JOB_TILE][JOB_OK], 1);
    assert_int_equal(st.ended[JOB_TILE][JOB_CANCELLED], 1);
    assert_int_equal(st.ended[JOB_VIEW][JOB_CANCELLED], 1);
    assert_int_equal(b.runs, 2);
    bench_close(&b);
}

static bool item_passing(const void *work)
{
    return ((const struct item *)work)->poll;
}

/* A question whose answer is not kept is told to stop as well; a map tile is finished. */
static void test_passing_work_is_cancelled(void **state)
{
    struct bench b;
    struct job_stats st;
    bench_passing = item_passing;
    bench_open(&b, 1, true, 4, 8);
    bench_passing = NULL;
    assert_int_equal(ask(&b, &b.c[0], JOB_MAP, item_new(&b, 0, ERR_OK, true), 60), ERR_OK);
    await(&b, &b.runs, 1);
    assert_true(job_leave(b.jobs, &b.c[0].w));
    await(&b, &b.cancelled_seen, 1);
    submit(&b, 1, JOB_MAP, 1);
    await(&b, &b.runs, 2);
    assert_true(job_leave(b.jobs, &b.c[1].w));
    gate(&b, true);
    for (int i = 0; i < 500 && !job_idle(b.jobs); i++)
        nap_ms(10);
    job_count(b.jobs, &st);
    assert_int_equal(st.ended[JOB_MAP][JOB_CANCELLED], 1);
    assert_int_equal(st.ended[JOB_MAP][JOB_OK], 1);
    bench_close(&b);
}

/* Nobody joins a picture that was told to stop. */
static void test_a_cancelled_view_is_not_shared(void **state)
{
    struct bench b;
    bench_open(&b, 1, true, 4, 8);
    gate(&b, true);
    assert_int_equal(ask(&b, &b.c[0], JOB_VIEW, item_new(&b, 0, ERR_OK, true), 60), ERR_OK);
    await(&b, &b.runs, 1);
    assert_true(job_leave(b.jobs, &b.c[0].w));
    submit(&b, 1, JOB_VIEW, 0);
    await(&b, &b.woken, 1);
    assert_int_equal(b.c[1].w.result.end, JOB_OK);
    bench_close(&b);
}

static void test_deadlines(void **state)
{
    struct bench b;
    bench_open(&b, 1, false, 1, 8);
    assert_int_equal(ask(&b, &b.c[0], JOB_TILE, item_new(&b, 0, ERR_OK, false), 5), ERR_OK);
    await(&b, &b.runs, 1);
    assert_int_equal(ask(&b, &b.c[1], JOB_TILE, item_new(&b, 0, ERR_OK, false), 50), ERR_OK);
    assert_int_equal(ask(&b, &b.c[2], JOB_TILE, item_new(&b, 2, ERR_OK, false), 5), ERR_OK);
    job_tick(b.jobs, clock_s());
    assert_int_equal(b.woken, 0);
    job_tick(b.jobs, clock_s() + 6);
    assert_int_equal(b.woken, 2); /* the run goes on for the one who waits longer */
    assert_int_equal(b.c[0].w.result.end, JOB_TIMEOUT);
    assert_int_equal(b.c[2].w.result.end, JOB_TIMEOUT);
    gate(&b, true);
    await(&b, &b.woken, 3);
    assert_int_equal(b.c[1].w.result.end, JOB_OK);
    assert_int_equal(b.runs, 1); /* the other was dropped from the queue */
    bench_close(&b);
}

static void test_stopping_answers_everyone(void **state)
{
    struct bench b;
    bench_open(&b, 1, true, 4, 16);
    assert_int_equal(ask(&b, &b.c[0], JOB_VIEW, item_new(&b, 0, ERR_OK, true), 60), ERR_OK);
    await(&b, &b.runs, 1);
    for (int i = 1; i < 5; i++)
        assert_int_equal(ask(&b, &b.c[i], JOB_VIEW, item_new(&b, i, ERR_OK, true), 60), ERR_OK);
    gate(&b, true);
    job_stop(b.jobs);
    assert_int_equal(b.woken, 5);
    for (int i = 0; i < 5; i++) {
        assert_int_equal(b.c[i].wakes, 1);
        assert_int_equal(b.c[i].w.result.end, JOB_SHED);
    }
    assert_int_equal(ask(&b, &b.c[5], JOB_TILE, item_new(&b, 9, ERR_OK, false), 60), ERR_BUSY);
    bench_close(&b);
}

/* A picture that does not return and takes no notice of being told to stop: it is known how long
 * that has lasted, everyone is answered, and stopping gives up; when it returns after all,
 * everything ends. */
static void test_a_device_that_hangs(void **state)
{
    struct bench b;
    struct err e = {0};
    bench_open(&b, 1, false, 4, 8); /* for its locks */
    assert_true(job_close(&b.jobs));
    const struct job_config cfg = {.tile_threads = 1,
                                   .draw_threads = 1,
                                   .queue_limit = {4, 4, 4, 4},
                                   .stop_s = 1,
                                   .user = &b,
                                   .run = item_run,
                                   .drop = item_drop};
    kit_ok(job_open(&cfg, &b.jobs, &e), e);
    for (int i = 0; i < 500 && job_drawing_s(b.jobs) > 0; i++)
        nap_ms(10); /* the thread starts */
    assert_true(job_drawing_s(b.jobs) == 0);
    submit(&b, 0, JOB_VIEW, 0);
    await(&b, &b.runs, 1);
    submit(&b, 1, JOB_VIEW, 1);
    nap_ms(50);
    assert_true(job_drawing_s(b.jobs) >= 0.05);
    double start_s = clock_s();
    assert_false(job_close(&b.jobs));
    assert_true(clock_s() - start_s >= 1 && clock_s() - start_s < 5);
    start_s = clock_s();
    assert_false(job_stop(b.jobs)); /* as services_free does after http_close: not as long again */
    assert_true(clock_s() - start_s < 0.9);
    assert_int_equal(b.woken, 2);
    assert_int_equal(b.c[0].w.result.end, JOB_SHED);
    assert_non_null(b.jobs);
    bench_close(&b); /* opens the gate */
    assert_null(b.jobs);
}

/* Four threads ask, leave and let deadlines pass at random: every client ends exactly once. */
struct storm {
    struct bench *b;
    struct client *c;
    size_t per_thread;
};

static enum err_code storm_run(void *user, size_t t, struct err *e)
{
    struct storm *s = user;
    for (size_t i = 0; i < s->per_thread; i++) {
        struct client *c = &s->c[t * s->per_thread + i];
        uint64_t dice = rng_u64(5, t, i);
        struct item *it = mem_array(1, sizeof *it);
        if (!it)
            return err_set(e, ERR_MEM, "storm");
        *it = (struct item){(int)(dice % 17), dice % 5 ? ERR_OK : ERR_MEM, false};
        c->b = s->b;
        c->w.wake = client_wake;
        enum job_class cls = (enum job_class)(dice / 17 % JOB_CLASSES);
        double timeout_s = dice >> 20 & 1 ? 0.001 : 60;
        if (job_submit(s->b->jobs, cls, id_of((int)(dice % 17)), it, (uint64_t)(uintptr_t)c % 3,
                       timeout_s, &c->w) != ERR_OK ||
            ((dice >> 21 & 1) && job_leave(s->b->jobs, &c->w)))
            client_wake(&c->w);
        if (i % 16 == 0)
            job_tick(s->b->jobs, clock_s());
    }
    return ERR_OK;
}

static void test_storm(void **state)
{
    enum { THREADS = 4, EACH = 500 };
    struct bench b;
    struct err e = {0};
    struct client *c = mem_array(THREADS * EACH, sizeof *c);
    assert_non_null(c);
    bench_open(&b, 2, true, 4, 16);
    gate(&b, true);
    struct storm s = {&b, c, EACH};
    kit_ok(pool_for(THREADS, THREADS, storm_run, &s, &e), e);
    await(&b, &b.woken, THREADS * EACH);
    for (size_t i = 0; i < THREADS * EACH; i++) {
        assert_int_equal(c[i].wakes, 1);
        body_drop(&c[i].w.result.body);
    }
    b.works = THREADS * EACH;
    bench_close(&b);
    mem_free(c);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_identical_requests_share_a_run),
        cmocka_unit_test(test_errors_reach_every_waiter),
        cmocka_unit_test(test_the_wait_decides),
        cmocka_unit_test(test_failures_are_remembered),
        cmocka_unit_test(test_leaving),
        cmocka_unit_test(test_passing_work_is_cancelled),
        cmocka_unit_test(test_a_cancelled_view_is_not_shared),
        cmocka_unit_test(test_deadlines),
        cmocka_unit_test(test_stopping_answers_everyone),
        cmocka_unit_test(test_a_device_that_hangs),
        cmocka_unit_test(test_storm),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
