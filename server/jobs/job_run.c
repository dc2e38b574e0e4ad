/* The threads of jobs: they take the next job, run it and wake its waiters. Also starting and
 * stopping.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/job_life.h"

#include <math.h>
#include <stdio.h>

#include "core/trace.h"

static const double STREAM_S = 0.05; /* how long long work waits for the next picture of a stream */
static const double STREAM_PAYS = 0.5; /* part of that wait that counts as the stream's time */
static const double AGAIN_S = 0.1;     /* how often a thread without work that it may begin looks */
/* Where one thread draws, nothing can be drawn while a long picture is, so it counts for more than
 * its time. */
static const double LONG_MS = 100, LONG_PAYS = 2;

/* ---- under the lock ---- */

static void job_note(struct jobs *js, const struct job *j, const struct job_result *r)
{
    if (r->end == JOB_OK)
        failure_forget(&js->failures, j->id);
    else if (r->end == JOB_ERROR && r->code != ERR_MEM && r->code != ERR_BUSY)
        failure_note(&js->failures, j->id, r->code, r->msg, clock_s());
    /* the others may well succeed next time */
}

/* What it took is learned, and whoever was served pays the difference. */
static void job_settle(struct jobs *js, const struct job *j, const struct job_result *r)
{
    const double ms = r->run_s * 1e3;
    const bool alone = job_is_drawn(j->cls) && ms > LONG_MS && js->cfg.draw_threads == 1;
    const double more = ms * (alone ? LONG_PAYS : 1) - j->predicted_ms;
    fair_queue_charge(js->queue[j->cls], j->client, more);
    js->class_ms[j->cls] += more;
    if (r->end == JOB_OK)
        cost_learn(&js->cost, j->kind, j->expected_ms, ms);
    if (j->cls != JOB_MOTION)
        return;
    js->stream = j->client;
    js->stream_s = r->end == JOB_OK ? clock_s() : 0;
}

/* ---- not under the lock ---- */

/* The one end of a job that has run: off the table, every waiter answered. Takes body. */
static void job_finish(struct jobs *js, struct job *j, struct job_result *r, struct body *body)
{
    struct job_waiter *claimed = NULL;
    pthread_mutex_lock(&js->lock);
    job_table_remove(js, j);
    js->stats.running[j->cls]--;
    js->long_drawn -= j->counts_long;
    js->stats.ended[j->cls][r->end]++;
    js->stats.run_s[j->cls] += r->run_s;
    job_note(js, j, r);
    job_settle(js, j, r);
    while (j->waiters)
        job_claim(j, &j->waiters, r, &claimed);
    pthread_mutex_unlock(&js->lock);
    for (struct job_waiter *w = claimed; w; w = w->next)
        w->result.body = body_ref(body);
    job_wake_all(claimed);
    body_drop(&body);
    job_free(js, j);
}

/* Of what waits in the queue, for a trace. */
static const char *job_noun(enum job_class cls)
{
    static const char *const nouns[JOB_CLASSES] = {
        [JOB_VIEW] = "picture",   [JOB_TILE] = "tile",    [JOB_PREFETCH] = "tile ahead",
        [JOB_MAP] = "map tile",   [JOB_MOTION] = "frame", [JOB_AHEAD] = "picture ahead",
        [JOB_SLOW] = "slow work", [JOB_ERRAND] = "errand"};
    return nouns[cls];
}

