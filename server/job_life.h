/* Slow work, away from the HTTP threads. A job is named by a 128-bit id: while it waits or runs,
 * everyone who asks for the same id becomes one more waiter of the same run (single flight). Queues
 * are bounded, and clients take turns in each (turn.c): when one is full, whoever has most in it
 * gives way. Map tiles and streams take turns with pictures on the thread that draws. New work also
 * takes one of its client's tokens (rate.c); joining and prefetched tiles that move up take none.
 * Prefetched tiles run when nothing else does and move up when somebody really asks.
 *
 * One mutex guards everything, and no callback but cfg.passing runs under it. Whoever takes a
 * waiter off a job under the lock (the worker that finished, job_leave, job_tick, job_stop) has
 * claimed it: waiter->job becomes NULL, and only the claimer wakes it. So each waiter is woken
 * exactly once, however those four race, and a job that ends in any way answers all its waiters,
 * because job_finish is the only end.
 *
 * job_run.c has the threads, job_ask.c those who ask, job_wait.c those who wait.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_JOB_LIFE_H
#define SERVER_JOB_LIFE_H

#include <pthread.h>

#include "core/pool.h"
#include "server/failure.h"
#include "server/job.h"
#include "server/rate.h"
#include "server/turn.h"

enum { JOB_TABLE = 1024 };

struct job {
    struct hash128 id;
    enum job_class cls;
    void *work;
    bool running;
    _Atomic bool cancel;
    struct job_waiter *waiters;
    struct job *table_next;
    struct turn_item place; /* in its queue */
    double queued_s, started_s;
};
struct job_thread {
    struct jobs *js;
    size_t index;
    struct pool_thread *thread;
};
struct jobs { /* all but cfg and workers by `lock` */
    struct job_config cfg;
    struct job_thread *workers; /* tile threads, then the view thread */
    size_t n_workers;
    pthread_mutex_t lock;
    pthread_cond_t tile_ready, view_ready;
    struct turns *queue[JOB_CLASSES];
    struct rate *rate[JOB_CLASSES]; /* NULL: that of JOB_TILE */
    struct job *table[JOB_TABLE];
    struct failures failures;
    enum job_class drew; /* the last that was drawn */
    bool stopping, drawer_ended;
    bool drawer_hangs;      /* of job_stop: it has been waited for */
    double drawing_since_s; /* 0: the thread that draws waits for work */
    pthread_cond_t ended;
    struct job_stats stats;
};

/* ---- under the lock ---- */

struct job **job_table_find(struct jobs *js, struct hash128 id); /* where it is, or would be */
void job_table_remove(struct jobs *js, struct job *j);
struct job *job_at(struct turn_item *it); /* NULL: of none */
bool job_is_drawn(enum job_class cls);
void job_queue_add(struct jobs *js, struct job *j, uint64_t client);
/* Take *p off its job and put it on the caller's list. */
void job_claim(struct job *j, struct job_waiter **p, const struct job_result *r,
               struct job_waiter **claimed);
/* A job that nobody waits for: the caller frees what comes back. */
struct job *job_abandon(struct jobs *js, struct job *j);

/* ---- not under the lock ---- */

void job_wake_all(struct job_waiter *w);
void job_free(struct jobs *js, struct job *j);
/* Claim every waiter whose deadline is before `before_s` (or everyone); jobs without waiters are
 * forgotten. */
void job_claim_where(struct jobs *js, double before_s, const struct job_result *r, bool everyone);

#endif
