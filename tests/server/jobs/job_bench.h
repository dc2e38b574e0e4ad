/* Jobs whose workers wait at a gate, so that the test decides the order of events, not the
 * scheduler.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_JOB_BENCH_H
#define TESTS_JOB_BENCH_H

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

static inline struct item *item_new(struct bench *b, int number, enum err_code fail, bool poll)
{
    struct item *it = mem_array(1, sizeof *it);
    assert_non_null(it);
    *it = (struct item){number, fail, poll};
    b->works++;
    return it;
}

static inline void item_drop(void *user, void *work)
{
    struct bench *b = user;
    pthread_mutex_lock(&b->lock);
    b->drops++;
    pthread_mutex_unlock(&b->lock);
    mem_free(work);
}

struct loop { /* of a job */
    struct bench *b;
    pthread_t own;
};

static inline enum err_code loop_run(void *user, size_t i, struct err *e)
{
    struct loop *l = user;
    (void)i, (void)e;
    if (!pthread_equal(l->own, pthread_self()))
        atomic_fetch_add(&l->b->elsewhere, 1);
    nap_ms(1); /* time for others to take some */
    return ERR_OK;
}

static inline enum err_code item_run(void *user, const struct job *j, void *work, size_t worker,
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

static inline void client_wake(struct job_waiter *w)
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
static inline double item_cost(const void *work, struct cost_kind *kind)
{
    const struct item *it = work;
    kind->variant = it->number % 10 == 9;
    return kind->variant ? 1000 : 10;
}

static bool (*bench_rests)(void *user, size_t drawer);

static inline bool first_rests(void *user, size_t drawer)
{
    (void)user;
    return drawer == 0;
}

static inline void bench_open(struct bench *b, size_t threads, size_t draws, size_t view_limit,
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

static inline void bench_close(struct bench *b)
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

static inline void gate(struct bench *b, bool open)
{
    pthread_mutex_lock(&b->lock);
    b->gate_open = open;
    pthread_cond_broadcast(&b->changed);
    pthread_mutex_unlock(&b->lock);
}

/* Wait (10 s at most: far above anything but a hang) until *count >= want. */
static inline void await(struct bench *b, const size_t *count, size_t want)
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

static inline struct hash128 id_of(int number)
{
    return hash_bytes(&number, sizeof number);
}

static inline enum err_code ask(struct bench *b, struct client *c, enum job_class cls,
                                struct item *it, double timeout_s)
{
    c->b = b;
    c->w.wake = client_wake;
    return job_submit(b->jobs, cls, id_of(it->number), it, (uint64_t)it->number / 1000, timeout_s,
                      &c->w);
}

/* Client i asks, and is taken. */
static inline void submit(struct bench *b, int i, enum job_class cls, int number)
{
    assert_int_equal(ask(b, &b->c[i], cls, item_new(b, number, ERR_OK, false), 60), ERR_OK);
}

#endif
