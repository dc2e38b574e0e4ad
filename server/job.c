/* Slow work, away from the HTTP threads. A job is named by a 128-bit id: while it waits or runs,
 * everyone who asks for the same id becomes one more waiter of the same run (single flight). Queues
 * are bounded: tiles are refused when theirs is full, pictures push out the oldest (a newer camera
 * is worth more), prefetched tiles run when nothing else does and move up when somebody really
 * asks.
 *
 * One mutex guards everything, and no callback runs under it. Whoever takes a waiter off a job
 * under the lock (the worker that finished, job_leave, job_tick, job_stop) has claimed it:
 * waiter->job becomes NULL, and only the claimer wakes it. So each waiter is woken exactly once,
 * however those four race, and a job that ends in any way answers all its waiters, because
 * job_finish is the only end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/job.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "core/pool.h"

enum { TABLE = 1024, FAILURES = 64, CLIENTS = 1024 };

struct job {
    struct hash128 id;
    enum job_class cls;
    void *work;
    bool running;
    _Atomic bool cancel;
    struct job_waiter *waiters;
    struct job *table_next;
    struct job *newer, *older; /* in its queue */
    uint64_t client;           /* who asked first */
    double queued_s, started_s;
};
struct queue {
    struct job *newest, *oldest;
    size_t n;
};
struct failure { /* ids that failed lately, and until when they are not tried again */
    struct hash128 id;
    enum err_code code;
    char msg[256];
    double until_s, pause_s;
};
struct worker {
    struct jobs *js;
    size_t index;
    struct pool_thread *thread;
};
struct jobs { /* all but cfg and workers by `lock` */
    struct job_config cfg;
    struct worker *workers; /* tile threads, then the view thread */
    size_t n_workers;
    pthread_mutex_t lock;
    pthread_cond_t tile_ready, view_ready;
    struct queue queue[JOB_CLASSES];
    struct job *table[TABLE];
    struct failure failure[FAILURES];
    size_t next_failure;
    uint64_t served[CLIENTS], turn; /* when a client's view was last begun, by hash */
    bool stopping;
    struct job_stats stats;
};

static bool job_same(struct hash128 a, struct hash128 b)
{
    return a.lo == b.lo && a.hi == b.hi;
}

/* ---- under the lock ---- */

static struct job **job_table_find(struct jobs *js, struct hash128 id)
{
    struct job **p = &js->table[id.lo % TABLE];
    while (*p && !job_same((*p)->id, id))
        p = &(*p)->table_next;
    return p;
}

static void job_queue_add(struct jobs *js, struct job *j)
{
    struct queue *q = &js->queue[j->cls];
    j->older = q->newest;
    j->newer = NULL;
    *(q->newest ? &q->newest->newer : &q->oldest) = j;
    q->newest = j;
    q->n++;
    pthread_cond_signal(j->cls == JOB_VIEW ? &js->view_ready : &js->tile_ready);
}

static void job_queue_remove(struct jobs *js, struct job *j)
{
    struct queue *q = &js->queue[j->cls];
    *(j->newer ? &j->newer->older : &q->newest) = j->older;
    *(j->older ? &j->older->newer : &q->oldest) = j->newer;
    j->newer = j->older = NULL;
    q->n--;
}

static struct failure *job_failure_find(struct jobs *js, struct hash128 id)
{
    for (size_t i = 0; i < FAILURES; i++)
        if (js->failure[i].pause_s > 0 && job_same(js->failure[i].id, id))
            return &js->failure[i];
    return NULL;
}

static void job_failure_note(struct jobs *js, struct hash128 id, const struct job_result *r)
{
    struct failure *f = job_failure_find(js, id);
    if (r->end == JOB_OK) {
        if (f)
            f->pause_s = 0;
        return;
    }
    if (r->end != JOB_ERROR || r->code == ERR_MEM || r->code == ERR_BUSY)
        return; /* these may well succeed next time */
    double pause_s = f ? fmin(f->pause_s * 2, 60) : js->cfg.slow_s > 0 ? js->cfg.slow_s : 2;
    if (!f)
        f = &js->failure[js->next_failure++ % FAILURES];
    f->id = id;
    f->code = r->code;
    memcpy(f->msg, r->msg, sizeof f->msg);
    f->pause_s = pause_s;
    f->until_s = clock_s() + pause_s;
}

