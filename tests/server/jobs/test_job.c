/* Jobs: one run for identical requests, bounded queues, and every waiter is woken exactly once in
 * all cases. Workers wait at a gate, so the test decides the order of events, not the scheduler. It
 * is one long file, because all of it uses that gate.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "core/pool.h"
#include "server/jobs/job.h"

enum { WAITERS = 100 };

struct bench;
struct client {
    struct job_waiter w;
    struct bench *b;
    int wakes;
};
struct bench { /* what the test and the jobs share */
    pthread_mutex_t lock;
    pthread_cond_t changed;
    bool gate_open;
    _Atomic size_t elsewhere; /* loops of jobs that ran on another thread than the job's */
    size_t tile_threads, runs, drops, works, woken, cancelled_seen;
    int order[64]; /* numbers of works in the order they began */
    struct jobs *jobs;
    struct client c[WAITERS];
};
struct item { /* the work */
    int number;
    enum err_code fail;
    bool poll; /* run until cancelled */
};

static struct item *item_new(struct bench *b, int number, enum err_code fail, bool poll)
{
    struct item *it = mem_array(1, sizeof *it);
    assert_non_null(it);
    *it = (struct item){number, fail, poll};
    b->works++;
    return it;
}

static void item_drop(void *user, void *work)
{
    struct bench *b = user;
    pthread_mutex_lock(&b->lock);
    b->drops++;
    pthread_mutex_unlock(&b->lock);
    mem_free(work);
}

static void nap_ms(long ms)
{
    const struct timespec t = {.tv_nsec = ms * 1000000};
    nanosleep(&t, NULL);
}

struct loop { /* of a job */
    struct bench *b;
    pthread_t own;
};

static enum err_code loop_run(void *user, size_t i, struct err *e)
{
    struct loop *l = user;
    (void)i, (void)e;
    if (!pthread_equal(l->own, pthread_self()))
        atomic_fetch_add(&l->b->elsewhere, 1);
    nap_ms(1); /* time for others to take some */
    return ERR_OK;
}

static enum err_code item_run(void *user, const struct job *j, void *work, size_t worker,
                              struct body **out, struct err *e)
{
    struct bench *b = user;
    const struct item *it = work;
    pthread_mutex_lock(&b->lock);
    if (b->runs < 64)
        b->order[b->runs] = it->number;
    b->runs++;
    pthread_cond_broadcast(&b->changed);
    while (!b->gate_open && !it->poll)
        pthread_cond_wait(&b->changed, &b->lock);
    pthread_mutex_unlock(&b->lock);
    if (it->poll) {
        while (!job_cancelled(j))
            nap_ms(1);
        pthread_mutex_lock(&b->lock);
        b->cancelled_seen++;
        pthread_cond_broadcast(&b->changed);
        pthread_mutex_unlock(&b->lock);
        return err_set(e, ERR_CANCEL, "cancelled");
    }
    if (it->fail != ERR_OK)
        return err_set(e, it->fail, "number %d fails with %s", it->number, kit_err(it->fail));
    struct loop loop = {b, pthread_self()};
    enum err_code rc = worker < b->tile_threads ? pool_for(4, 4, loop_run, &loop, e) : ERR_OK;
    if (rc)
        return rc;
    char text[32];
    snprintf(text, sizeof text, "made %d", it->number);
    *out = body_text(text);
    return *out ? ERR_OK : err_set(e, ERR_MEM, "no body");
}

static void client_wake(struct job_waiter *w)
{
    struct client *c = (struct client *)(void *)w;
    struct bench *b = c->b;
    pthread_mutex_lock(&b->lock);
    c->wakes++;
    b->woken++;
    pthread_cond_broadcast(&b->changed);
    pthread_mutex_unlock(&b->lock);
}

static bool (*bench_passing)(const void *work); /* of the benches opened next */
static double (*bench_cost)(const void *work, struct cost_kind *kind);

