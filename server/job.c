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
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/job.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "core/pool.h"
#include "server/failure.h"
#include "server/rate.h"
#include "server/turn.h"

enum { TABLE = 1024 };

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
    struct turns *queue[JOB_CLASSES];
    struct rate *rate[JOB_CLASSES]; /* NULL: that of JOB_TILE */
    struct job *table[TABLE];
    struct failures failures;
    enum job_class drew; /* the last that was drawn */
    bool stopping, drawer_ended;
    bool drawer_hangs;      /* of job_stop: it has been waited for */
    double drawing_since_s; /* 0: the thread that draws waits for work */
    pthread_cond_t ended;
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

static struct job *job_at(struct turn_item *it)
{
    return it ? (struct job *)(void *)((char *)it - offsetof(struct job, place)) : NULL;
}

static bool job_is_drawn(enum job_class cls)
{
    return cls == JOB_VIEW || cls == JOB_MAP || cls == JOB_MOTION || cls == JOB_AHEAD;
}

bool job_is_picture(enum job_class cls)
{
    return cls == JOB_VIEW || cls == JOB_AHEAD;
}

static void job_queue_add(struct jobs *js, struct job *j, uint64_t client)
{
    turn_add(js->queue[j->cls], &j->place, client);
    pthread_cond_signal(job_is_drawn(j->cls) ? &js->view_ready : &js->tile_ready);
}

