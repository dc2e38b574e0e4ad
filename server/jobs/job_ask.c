/* Requests for a job: joins an existing one, or adds one to a queue if the client may and there is
 * room.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/job_life.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define JOB_SLOW_MS 80.0 /* predicted; what takes longer leaves a thread to what is quick */

/* Refuse w: the result says why, and w will not be woken. */
static enum err_code job_refuse(struct job_waiter *w, enum job_end end, enum err_code code,
                                const char *why)
{
    w->result = (struct job_result){.end = end, .code = code};
    snprintf(w->result.msg, sizeof w->result.msg, "%s", why);
    w->job = NULL;
    return code;
}

/* Under the lock: `client` wants a job that is there already. */
static void job_join(struct jobs *js, struct job *j, enum job_class cls, uint64_t client)
{
    js->stats.coalesced++;
    if (j->running)
        return;
    if ((j->cls == JOB_PREFETCH && cls == JOB_TILE) || (j->cls == JOB_AHEAD && cls == JOB_VIEW)) {
        fair_queue_remove(js->queue[j->cls], &j->place);
        j->cls = cls;
        job_queue_add(js, j, client);
    } else {
        fair_queue_join(js->queue[j->cls], &j->place, client);
        j->client = fair_queue_owner(&j->place);
    }
}

/* Under the lock: how long new work of `client` would wait, by what is known. Queues of one thread
 * that have work share its time. */
static double job_wait_s(const struct jobs *js, enum job_class cls, uint64_t client)
{
    size_t sharing = 1, threads = job_is_drawn(cls) ? js->cfg.draw_threads : 1;
    for (int c = 0; c < JOB_CLASSES; c++)
        sharing += c != (int)cls && c != JOB_PREFETCH && c != JOB_AHEAD &&
                   job_duty_of((enum job_class)c) == job_duty_of(cls) &&
                   fair_queue_count(js->queue[c]);
    if (job_duty_of(cls) == JOB_ENCODES && js->cfg.tile_threads > 1)
        threads = js->cfg.tile_threads - (cls == JOB_SLOW);
    return fair_queue_wait_ms(js->queue[cls], client) * 1e-3 * (double)sharing /
           fmax(1, (double)threads);
}

static int job_seconds(double wait_s)
{
    enum { MOST = 60 };
    return wait_s < 1 ? 1 : wait_s > MOST ? MOST : (int)ceil(wait_s);
}

/* Under the lock: room in the queue for one more of `client`, that is served within timeout_s.
 * False: there is none, w is refused. *shed is a queued job that had to give way. */
static bool job_make_room(struct jobs *js, enum job_class cls, uint64_t client, double timeout_s,
                          struct job_waiter *w, struct job **shed)
{
    const enum job_class limited = cls == JOB_SLOW || cls == JOB_ERRAND ? JOB_TILE : cls;
    /* Those ahead run when nothing waits; how long an errand takes is not this machine's to say. */
    const bool waits = cls != JOB_PREFETCH && cls != JOB_AHEAD && cls != JOB_ERRAND;
    const double wait_s = waits ? job_wait_s(js, cls, client) : 0;
    const bool full = fair_queue_count(js->queue[cls]) >= js->cfg.queue_limit[limited];
    if (!full && wait_s <= timeout_s)
        return true;
    js->stats.ended[cls][JOB_SHED]++;
    *shed = job_at(full              ? fair_queue_shed(js->queue[cls], client)
                   : cls == JOB_VIEW ? fair_queue_oldest(js->queue[cls], client)
                                     : NULL);
    if (*shed)
        return true;
    job_refuse(w, JOB_SHED, ERR_BUSY,
               full ? "too many requests are waiting"
                    : "it would wait longer than its deadline: ask again later");
    /* when the wait is as long as it may be; of a full queue, when what is before it was served */
    w->result.retry_s = job_seconds(full ? wait_s : wait_s - timeout_s);
    return false;
}

/* NULL: it is not counted. */
static struct rate *job_rate(struct jobs *js, enum job_class cls)
{
    return cls == JOB_MOTION || cls == JOB_ERRAND
               ? NULL
               : js->rate[job_is_picture(cls) ? JOB_VIEW : JOB_TILE];
}

/* Under the lock: does the client have a token for one more? */
static bool job_pay(struct jobs *js, enum job_class cls, uint64_t client, double now_s,
                    struct job_waiter *w)
{
    struct rate *rate = job_rate(js, cls);
    double wait_s = rate ? rate_take(rate, client, now_s) : 0;
    if (wait_s <= 0)
        return true;
    js->stats.ended[cls][JOB_LIMITED]++;
    job_refuse(w, JOB_LIMITED, ERR_LIMIT,
               job_is_picture(cls)
                   ? "your address asks for more new pictures than its share"
                   : "your address asks for more new tiles, questions and thumbnails than its "
                     "share");
    w->result.retry_s = (int)fmin(ceil(wait_s), 60);
    return false;
}