static void job_run(struct jobs *js, struct job *j, size_t worker)
{
    struct err e = {0};
    struct body *body = NULL;
    struct job_result r = {.end = JOB_OK};
    trace_overlap("queue", job_noun(j->cls), j->queued_s, j->started_s);
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

/* A class's time, counted from when it began to wait. */
static double job_class_ms(const struct jobs *js, enum job_class c)
{
    return fmax(js->class_ms[c], js->now_ms[job_duty_of(c)]);
}

/* Of a class the work of the client that had least time, of quick work if long work may not begin.
 * NULL: none. */
static struct fair_queue_item *job_next(const struct jobs *js, enum job_class c, bool quick)
{
    return quick ? fair_queue_first_below(js->queue[c], job_long_ms(js))
                 : fair_queue_first(js->queue[c]);
}

/* Of these classes the one with work that had least time; JOB_CLASSES: none has work. */
static enum job_class job_least(const struct jobs *js, const enum job_class *order, size_t n,
                                bool quick)
{
    enum job_class least = JOB_CLASSES;
    for (size_t i = 0; i < n; i++)
        if (job_next(js, order[i], quick) &&
            (least == JOB_CLASSES || job_class_ms(js, order[i]) < job_class_ms(js, least)))
            least = order[i];
    return least;
}

/* Of a class the work of the client that had least time. NULL: JOB_CLASSES. */
static struct job *job_take(struct jobs *js, enum job_class c, bool quick)
{
    if (c == JOB_CLASSES)
        return NULL;
    struct fair_queue_item *next = job_next(js, c, quick);
    struct job *j = job_at(next);
    fair_queue_take(js->queue[c], next);
    js->now_ms[job_duty_of(c)] = job_class_ms(js, c);
    js->class_ms[c] = job_class_ms(js, c) + j->predicted_ms;
    return j;
}

/* When this work may begin, because the stream drawn last is to be served before; 0: now. */
static double job_begins_s(struct jobs *js, enum job_class c)
{
    const double until_s = js->stream_s > 0 ? js->stream_s + STREAM_S : 0;
    if (c == JOB_CLASSES || js->cfg.draw_threads > 1 || clock_s() >= until_s ||
        fair_queue_first(js->queue[c])->ms < JOB_LONG_MS)
        return 0;
    const bool due = fair_queue_is_due(js->queue[JOB_MOTION], js->stream) &&
                     (c == JOB_MOTION || job_class_ms(js, JOB_MOTION) < job_class_ms(js, c));
    return due ? until_s : 0;
}

/* Wait for the next picture of the stream drawn last, or for anything else to do. */
static void job_await_stream(struct jobs *js, double until_s)
{
    const double from_s = clock_s();
    (void)pool_cond_wait(&js->view_ready, &js->lock, until_s);
    const double ms = (clock_s() - from_s) * 1e3 * STREAM_PAYS;
    fair_queue_charge(js->queue[JOB_MOTION], js->stream, ms);
    js->class_ms[JOB_MOTION] = job_class_ms(js, JOB_MOTION) + ms;
}

/* Long work is on all threads that may draw it: the last is left to what is quick. */
static bool job_draws_quick(const struct jobs *js)
{
    return js->cfg.draw_threads > 1 && js->long_drawn + 1 >= js->cfg.draw_threads &&
           clock_s() - js->quick_drawn_s < JOB_QUICK_S;
}

/* What a thread that draws begins next: streams, pictures and map tiles in turns. NULL: nothing is
 * to be done, or the server stops. */
static struct job *job_next_drawn(struct jobs *js, size_t drawer)
{
    static const enum job_class order[] = {JOB_VIEW, JOB_MAP, JOB_MOTION};
    enum { N = sizeof order / sizeof *order };
    if (js->cfg.rests && js->cfg.rests(js->cfg.user, drawer))
        return NULL;
    const bool quick = job_draws_quick(js);
    enum job_class c = job_least(js, order, N, quick);
    for (double until_s; !js->stopping && (until_s = job_begins_s(js, c)) > 0;) {
        job_await_stream(js, until_s);
        c = job_least(js, order, N, quick);
    }
    struct job *j = js->stopping ? NULL : job_take(js, c, quick);
    if (!j && !js->stopping && job_next(js, JOB_AHEAD, quick)) {
        struct fair_queue_item *ahead = job_next(js, JOB_AHEAD, quick);
        fair_queue_take(js->queue[JOB_AHEAD], ahead);
        j = job_at(ahead);
    }
    if (j)
        js->long_drawn += j->counts_long = j->predicted_ms >= job_long_ms(js);
    return j;
}

/* One of several threads is left to what is quick, while such work comes. */
static struct job *job_next_tile(struct jobs *js)
{
    static const enum job_class order[] = {JOB_TILE, JOB_SLOW};
    const bool slow = js->stats.running[JOB_SLOW] + 1 < js->cfg.tile_threads ||
                      clock_s() - js->quick_s > JOB_QUICK_S || js->cfg.tile_threads == 1;
    struct job *j = job_take(js, job_least(js, order, 1 + slow, false), false);
    return j ? j : job_at(fair_queue_next(js->queue[JOB_PREFETCH]));
}

static struct job *job_next_of(struct jobs *js, const struct job_thread *w)
{
    switch (w->duty) {
    case JOB_DRAWS:
        return job_next_drawn(js, w->index);
    case JOB_WAITS:
        return job_at(fair_queue_next(js->queue[JOB_ERRAND]));
    default:
        return job_next_tile(js);
    }
}

/* Until there may be work. Of several threads that draw one looks again if it left work. */
static void job_await_work(struct jobs *js, const struct job_thread *w)
{
    if (w->duty != JOB_DRAWS)
        pthread_cond_wait(w->duty == JOB_WAITS ? &js->errand_ready : &js->tile_ready, &js->lock);
    else if (js->cfg.draw_threads > 1)
        (void)pool_cond_wait(&js->view_ready, &js->lock, clock_s() + AGAIN_S);
    else
        pthread_cond_wait(&js->view_ready, &js->lock);
}

static void job_worker_main(void *user)
{
    struct job_thread *w = user;
    struct jobs *js = w->js;
    if (w->duty == JOB_ENCODES)
        pool_alone(); /* --workers says how many threads tiles have */
    pthread_mutex_lock(&js->lock);
    w->since_s = 0;
    while (!js->stopping) {
        struct job *j = job_next_of(js, w);
        if (!j) {
            if (!js->stopping)
                job_await_work(js, w);
            continue;
        }
        j->running = true;
        j->drawer = w->index;
        j->started_s = w->since_s = clock_s();
        js->stats.running[j->cls]++;
        pthread_mutex_unlock(&js->lock);
        job_run(js, j, (size_t)(w - js->workers));
        pthread_mutex_lock(&js->lock);
        w->since_s = 0;
    }
    w->ended = true;
    pthread_cond_broadcast(&js->ended);
    pthread_mutex_unlock(&js->lock);
}

/* ---- the interface ---- */

enum err_code job_open(const struct job_config *cfg, struct jobs **out, struct err *e)
{
    struct jobs *js = mem_array(1, sizeof *js);
    const size_t draw_end = cfg->tile_threads + cfg->draw_threads, n = draw_end + 1;
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
    pthread_cond_init(&js->errand_ready, NULL);
    pool_cond_init(&js->view_ready);
    pool_cond_init(&js->ended);
    for (int c = 0; c < JOB_CLASSES && !rc; c++)
        rc = fair_queue_open(c == JOB_VIEW, &js->queue[c], e);
    if (!rc)
        rc = rate_open(cfg->client_views_s, JOB_BURST_S, &js->rate[JOB_VIEW], e);
    if (!rc)
        rc = rate_open(cfg->client_tiles_s, JOB_BURST_S, &js->rate[JOB_TILE], e);
    for (; js->n_workers < n && !rc; js->n_workers += !rc) {
        struct job_thread *w = &js->workers[js->n_workers];
        w->js = js;
        w->duty = js->n_workers < cfg->tile_threads ? JOB_ENCODES
                  : js->n_workers < draw_end        ? JOB_DRAWS
                                                    : JOB_WAITS;
        w->index = js->n_workers - (w->duty == JOB_DRAWS   ? cfg->tile_threads
                                    : w->duty == JOB_WAITS ? draw_end
                                                           : 0);
        w->since_s = clock_s();
        rc = pool_start(job_worker_main, w, &w->thread, e);
    }
    if (rc)
        (void)job_close(out);
    return rc;
}

size_t job_drawer(const struct job *j)
{
    return j->drawer;
}

void job_count(struct jobs *js, struct job_stats *out)
{
    pthread_mutex_lock(&js->lock);
    *out = js->stats;
    for (int c = 0; c < JOB_CLASSES; c++)
        out->queued[c] = fair_queue_count(js->queue[c]);
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
    const double now_s = clock_s();
    double most_s = 0;
    for (size_t i = 0; i < js->n_workers; i++)
        if (js->workers[i].duty == JOB_DRAWS && js->workers[i].since_s > 0)
            most_s = fmax(most_s, now_s - js->workers[i].since_s);
    pthread_mutex_unlock(&js->lock);
    return most_s;
}

/* Under the lock. */
static bool job_drawers_ended(const struct jobs *js)
{
    for (size_t i = 0; i < js->n_workers; i++)
        if (js->workers[i].duty == JOB_DRAWS && !js->workers[i].ended)
            return false;
    return true;
}

/* Wait for the threads that draw, as long as that may take; whoever asks again has waited
 * already. */
static bool job_await_drawers(struct jobs *js)
{
    const double again_s = 0.5;
    double wait_s = js->cfg.stop_s > 0 ? js->cfg.stop_s : 10;
    if (js->drawer_hangs)
        wait_s = fmin(wait_s, again_s);
    const double end_s = clock_s() + wait_s;
    pthread_mutex_lock(&js->lock);
    while (!job_drawers_ended(js) && pool_cond_wait(&js->ended, &js->lock, end_s))
        continue;
    bool ended = job_drawers_ended(js);
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
    pthread_cond_broadcast(&js->errand_ready);
    pthread_mutex_unlock(&js->lock);
    job_claim_where(js, 0, &stop, true);
    if (js->cfg.stop)
        js->cfg.stop(js->cfg.user);
    bool ended = job_await_drawers(js);
    for (size_t i = 0; i < js->n_workers; i++)
        if (js->workers[i].thread && (ended || js->workers[i].duty != JOB_DRAWS))
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
    pthread_cond_destroy(&js->errand_ready);
    pthread_cond_destroy(&js->ended);
    pthread_mutex_destroy(&js->lock);
    for (int c = 0; c < JOB_CLASSES; c++) {
        fair_queue_close(&js->queue[c]);
        rate_close(&js->rate[c]);
    }
    mem_free(js->workers);
    mem_free(js);
    return true;
}
