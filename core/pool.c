/* Threads: a parallel loop that hands out indices in order, and a background thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/pool.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "core/base.h"
#include "core/trace.h"

enum { POOL_THREADS_MAX = 256 };

struct pool_loop {
    size_t n;
    enum err_code (*fn)(void *user, size_t i, struct err *e);
    void *user;
    pthread_mutex_t lock; /* guards all below */
    size_t next, workers;
    size_t failed_i; /* lowest failed index, n when none */
    struct err first;
};

/* Tracks of a trace; workers beyond the last share it. */
static const char *const pool_tracks[] = {"host 1", "host 2", "host 3", "host 4",
                                          "host 5", "host 6", "host 7", "host 8"};

static void pool_trace(struct pool_loop *l, double from_s)
{
    enum { LAST = sizeof pool_tracks / sizeof *pool_tracks - 1 };
    pthread_mutex_lock(&l->lock);
    size_t k = l->workers++;
    pthread_mutex_unlock(&l->lock);
    trace_span(pool_tracks[k < LAST ? k : LAST], "loop", from_s, clock_s());
}

static void *pool_worker(void *arg)
{
    struct pool_loop *l = arg;
    double start_s = trace_on() ? clock_s() : 0.0;
    for (;;) {
        pthread_mutex_lock(&l->lock);
        size_t i = l->first.code == ERR_OK && l->next < l->n ? l->next++ : l->n;
        pthread_mutex_unlock(&l->lock);
        if (i == l->n) {
            if (trace_on())
                pool_trace(l, start_s);
            return NULL;
        }
        struct err e = {0};
        enum err_code rc = l->fn(l->user, i, &e);
        if (!rc)
            continue;
        pthread_mutex_lock(&l->lock);
        if (i < l->failed_i) {
            l->failed_i = i;
            l->first = e;
            l->first.code = rc;
        }
        pthread_mutex_unlock(&l->lock);
    }
}

static size_t pool_most; /* 0 = one a core */
static _Thread_local bool pool_is_alone;

void pool_alone(void)
{
    pool_is_alone = true;
}

void pool_limit(size_t threads)
{
    char text[32];
    pool_most = threads;
    if (!threads)
        return;
    /* PoCL asks the machine, not the process, how many cores there are; what a user set stays.
     * The first name is PoCL's up to 4, the second one's from 5 on. */
    snprintf(text, sizeof text, "%zu", threads);
    (void)setenv("POCL_MAX_PTHREAD_COUNT", text, 0);
    (void)setenv("POCL_CPU_MAX_CU_COUNT", text, 0);
}

size_t pool_cores(void)
{
    if (pool_most)
        return pool_most;
    long n = sysconf(_SC_NPROCESSORS_ONLN);
    return n > 0 ? (size_t)n : 1;
}

enum err_code pool_for(size_t n, size_t threads,
                       enum err_code (*fn)(void *user, size_t i, struct err *e), void *user,
                       struct err *e)
{
    if (!threads)
        threads = pool_cores();
    if (threads > n)
        threads = n;
    if (pool_is_alone)
        threads = 1;
    if (threads > POOL_THREADS_MAX)
        threads = POOL_THREADS_MAX;
    struct pool_loop l = {.n = n, .fn = fn, .user = user, .failed_i = n};
    pthread_mutex_init(&l.lock, NULL);
    pthread_t id[POOL_THREADS_MAX];
    size_t started = 0;
    /* The caller is one of the threads; if no other can be started it does all the work alone. */
    while (started + 1 < threads && !pthread_create(&id[started], NULL, pool_worker, &l))
        started++;
    pool_worker(&l);
    for (size_t i = 0; i < started; i++)
        pthread_join(id[i], NULL);
    pthread_mutex_destroy(&l.lock);
    if (l.first.code != ERR_OK)
        return err_set(e, l.first.code, "%s", l.first.msg);
    return ERR_OK;
}

struct pool_thread {
    pthread_t id;
    void (*fn)(void *user);
    void *user;
};

static void *pool_thread_main(void *arg)
{
    struct pool_thread *t = arg;
    t->fn(t->user);
    return NULL;
}

enum err_code pool_start(void (*fn)(void *user), void *user, struct pool_thread **out,
                         struct err *e)
{
    struct pool_thread *t = mem_array(1, sizeof *t);
    if (!t)
        return err_set(e, ERR_MEM, "out of memory for a thread");
    t->fn = fn;
    t->user = user;
    if (pthread_create(&t->id, NULL, pool_thread_main, t)) {
        mem_free(t);
        return err_set(e, ERR_MEM, "cannot start a thread");
    }
    *out = t;
    return ERR_OK;
}

void pool_cond_init(pthread_cond_t *c)
{
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(c, &monotonic);
    pthread_condattr_destroy(&monotonic);
}

bool pool_cond_wait(pthread_cond_t *c, pthread_mutex_t *lock, double end_s)
{
    struct timespec end;
    double wait_s = fmax(end_s - clock_s(), 0);
    clock_gettime(CLOCK_MONOTONIC, &end);
    long ns = end.tv_nsec + (long)(fmod(wait_s, 1) * 1e9);
    end.tv_sec += (time_t)wait_s + ns / 1000000000;
    end.tv_nsec = ns % 1000000000;
    return !pthread_cond_timedwait(c, lock, &end);
}

void pool_join(struct pool_thread **t)
{
    if (!*t)
        return;
    pthread_join((*t)->id, NULL);
    mem_free(*t);
    *t = NULL;
}