static void job_note(struct jobs *js, const struct job *j, const struct job_result *r)
{
    if (r->end == JOB_OK)
        failure_forget(&js->failures, j->id);
    else if (r->end == JOB_ERROR && r->code != ERR_MEM && r->code != ERR_BUSY)
        failure_note(&js->failures, j->id, r->code, r->msg, clock_s());
    /* the others may well succeed next time */
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
 * be finished for the cache, stop a picture or a question (nobody may join it any more). */
static struct job *job_abandon(struct jobs *js, struct job *j)
{
    bool passing = js->cfg.passing ? js->cfg.passing(j->work) : job_is_picture(j->cls);
    if (j->running && !passing)
        return NULL;
    job_table_remove(js, j);
    if (j->running) {
        atomic_store(&j->cancel, true);
        return NULL;
    }
    turn_remove(js->queue[j->cls], &j->place);
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
    job_note(js, j, r);
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

/* What the thread that draws begins next: streams, pictures and map tiles in turns. */
static struct job *job_next_drawn(struct jobs *js)
{
    static const enum job_class order[] = {JOB_MOTION, JOB_VIEW, JOB_MAP};
    enum { N = sizeof order / sizeof *order };
    size_t last = 0;
    while (last < N - 1 && order[last] != js->drew)
        last++;
    for (size_t k = 1; k <= N; k++) {
        enum job_class c = order[(last + k) % N];
        if (turn_count(js->queue[c])) {
            js->drew = c;
            return job_at(turn_next(js->queue[c]));
        }
    }
    return job_at(turn_next(js->queue[JOB_AHEAD]));
}

static struct job *job_next_tile(struct jobs *js)
{
    struct turn_item *it = turn_next(js->queue[JOB_TILE]);
    return job_at(it ? it : turn_next(js->queue[JOB_PREFETCH]));
}

static void job_worker_main(void *user)
{
    struct worker *w = user;
    struct jobs *js = w->js;
    bool view = w->index == js->cfg.tile_threads;
    if (!view)
        pool_alone(); /* --workers says how many threads tiles have */
    pthread_mutex_lock(&js->lock);
    if (view)
        js->drawing_since_s = 0;
    while (!js->stopping) {
        struct job *j = view ? job_next_drawn(js) : job_next_tile(js);
        if (!j) {
            pthread_cond_wait(view ? &js->view_ready : &js->tile_ready, &js->lock);
            continue;
        }
        j->running = true;
        j->started_s = clock_s();
        if (view)
            js->drawing_since_s = j->started_s;
        js->stats.running[j->cls]++;
        pthread_mutex_unlock(&js->lock);
        job_run(js, j, w->index);
        pthread_mutex_lock(&js->lock);
        if (view)
            js->drawing_since_s = 0;
    }
    pthread_mutex_unlock(&js->lock);
    pthread_mutex_lock(&js->lock);
    js->drawer_ended |= view;
    pthread_cond_broadcast(&js->ended);
    pthread_mutex_unlock(&js->lock);
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
    js->failures.pause_s = cfg->slow_s > 0 ? cfg->slow_s : 2;
    pthread_mutex_init(&js->lock, NULL);
    pthread_cond_init(&js->tile_ready, NULL);
    pthread_cond_init(&js->view_ready, NULL);
    pool_cond_init(&js->ended);
    js->drew = JOB_MOTION; /* pictures are first */
    js->drawing_since_s = cfg->view_thread ? clock_s() : 0;
    js->drawer_ended = !cfg->view_thread;
    for (int c = 0; c < JOB_CLASSES && !rc; c++)
        rc = turn_open(c == JOB_VIEW, &js->queue[c], e);
    if (!rc)
        rc = rate_open(cfg->client_views_s, JOB_BURST_S, &js->rate[JOB_VIEW], e);
    if (!rc)
        rc = rate_open(cfg->client_tiles_s, JOB_BURST_S, &js->rate[JOB_TILE], e);
    for (; js->n_workers < n && !rc; js->n_workers += !rc) {
        struct worker *w = &js->workers[js->n_workers];
        w->js = js;
        w->index = js->n_workers;
        rc = pool_start(job_worker_main, w, &w->thread, e);
    }
    js->drawer_ended |= js->n_workers < n; /* it was never started */
    if (rc)
        (void)job_close(out);
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

/* Under the lock: `client` wants a job that is there already. */
static void job_join(struct jobs *js, struct job *j, enum job_class cls, uint64_t client)
{
    js->stats.coalesced++;
    if (j->running)
        return;
    if ((j->cls == JOB_PREFETCH && cls == JOB_TILE) || (j->cls == JOB_AHEAD && cls == JOB_VIEW)) {
        turn_remove(js->queue[j->cls], &j->place);
        j->cls = cls;
        job_queue_add(js, j, client);
    } else {
        turn_join(js->queue[j->cls], &j->place, client);
    }
}

/* Under the lock: room in the queue for one more of `client`. False: there is none, w is refused.
 * *shed is a queued job that had to give way. */
static bool job_make_room(struct jobs *js, enum job_class cls, uint64_t client,
                          struct job_waiter *w, struct job **shed)
{
    if (turn_count(js->queue[cls]) < js->cfg.queue_limit[cls])
        return true;
    js->stats.ended[cls][JOB_SHED]++;
    *shed = job_at(turn_shed(js->queue[cls], client));
    if (!*shed)
        job_refuse(w, JOB_SHED, ERR_BUSY, "too many requests are waiting");
    return *shed;
}

/* NULL: it is not counted. */
static struct rate *job_rate(struct jobs *js, enum job_class cls)
{
    return cls == JOB_MOTION ? NULL : js->rate[job_is_picture(cls) ? JOB_VIEW : JOB_TILE];
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
                                   uint64_t client, void **work, struct job_waiter *w,
                                   struct job **shed)
{
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
        return NULL;
    }
    if (!job_pay(js, cls, client, now_s, w)) /* first: room is made by taking another's */
        return NULL;
    if (!job_make_room(js, cls, client, w, shed)) {
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
        bool own = turn_owner(&shed->place) == client;
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
    double threads = job_is_drawn(cls) ? 1 : fmax(1, (double)js->cfg.tile_threads);
    double wait_s = ceil((double)turn_count(js->queue[cls]) * mean_s / threads);
    pthread_mutex_unlock(&js->lock);
    return wait_s < 1 ? 1 : wait_s > 10 ? 10 : (int)wait_s;
}

void job_count(struct jobs *js, struct job_stats *out)
{
    pthread_mutex_lock(&js->lock);
    *out = js->stats;
    for (int c = 0; c < JOB_CLASSES; c++)
        out->queued[c] = turn_count(js->queue[c]);
    pthread_mutex_unlock(&js->lock);
}

void job_forgive(struct jobs *js)
{
    pthread_mutex_lock(&js->lock);
    failure_forget_all(&js->failures);
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

double job_drawing_s(struct jobs *js)
{
    pthread_mutex_lock(&js->lock);
    double since_s = js->drawing_since_s;
    pthread_mutex_unlock(&js->lock);
    return since_s > 0 ? clock_s() - since_s : 0;
}

/* Wait for the thread that draws, as long as that may take; whoever asks again has waited
 * already. */
static bool job_await_drawer(struct jobs *js)
{
    const double again_s = 0.5;
    double wait_s = js->cfg.stop_s > 0 ? js->cfg.stop_s : 10;
    if (js->drawer_hangs)
        wait_s = fmin(wait_s, again_s);
    const double end_s = clock_s() + wait_s;
    pthread_mutex_lock(&js->lock);
    while (!js->drawer_ended && pool_cond_wait(&js->ended, &js->lock, end_s))
        continue;
    bool ended = js->drawer_ended;
    js->drawer_hangs = !ended;
    pthread_mutex_unlock(&js->lock);
    return ended;
}

bool job_stop(struct jobs *js)
{
    static const struct job_result stop = {
        .end = JOB_SHED, .code = ERR_BUSY, .msg = "the server is stopping"};
    pthread_mutex_lock(&js->lock);
    js->stopping = true;
    pthread_cond_broadcast(&js->tile_ready);
    pthread_cond_broadcast(&js->view_ready);
    pthread_mutex_unlock(&js->lock);
    job_claim_where(js, 0, &stop, true);
    if (js->cfg.stop)
        js->cfg.stop(js->cfg.user);
    bool ended = job_await_drawer(js);
    for (size_t i = 0; i < js->n_workers; i++)
        if (js->workers[i].thread && (ended || i < js->cfg.tile_threads))
            pool_join(&js->workers[i].thread);
    return ended;
}

bool job_close(struct jobs **out)
{
    struct jobs *js = *out;
    if (!js)
        return true;
    if (!job_stop(js))
        return false;
    *out = NULL;
    pthread_cond_destroy(&js->tile_ready);
    pthread_cond_destroy(&js->view_ready);
    pthread_cond_destroy(&js->ended);
    pthread_mutex_destroy(&js->lock);
    for (int c = 0; c < JOB_CLASSES; c++) {
        turn_close(&js->queue[c]);
        rate_close(&js->rate[c]);
    }
    mem_free(js->workers);
    mem_free(js);
    return true;
}
