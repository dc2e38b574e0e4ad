/* A second process, for those that send requests: it is opened, gets one request at a time, is
 * stopped and closed.
 *
 * One thread sends requests. Another one, the keeper (worker_keep.c), owns the process. A call in
 * progress sets `asking`, so that descriptors stay open until it has ended.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/worker_life.h"

#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/pool.h"

enum { WORKER_LOOK_MS = 5 /* how often it is asked whether anybody still waits */ };

enum err_code worker_open(const struct worker_config *cfg, struct worker **out, struct err *e)
{
    struct worker *w = mem_array(1, sizeof *w);
    *out = w;
    if (!w || !(w->hello = mem_array(cfg->n_hello, 1))) {
        mem_free(w);
        *out = NULL;
        return err_set(e, ERR_MEM, "worker: out of memory");
    }
    w->cfg = *cfg;
    memcpy(w->hello, cfg->hello, cfg->n_hello);
    w->cfg.hello = NULL; /* the caller's */
    w->fd = w->memory = -1;
    pthread_mutex_init(&w->lock, NULL);
    pool_cond_init(&w->changed);
    enum err_code rc = pool_start(worker_keep, w, &w->keeper, e);
    if (rc)
        worker_close(out);
    return rc;
}

void worker_stop(struct worker *w)
{
    pthread_mutex_lock(&w->lock);
    w->stopping = true;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
}

void worker_close(struct worker **out)
{
    struct worker *w = *out;
    *out = NULL;
    if (!w)
        return;
    worker_stop(w);
    if (w->keeper)
        pool_join(&w->keeper);
    pthread_cond_destroy(&w->changed);
    pthread_mutex_destroy(&w->lock);
    mem_free(w->hello);
    mem_free(w);
}

void worker_status(struct worker *w, struct worker_status *out)
{
    pthread_mutex_lock(&w->lock);
    double now_s = clock_s();
    *out = w->now;
    out->cpu_s += w->cpu_s;
    out->wait_s = fmax(0, w->again_s - now_s);
    out->failing_s = w->failing_since_s > 0 ? now_s - w->failing_since_s : 0;
    pthread_mutex_unlock(&w->lock);
}

enum err_code worker_ready(struct worker *w, bool (*stop)(const void *user), const void *user,
                           uint64_t *life, struct err *e)
{
    enum err_code rc = ERR_OK;
    pthread_mutex_lock(&w->lock);
    while (!rc && (w->now.state != WORKER_READY || w->failed)) {
        double wait_s = w->again_s - clock_s();
        if (w->stopping || (stop && stop(user)))
            rc = err_set(e, ERR_CANCEL, "cancelled");
        else if (w->now.state == WORKER_OFF)
            rc = err_set(e, ERR_BUSY,
                         "pictures are off: the device did not start, and is tried again in %.0f "
                         "s; the server's log says why",
                         fmax(1, ceil(wait_s)));
        else if (wait_s > 0)
            rc = err_set(e, ERR_BUSY,
                         "the process that draws has ended %u times in a row; it is started again "
                         "in %.0f s",
                         w->failures, ceil(wait_s));
        else
            worker_wait(w, WORKER_LOOK_MS * 4e-3);
    }
    *life = w->life;
    pthread_mutex_unlock(&w->lock);
    return rc;
}

/* The clocks of two processes have different zeros: the answer was sent now. */
static void worker_tell_spans(const struct worker *w, const struct worker_answer *a)
{
    const double now_s = clock_s(), later_s = now_s - a->sent_s;
    for (uint32_t i = 0; w->cfg.span && i < a->n_spans && i < WORKER_SPANS; i++) {
        const double from_s = a->span[i].from_s + later_s, to_s = a->span[i].to_s + later_s;
        if (from_s > 0 && from_s <= to_s && to_s <= now_s)
            w->cfg.span(a->span[i].what, from_s, to_s);
    }
}

