/* Jobs and their waiters: the table of jobs, and all ways in which a waiter leaves one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/job_life.h"

#include <assert.h>
#include <math.h>

/* ---- under the lock ---- */

static bool job_same(struct hash128 a, struct hash128 b)
{
    return a.lo == b.lo && a.hi == b.hi;
}

struct job **job_table_find(struct jobs *js, struct hash128 id)
{
    struct job **p = &js->table[id.lo % JOB_TABLE];
    while (*p && !job_same((*p)->id, id))
        p = &(*p)->table_next;
    return p;
}

struct job *job_at(struct fair_queue_item *it)
{
    return it ? (struct job *)(void *)((char *)it - offsetof(struct job, place)) : NULL;
}

enum job_duty job_duty_of(enum job_class cls)
{
    switch (cls) {
    case JOB_VIEW:
    case JOB_MAP:
    case JOB_MOTION:
    case JOB_AHEAD:
        return JOB_DRAWS;
    case JOB_ERRAND:
        return JOB_WAITS;
    default:
        return JOB_ENCODES;
    }
}

bool job_is_drawn(enum job_class cls)
{
    return job_duty_of(cls) == JOB_DRAWS;
}

bool job_is_picture(enum job_class cls)
{
    return cls == JOB_VIEW || cls == JOB_AHEAD;
}

double job_long_ms(const struct jobs *js)
{
    static const double times = 3;
    return fmax(JOB_LONG_MS, times * js->quickest_ms);
}

/* Quick work keeps a thread from long work for a while. */
static void job_note_quick(struct jobs *js, const struct job *j)
{
    const double now_s = clock_s();
    const bool over = now_s - js->quick_drawn_s > JOB_QUICK_S;
    if (over || j->predicted_ms < js->quickest_ms)
        js->quickest_ms = j->predicted_ms;
    if (over || j->predicted_ms < job_long_ms(js))
        js->quick_drawn_s = now_s;
}

void job_queue_add(struct jobs *js, struct job *j, uint64_t client)
{
    j->client = client;
    j->predicted_ms = cost_predict(&js->cost, j->kind, j->expected_ms);
    fair_queue_add(js->queue[j->cls], &j->place, client, j->predicted_ms);
    if (!job_is_drawn(j->cls)) {
        pthread_cond_signal(j->cls == JOB_ERRAND ? &js->errand_ready : &js->tile_ready);
        return;
    }
    if (j->cls != JOB_AHEAD)
        job_note_quick(js, j);
    pthread_cond_broadcast(&js->view_ready); /* one of them may rest, or not begin this */
}

/* Take w off its job and put it on the caller's list. */
void job_claim(struct job *j, struct job_waiter **p, const struct job_result *r,
               struct job_waiter **claimed)
{
    struct job_waiter *w = *p;
    bool coalesced = w->result.coalesced;
    *p = w->next;
    w->job = NULL;
    w->result = *r;
    w->result.coalesced = coalesced;
    w->result.queue_s = (j->running ? j->started_s : clock_s()) - j->queued_s;
    w->next = *claimed;
    *claimed = w;
}

void job_table_remove(struct jobs *js, struct job *j)
{
    struct job **p = job_table_find(js, j->id);
    if (*p == j) /* a cancelled job has left already, and a new one may have its id */
        *p = j->table_next;
}

/* A job that nobody waits for: forget it if it has not begun (then the caller frees it), let a tile
 * be finished for the cache, stop a picture or a question (nobody may join it any more). */
struct job *job_abandon(struct jobs *js, struct job *j)
{
    bool passing = js->cfg.passing ? js->cfg.passing(j->work) : job_is_picture(j->cls);
    if (j->running && !passing)
        return NULL;
    job_table_remove(js, j);
    if (j->running) {
        atomic_store(&j->cancel, true);
        return NULL;
    }
    fair_queue_remove(js->queue[j->cls], &j->place);
    return j;
}

/* ---- not under the lock ---- */

void job_wake_all(struct job_waiter *w)
{
    for (struct job_waiter *next; w; w = next) {
        next = w->next;
        w->next = NULL;
        w->wake(w); /* may free w */
    }
}

void job_free(struct jobs *js, struct job *j)
{
    if (!j)
        return;
    assert(!j->waiters);
    js->cfg.drop(js->cfg.user, j->work);
    mem_free(j);
}

/* Claim every waiter whose deadline is before `before_s` (or everyone); jobs without waiters are
 * forgotten. */
void job_claim_where(struct jobs *js, double before_s, const struct job_result *r, bool everyone)
{
    struct job_waiter *claimed = NULL;
    struct job *dead = NULL;
    pthread_mutex_lock(&js->lock);
    for (size_t i = 0; i < JOB_TABLE; i++) {
        for (struct job *j = js->table[i], *next; j; j = next) {
            next = j->table_next;
            bool had_waiters = j->waiters;
            for (struct job_waiter **p = &j->waiters; *p;) {
                if (everyone || (*p)->deadline_s <= before_s)
                    job_claim(j, p, r, &claimed);
                else
                    p = &(*p)->next;
            }
            if (everyone)
                atomic_store(&j->cancel, true);
            if (j->waiters || (!had_waiters && !everyone))
                continue;
            bool was_running = j->running;
            struct job *d = job_abandon(js, j);
            js->stats.ended[j->cls][r->end] += !was_running;
            if (d) {
                d->table_next = dead;
                dead = d;
            }
        }
    }
    pthread_mutex_unlock(&js->lock);
    job_wake_all(claimed);
    for (struct job *next; dead; dead = next) {
        next = dead->table_next;
        job_free(js, dead);
    }
}

bool job_leave(struct jobs *js, struct job_waiter *w)
{
    static const struct job_result gone = {
        .end = JOB_CANCELLED, .code = ERR_CANCEL, .msg = "the client has gone"};
    struct job *dead = NULL;
    struct job_waiter *claimed = NULL;
    pthread_mutex_lock(&js->lock);
    struct job *j = w->job;
    if (j) {
        struct job_waiter **p = &j->waiters;
        while (*p != w)
            p = &(*p)->next;
        job_claim(j, p, &gone, &claimed);
        w->next = NULL;
        if (!j->waiters) {
            bool was_running = j->running;
            dead = job_abandon(js, j);
            js->stats.ended[j->cls][JOB_CANCELLED] += !was_running;
        }
    }
    pthread_mutex_unlock(&js->lock);
    job_free(js, dead);
    return j != NULL;
}

enum job_class job_class_of(struct jobs *js, const struct job_waiter *w)
{
    pthread_mutex_lock(&js->lock);
    enum job_class cls = w->job ? w->job->cls : JOB_TILE;
    pthread_mutex_unlock(&js->lock);
    return cls;
}

bool job_cancelled(const struct job *j)
{
    return atomic_load(&j->cancel);
}

void job_tick(struct jobs *js, double now_s)
{
    static const struct job_result late = {
        .end = JOB_TIMEOUT, .code = ERR_BUSY, .msg = "not made within the time allowed"};
    pthread_mutex_lock(&js->lock);
    if (fair_queue_count(
            js->queue[JOB_SLOW])) /* a thread that was left to quick work may take it now */
        pthread_cond_signal(&js->tile_ready);
    pthread_mutex_unlock(&js->lock);
    job_claim_where(js, now_s, &late, false);
}
