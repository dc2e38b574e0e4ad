/* Internals of jobs.
 *
 * A job is named by a 128-bit id. While it waits or runs, every request for the same id becomes a
 * waiter of the same run (single flight). Clients have equal parts of the time of each queue
 * (fair_queue.c), and queues of one thread have equal parts of its time. What work takes is learned
 * (cost.c). Work is refused if it would wait longer than its deadline. Queues are limited as well:
 * if one is full, the client with most items in it loses one. New work takes one of its client's
 * tokens (rate.c). Requests that join a job and prefetched tiles that move up take none. Prefetched
 * tiles run when nothing else does, and move up when a client requests them.
 *
 * A stream asks for its next picture when the one before was sent. Long work of other clients would
 * begin in each such gap, and take nearly all the time. So if the stream that was drawn last has
 * had less than its part of the time, the thread that draws waits a moment for its next picture
 * before it begins long work. Where several draw, one of them is kept free for quick work instead
 * (job_run.c).
 *
 * One mutex guards everything. Of all callbacks only cfg.passing and cfg.cost are called with it
 * held. A waiter is taken off its job with the lock held, by job_leave, job_tick, job_stop or the
 * worker that finished. This claims the waiter: waiter->job becomes NULL, and only the claimer
 * wakes it. Each waiter is thus woken exactly once, however these four race. job_finish is the only
 * end of a job, so all waiters get an answer.
 *
 * job_run.c has the threads, job_ask.c the requests, job_wait.c the waiters.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_JOB_LIFE_H
#define SERVER_JOB_LIFE_H

#include <pthread.h>

#include "core/pool.h"
#include "server/jobs/failure.h"
#include "server/jobs/fair_queue.h"
#include "server/jobs/job.h"
#include "server/jobs/rate.h"

enum { JOB_TABLE = 1024 };
#define JOB_LONG_MS 40.0 /* predicted */
#define JOB_QUICK_S 1.0  /* quick work is waited for so long after the last of it */

struct job {
    struct hash128 id;
    enum job_class cls;
    void *work;
    bool running;
    size_t drawer;    /* while it is drawn */
    bool counts_long; /* in jobs.long_drawn */
    _Atomic bool cancel;
    struct job_waiter *waiters;
    struct job *table_next;
    struct fair_queue_item place; /* position in its queue */
    uint64_t client;              /* whose time it takes */
    struct cost_kind kind;        /* see job_config.cost */
    double expected_ms, predicted_ms;
    double queued_s, started_s;
};
enum job_duty { JOB_ENCODES, JOB_DRAWS, JOB_WAITS, JOB_DUTIES }; /* of a thread */
struct job_thread {
    struct jobs *js;
    enum job_duty duty;
    size_t index; /* of those with this duty */
    struct pool_thread *thread;
    double since_s; /* when it began its work, or its start; 0: it waits for work */
    bool ended;
};
struct jobs { /* `lock` guards all except cfg */
    struct job_config cfg;
    struct job_thread *workers; /* tile threads, those that draw, the one for errands */
    size_t n_workers;
    pthread_mutex_t lock;
    pthread_cond_t tile_ready, view_ready, errand_ready;
    struct fair_queue *queue[JOB_CLASSES];
    struct rate *rate[JOB_CLASSES]; /* NULL: that of JOB_TILE is used */
    struct job *table[JOB_TABLE];
    struct failures failures;
    struct cost cost;
    double quick_s; /* when quick work was last asked for: JOB_TILE that is not slow */
    /* For the threads that draw: when quick work was last requested, and the time of the quickest.
     * Work that takes several times as long counts as long, so a slow machine does not change what
     * is long. */
    double quick_drawn_s, quickest_ms;
    size_t long_drawn; /* long work that is being drawn */
    /* Virtual clock of each class: thread time that it used; a class that begins to wait starts at
     * now_ms at least. The class with the least clock is next. now_ms, of each duty: clock of the
     * class that was served last, before that. */
    double class_ms[JOB_CLASSES], now_ms[JOB_DUTIES];
    /* The stream that was drawn last, and when. Its next picture is asked for in a moment. */
    uint64_t stream;
    double stream_s;
    bool stopping;
    bool drawer_hangs; /* set by job_stop: waiting for them failed */
    pthread_cond_t ended;
    struct job_stats stats;
};

/* ---- with the lock held ---- */

/* place of a job in the table, or place to insert it */
struct job **job_table_find(struct jobs *js, struct hash128 id);
void job_table_remove(struct jobs *js, struct job *j);
struct job *job_at(struct fair_queue_item *it); /* NULL: `it` is NULL */
enum job_duty job_duty_of(enum job_class cls);
bool job_is_drawn(enum job_class cls);
/* Predicted time from which work that is drawn counts as long: one thread does not take it. */
double job_long_ms(const struct jobs *js);
void job_queue_add(struct jobs *js, struct job *j, uint64_t client);
/* Takes *p off its job and adds it to the caller's list. */
void job_claim(struct job *j, struct job_waiter **p, const struct job_result *r,
               struct job_waiter **claimed);
/* Removes a job without waiters. The caller frees the returned job, if any. */
struct job *job_abandon(struct jobs *js, struct job *j);

/* ---- without the lock ---- */

void job_wake_all(struct job_waiter *w);
void job_free(struct jobs *js, struct job *j);
/* Claims every waiter whose deadline is before `before_s`, or all of them. Jobs without waiters are
 * dropped. */
void job_claim_where(struct jobs *js, double before_s, const struct job_result *r, bool everyone);

#endif