/* 10 ms, and a second for numbers whose last digit is 9. */
static double item_cost(const void *work, struct cost_kind *kind)
{
    const struct item *it = work;
    kind->variant = it->number % 10 == 9;
    return kind->variant ? 1000 : 10;
}

static bool (*bench_rests)(void *user, size_t drawer);

static bool first_rests(void *user, size_t drawer)
{
    (void)user;
    return drawer == 0;
}

static void bench_open(struct bench *b, size_t threads, size_t draws, size_t view_limit,
                       size_t tile_limit)
{
    struct err e = {0};
    memset(b, 0, sizeof *b);
    b->tile_threads = threads;
    pthread_mutex_init(&b->lock, NULL);
    pthread_cond_init(&b->changed, NULL);
    const struct job_config cfg = {
        .tile_threads = threads,
        .draw_threads = draws,
        .rests = bench_rests,
        .queue_limit = {view_limit, tile_limit, tile_limit, tile_limit, tile_limit, view_limit},
        .slow_s = 0.2,
        .user = b,
        .run = item_run,
        .drop = item_drop,
        .passing = bench_passing,
        .cost = bench_cost,
    };
    kit_ok(job_open(&cfg, &b->jobs, &e), e);
}

static void bench_close(struct bench *b)
{
    pthread_mutex_lock(&b->lock);
    b->gate_open = true;
    pthread_cond_broadcast(&b->changed);
    pthread_mutex_unlock(&b->lock);
    job_close(&b->jobs);
    for (int i = 0; i < WAITERS; i++)
        body_drop(&b->c[i].w.result.body);
    assert_int_equal(b->elsewhere, 0);
    assert_int_equal(b->drops, b->works); /* no work leaks, none is freed twice */
    pthread_cond_destroy(&b->changed);
    pthread_mutex_destroy(&b->lock);
}

static void gate(struct bench *b, bool open)
{
    pthread_mutex_lock(&b->lock);
    b->gate_open = open;
    pthread_cond_broadcast(&b->changed);
    pthread_mutex_unlock(&b->lock);
}

/* Wait (10 s at most: far above anything but a hang) until *count >= want. */
static void await(struct bench *b, const size_t *count, size_t want)
{
    struct timespec end;
    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 10;
    pthread_mutex_lock(&b->lock);
    int rc = 0;
    while (*count < want && rc == 0)
        rc = pthread_cond_timedwait(&b->changed, &b->lock, &end);
    size_t got = *count;
    pthread_mutex_unlock(&b->lock);
    if (got < want)
        fail_msg("waited 10 s: %zu of %zu", got, want);
}

static struct hash128 id_of(int number)
{
    return hash_bytes(&number, sizeof number);
}

static enum err_code ask(struct bench *b, struct client *c, enum job_class cls, struct item *it,
                         double timeout_s)
{
    c->b = b;
    c->w.wake = client_wake;
    return job_submit(b->jobs, cls, id_of(it->number), it, (uint64_t)it->number / 1000, timeout_s,
                      &c->w);
}

/* Client i asks, and is taken. */
static void submit(struct bench *b, int i, enum job_class cls, int number)
{
    assert_int_equal(ask(b, &b->c[i], cls, item_new(b, number, ERR_OK, false), 60), ERR_OK);
}

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
        cmocka_unit_test(test_slow_work_leaves_a_thread),
        cmocka_unit_test(test_several_draw),
        cmocka_unit_test(test_a_drawer_rests),
        cmocka_unit_test(test_long_work_waits_for_a_stream),
        cmocka_unit_test(test_failures_are_remembered),
        cmocka_unit_test(test_a_full_queue_refuses),
        cmocka_unit_test(test_views_run_newest_first_and_shed_the_oldest),
        cmocka_unit_test(test_views_take_turns_between_clients),
        cmocka_unit_test(test_prefetch_runs_last_and_moves_up),
        cmocka_unit_test(test_pictures_ahead_are_drawn_last_and_move_up),
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