/* Take w off its job and put it on the caller's list. */
static void job_claim(struct job *j, struct job_waiter **p, const struct job_result *r,
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

static void job_table_remove(struct jobs *js, struct job *j)
{
    struct job **p = job_table_find(js, j->id);
    if (*p == j) /* a cancelled job has left already, and a new one may have its id */
        *p = j->table_next;
}

/* A job that nobody waits for: forget it if it has not begun (then the caller frees it), let a tile
 * be finished for the cache, stop a picture (nobody may join it any more). */
static struct job *job_abandon(struct jobs *js, struct job *j)
{
    if (j->running && j->cls != JOB_VIEW)
        return NULL;
    job_table_remove(js, j);
    if (j->running) {
        atomic_store(&j->cancel, true);
        return NULL;
    }
    job_queue_remove(js, j);
    return j;
}

/* ---- not under the lock ---- */

static void job_wake_all(struct job_waiter *w)
{
    for (struct job_waiter *next; w; w = next) {
        next = w->next;
        w->next = NULL;
        w->wake(w); /* may free w */
    }
}

static void job_free(struct jobs *js, struct job *j)
{
    if (!j)
        return;
    assert(!j->waiters);
    js->cfg.drop(js->cfg.user, j->work);
    mem_free(j);
}

/* The one end of a job that has run: off the table, every waiter answered. Takes body. */
static void job_finish(struct jobs *js, struct job *j, struct job_result *r, struct body *body)
{
    struct job_waiter *claimed = NULL;
    pthread_mutex_lock(&js->lock);
    job_table_remove(js, j);
    js->stats.running[j->cls]--;
    js->stats.ended[j->cls][r->end]++;
    js->stats.run_s[j->cls] += r->run_s;
    job_failure_note(js, j->id, r);
    while (j->waiters)
        job_claim(j, &j->waiters, r, &claimed);
    pthread_mutex_unlock(&js->lock);
    for (struct job_waiter *w = claimed; w; w = w->next)
        w->result.body = body_ref(body);
    job_wake_all(claimed);
    body_drop(&body);
    job_free(js, j);
}

static void job_run(struct jobs *js, struct job *j, size_t worker)
{
    struct err e = {0};
    struct body *body = NULL;
    struct job_result r = {.end = JOB_OK};
    r.code = js->cfg.run(js->cfg.user, j, j->work, worker, &body, &e);
    r.run_s = clock_s() - j->started_s;
    if (r.code == ERR_OK && !body)
        r.code = err_set(&e, ERR_INTERNAL, "job made nothing");
    if (r.code != ERR_OK) {
        r.end = r.code == ERR_CANCEL ? JOB_CANCELLED : JOB_ERROR;
        snprintf(r.msg, sizeof r.msg, "%.*s", (int)sizeof r.msg - 1, e.msg);
        body_drop(&body);
    }
    job_finish(js, j, &r, body);
}

/* The view to begin: of the client who waited longest since one of his was begun, the newest. */
static struct job *job_next_view(struct jobs *js)
{
    struct job *best = NULL;
    for (struct job *j = js->queue[JOB_VIEW].newest; j; j = j->older)
        if (!best || js->served[j->client % CLIENTS] < js->served[best->client % CLIENTS])
            best = j;
    if (best)
        js->served[best->client % CLIENTS] = ++js->turn;
    return best;
}

/* The view that makes room for one more of `client`: the oldest of the client who has most of them, the
 * new one counted. */
static struct job *job_to_shed(struct jobs *js, uint64_t client)
{
    struct job *victim = NULL;
    size_t most = 0;
    for (struct job *j = js->queue[JOB_VIEW].oldest; j; j = j->newer) {
        size_t n = j->client == client;
        for (struct job *k = js->queue[JOB_VIEW].oldest; k; k = k->newer)
            n += k->client == j->client;
        if (n > most) {
            most = n;
            victim = j;
        }
    }
    return victim;
}

static struct job *job_next_tile(struct jobs *js)
{
    return js->queue[JOB_TILE].oldest ? js->queue[JOB_TILE].oldest : js->queue[JOB_PREFETCH].oldest;
}

static void job_worker_main(void *user)
{
    struct worker *w = user;
    struct jobs *js = w->js;
    bool view = w->index == js->cfg.tile_threads;
    if (view && js->cfg.view_enter)
        js->cfg.view_enter(js->cfg.user);
    pthread_mutex_lock(&js->lock);
    while (!js->stopping) {
        struct job *j = view ? job_next_view(js) : job_next_tile(js);
        if (!j) {
            pthread_cond_wait(view ? &js->view_ready : &js->tile_ready, &js->lock);
            continue;
        }
        job_queue_remove(js, j);
        j->running = true;
        j->started_s = clock_s();
        js->stats.running[j->cls]++;
        pthread_mutex_unlock(&js->lock);
        job_run(js, j, w->index);
        pthread_mutex_lock(&js->lock);
    }
    pthread_mutex_unlock(&js->lock);
    if (view && js->cfg.view_leave)
        js->cfg.view_leave(js->cfg.user);
}

/* ---- the interface ---- */

enum err_code job_open(const struct job_config *cfg, struct jobs **out, struct err *e)
{
    struct jobs *js = mem_array(1, sizeof *js);
    size_t n = cfg->tile_threads + cfg->view_thread;
    enum err_code rc = ERR_OK;
    *out = js;
    if (!js || !(js->workers = mem_array(n, sizeof *js->workers))) {
        mem_free(js);
        *out = NULL;
        return err_set(e, ERR_MEM, "jobs: out of memory");
    }
    js->cfg = *cfg;
    pthread_mutex_init(&js->lock, NULL);
    pthread_cond_init(&js->tile_ready, NULL);
    pthread_cond_init(&js->view_ready, NULL);
    for (; js->n_workers < n && !rc; js->n_workers += !rc) {
        struct worker *w = &js->workers[js->n_workers];
        w->js = js;
        w->index = js->n_workers;
        rc = pool_start(job_worker_main, w, &w->thread, e);
    }
    if (rc)
        job_close(out);
    return rc;
}

/* Refuse w: the result says why, and w will not be woken. */
static enum err_code job_refuse(struct job_waiter *w, enum job_end end, enum err_code code,
                                const char *why)
{
    w->result = (struct job_result){.end = end, .code = code};
    snprintf(w->result.msg, sizeof w->result.msg, "%s", why);
    w->job = NULL;
    return code;
}

/* Under the lock: a job for this id to wait for, or NULL with w refused. *unused is work nobody
 * needs, *shed a queued job that had to make room. */
static struct job *job_find_or_add(struct jobs *js, enum job_class cls, struct hash128 id,
                                   uint64_t client, void **work, struct job_waiter *w,
                                   struct job **shed)
{
    struct job *j = *job_table_find(js, id);
    double now_s = clock_s();
    struct failure *f = job_failure_find(js, id);
    if (js->stopping) {
        job_refuse(w, JOB_SHED, ERR_BUSY, "the server is stopping");
        return NULL;
    }
    if (j) {
        w->result.coalesced = true;
        js->stats.coalesced++;
        if (!j->running && j->cls == JOB_PREFETCH && cls == JOB_TILE) {
            job_queue_remove(js, j);
            j->cls = JOB_TILE;
            job_queue_add(js, j);
        }
        return j;
    }
    if (f && now_s < f->until_s) {
        job_refuse(w, JOB_ERROR, f->code, f->msg);
        return NULL;
    }
    if (js->queue[cls].n >= js->cfg.queue_limit[cls]) {
        if (cls != JOB_VIEW) {
            js->stats.ended[cls][JOB_SHED]++;
            job_refuse(w, JOB_SHED, ERR_BUSY, "too many requests are waiting");
            return NULL;
        }
        *shed = job_to_shed(js, client);
        js->stats.ended[cls][JOB_SHED]++;
    }
    j = mem_array(1, sizeof *j);
    if (!j) {
        *shed = NULL;
        job_refuse(w, JOB_ERROR, ERR_MEM, "out of memory");
        return NULL;
    }
    j->id = id;
    j->cls = cls;
    j->client = client;
    j->work = *work;
    *work = NULL;
    j->queued_s = now_s;
    struct job **p = job_table_find(js, id);
    j->table_next = *p;
    *p = j;
    job_queue_add(js, j);
    return j;
}

enum err_code job_submit(struct jobs *js, enum job_class cls, struct hash128 id, void *work,
                         uint64_t client, double timeout_s, struct job_waiter *w)
{
    struct job *shed = NULL;
    struct job_waiter *claimed = NULL;
    memset(&w->result, 0, sizeof w->result);
    pthread_mutex_lock(&js->lock);
    struct job *j = job_find_or_add(js, cls, id, client, &work, w, &shed);
    /* Once the lock is open, w may be woken and gone: what is returned must be read before. */
    enum err_code rc = j ? ERR_OK : w->result.code;
    if (j) {
        w->deadline_s = clock_s() + timeout_s;
        w->job = j;
        w->next = j->waiters;
        j->waiters = w;
    }
    if (shed) {
        const struct job_result r = {.end = JOB_SHED,
                                     .code = shed->client == client ? ERR_LIMIT : ERR_BUSY,
                                     .msg = "newer pictures were asked for"};
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

/* Claim every waiter whose deadline is before `before_s` (or everyone); jobs without waiters are
 * forgotten. */
static void job_claim_where(struct jobs *js, double before_s, const struct job_result *r,
                            bool everyone)
{
    struct job_waiter *claimed = NULL;
    struct job *dead = NULL;
    pthread_mutex_lock(&js->lock);
    for (size_t i = 0; i < TABLE; i++) {
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

void job_tick(struct jobs *js, double now_s)
{
    static const struct job_result late = {
        .end = JOB_TIMEOUT, .code = ERR_BUSY, .msg = "not made within the time allowed"};
    job_claim_where(js, now_s, &late, false);
}

int job_retry_after(struct jobs *js, enum job_class cls)
{
    pthread_mutex_lock(&js->lock);
    uint64_t n = js->stats.ended[cls][JOB_OK] + js->stats.ended[cls][JOB_ERROR];
    double mean_s = n ? js->stats.run_s[cls] / (double)n : 1;
    double threads = cls == JOB_VIEW ? 1 : fmax(1, (double)js->cfg.tile_threads);
    double wait_s = ceil((double)js->queue[cls].n * mean_s / threads);
    pthread_mutex_unlock(&js->lock);
    return wait_s < 1 ? 1 : wait_s > 10 ? 10 : (int)wait_s;
}

void job_count(struct jobs *js, struct job_stats *out)
{
    pthread_mutex_lock(&js->lock);
    *out = js->stats;
    for (int c = 0; c < JOB_CLASSES; c++)
        out->queued[c] = js->queue[c].n;
    pthread_mutex_unlock(&js->lock);
}

bool job_idle(struct jobs *js)
{
    struct job_stats st;
    job_count(js, &st);
    uint64_t busy = 0;
    for (int c = 0; c < JOB_CLASSES; c++)
        busy += st.queued[c] + st.running[c];
    return busy == 0;
}

void job_stop(struct jobs *js)
{
    static const struct job_result stop = {
        .end = JOB_SHED, .code = ERR_BUSY, .msg = "the server is stopping"};
    pthread_mutex_lock(&js->lock);
    js->stopping = true;
    pthread_cond_broadcast(&js->tile_ready);
    pthread_cond_broadcast(&js->view_ready);
    pthread_mutex_unlock(&js->lock);
    job_claim_where(js, 0, &stop, true);
    for (size_t i = 0; i < js->n_workers; i++)
        if (js->workers[i].thread)
            pool_join(&js->workers[i].thread);
}

void job_close(struct jobs **out)
{
    struct jobs *js = *out;
    *out = NULL;
    if (!js)
        return;
    job_stop(js);
    pthread_cond_destroy(&js->tile_ready);
    pthread_cond_destroy(&js->view_ready);
    pthread_mutex_destroy(&js->lock);
    mem_free(js->workers);
    mem_free(js);
}