/* Under the lock: a job for this id to wait for, or NULL with w refused. Takes *work if it is
 * needed; *shed is a queued job that had to give way. */
static struct job *job_find_or_add(struct jobs *js, enum job_class cls, struct hash128 id,
                                   uint64_t client, double timeout_s, void **work,
                                   struct job_waiter *w, struct job **shed)
{
    struct cost_kind kind = {0};
    struct job *j = *job_table_find(js, id);
    double now_s = clock_s();
    if (js->stopping) {
        job_refuse(w, JOB_SHED, ERR_BUSY, "the server is stopping");
        return NULL;
    }
    if (j) {
        w->result.coalesced = true;
        job_join(js, j, cls, client);
        return j;
    }
    const struct failure *f = failure_find(&js->failures, id, now_s);
    if (f) {
        job_refuse(w, JOB_ERROR, f->code, f->msg);
        w->result.retry_s = job_seconds(f->until_s - now_s);
        return NULL;
    }
    const double expected_ms = js->cfg.cost ? js->cfg.cost(*work, &kind) : 1;
    if (cls == JOB_TILE && cost_predict(&js->cost, kind, expected_ms) > JOB_SLOW_MS)
        cls = JOB_SLOW;
    else if (cls == JOB_TILE)
        js->quick_s = now_s;
    if (!job_pay(js, cls, client, now_s, w)) /* first: room is made by taking another's */
        return NULL;
    if (!job_make_room(js, cls, client, timeout_s, w, shed)) {
        if (job_rate(js, cls))
            rate_give(job_rate(js, cls), client);
        return NULL;
    }
    j = mem_array(1, sizeof *j);
    if (!j) {
        *shed = NULL;
        job_refuse(w, JOB_ERROR, ERR_MEM, "out of memory");
        return NULL;
    }
    j->id = id;
    j->cls = cls;
    j->kind = kind;
    j->expected_ms = expected_ms;
    j->work = *work;
    *work = NULL;
    j->queued_s = now_s;
    struct job **p = job_table_find(js, id);
    j->table_next = *p;
    *p = j;
    job_queue_add(js, j, client);
    return j;
}

enum err_code job_submit(struct jobs *js, enum job_class cls, struct hash128 id, void *work,
                         uint64_t client, double timeout_s, struct job_waiter *w)
{
    struct job *shed = NULL;
    struct job_waiter *claimed = NULL;
    memset(&w->result, 0, sizeof w->result);
    pthread_mutex_lock(&js->lock);
    struct job *j = job_find_or_add(js, cls, id, client, timeout_s, &work, w, &shed);
    /* Once the lock is open, w may be woken and gone: what is returned must be read before. */
    enum err_code rc = j ? ERR_OK : w->result.code;
    if (j) {
        w->deadline_s = clock_s() + timeout_s;
        w->job = j;
        w->next = j->waiters;
        j->waiters = w;
    }
    if (shed) {
        bool own = fair_queue_owner(&shed->place) == client;
        struct job_result r = {.end = JOB_SHED, .code = own ? ERR_LIMIT : ERR_BUSY};
        snprintf(r.msg, sizeof r.msg, "%s",
                 own ? "newer pictures were asked for"
                     : "too many requests are waiting, most of them yours");
        while (shed->waiters)
            job_claim(shed, &shed->waiters, &r, &claimed);
        shed = job_abandon(js, shed);
    }
    pthread_mutex_unlock(&js->lock);
    if (work)
        js->cfg.drop(js->cfg.user, work);
    job_wake_all(claimed);
    job_free(js, shed);
    return rc;
}

int job_retry_after(struct jobs *js, enum job_class cls)
{
    pthread_mutex_lock(&js->lock);
    uint64_t n = js->stats.ended[cls][JOB_OK] + js->stats.ended[cls][JOB_ERROR];
    double mean_s = n ? js->stats.run_s[cls] / (double)n : 1;
    double threads =
        fmax(1, (double)(job_is_drawn(cls) ? js->cfg.draw_threads : js->cfg.tile_threads));
    double wait_s = ceil((double)fair_queue_count(js->queue[cls]) * mean_s / threads);
    pthread_mutex_unlock(&js->lock);
    return wait_s < 1 ? 1 : wait_s > 10 ? 10 : (int)wait_s;
}