/* Wait for the answer and take its bytes. ERR_IO, ERR_FORMAT, ERR_BUSY: this life is over. */
static enum err_code worker_hear(struct worker *w, const struct worker_head *h, size_t limit,
                                 bool (*stop)(const void *user), const void *user, struct buf *out,
                                 struct err *e)
{
    const double start_s = clock_s();
    struct worker_head cancel = *h;
    struct worker_answer a;
    bool got = false, told = false;
    enum err_code rc = ERR_OK;
    cancel.cancel = true;
    while (!rc && !got) {
        rc = worker_packet_receive(w->fd, h->number, WORKER_LOOK_MS, &a, &got, e);
        if (rc || got)
            break;
        if (!told && stop && stop(user)) {
            told = true;
            rc = worker_packet_send(w->fd, &cancel, NULL, 0, -1, e);
        }
        double took_s = clock_s() - start_s;
        if (!rc && w->cfg.ask_s > 0 && took_s > w->cfg.ask_s)
            rc = err_set(e, ERR_BUSY, "not made in %.0f s", took_s);
    }
    if (rc)
        return rc;
    worker_tell_spans(w, &a);
    pthread_mutex_lock(&w->lock);
    w->now.cpu_s = a.cpu_s;
    w->now.peak_bytes = a.peak_bytes;
    w->now.cancels += a.code == ERR_CANCEL;
    w->leaves = a.leaves;
    pthread_mutex_unlock(&w->lock);
    if (a.code || told) { /* an error of the call, not of the connection */
        err_set(e, a.code ? (enum err_code)a.code : ERR_CANCEL, "%s",
                a.code ? a.text : "cancelled");
        return ERR_OK;
    }
    if (a.n_bytes > limit)
        return err_set(e, ERR_FORMAT, "an answer of %llu bytes where %zu are the most",
                       (unsigned long long)a.n_bytes, limit);
    return worker_packet_take(w->memory, (size_t)a.n_bytes, out, e);
}

/* A call has ended, with it this life if rc is an error. Is all to stop? */
static bool worker_answered(struct worker *w, enum err_code rc)
{
    pthread_mutex_lock(&w->lock);
    w->asking = false;
    if (rc) {
        w->failed = true;
        w->now.state = WORKER_AGAIN;
        w->killed = rc != ERR_IO && !w->stopping;
        if (rc != ERR_IO && w->now.pid > 0)
            kill(w->now.pid, SIGKILL);
    } else if (w->leaves) {
        w->asked_s = 0;
        w->failed = true;
        w->now.state = WORKER_AGAIN;
    } else {
        w->asked_s = 0;
    }
    bool stopping = w->stopping;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
    return stopping;
}

/* NOLINTNEXTLINE(readability-function-size): its parameters */
enum err_code worker_ask(struct worker *w, uint64_t life, const void *request, size_t n, int fd,
                         size_t limit, bool (*stop)(const void *user), const void *user,
                         struct buf *out, struct err *e)
{
    struct err own = {0}, *said = &own;
    struct worker_head h = {.magic = WORKER_MAGIC};
    pthread_mutex_lock(&w->lock);
    bool there = w->now.state == WORKER_READY && w->life == life && !w->failed && !w->stopping;
    w->asking = there;
    w->asked_s = there ? clock_s() : w->asked_s;
    h.number = ++w->number;
    pthread_mutex_unlock(&w->lock);
    if (!there)
        return err_set(e, ERR_BUSY, "the process that draws is started again");
    enum err_code rc = worker_packet_send(w->fd, &h, request, n, fd, said);
    if (!rc)
        rc = worker_hear(w, &h, limit, stop, user, out, said);
    bool over = rc && rc != ERR_MEM, stopping = worker_answered(w, over ? rc : ERR_OK);
    if (over && stopping)
        return err_set(e, ERR_CANCEL, "cancelled");
    if (over)
        return err_set(e, ERR_DEVICE,
                       "the process that draws ended at this (%s); it is started "
                       "again",
                       said->msg);
    if (own.code != ERR_DEVICE)
        return own.code ? err_set(e, own.code, "%s", own.msg) : rc;
    log_error("serve", "the device failed: %s", own.msg); /* it may hold a driver's log */
    return err_set(e, ERR_DEVICE, "the device failed at this; the server's log says why");
}
