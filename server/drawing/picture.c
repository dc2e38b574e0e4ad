/* Pictures for clients that cannot draw Gaussians, made by processes that draw (draw.c). This side
 * knows the datasets, and decides which of them a process has open in which slot. It forgets that
 * when a new process starts. Without a device the server still answers tiles, and says why it has
 * no pictures.
 *
 * Each process belongs to one thread of jobs. One that is not ready leaves all work to those that
 * are. `lock` guards the slots, because an old dataset is closed when nobody but the slots has it;
 * workers have locks of their own.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/picture.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "core/trace.h"
#include "lod/store/store.h"

enum { PICTURE_NICE = 5 };
static const double PAUSE_S = 0.25, PAUSE_MOST_S = 30, STEADY_S = 10;
static const double START_S = 60; /* at least: kernels may have to be compiled */

struct drawer {            /* one process */
    struct worker *worker; /* NULL: not started */
    uint64_t life, tick;
    uint32_t stale; /* a bit a slot: it may hold what is not known here */
    struct {
        struct dataset *ds; /* a reference: a file that was restored is another dataset */
        uint64_t used;
    } slot[DRAW_SLOTS];
};
struct picture {
    const struct server_config *cfg;
    const struct memory_plan *plan;
    uint32_t n_slots;
    pthread_mutex_t lock;
    size_t n;
    struct drawer *drawer; /* [n] */
};

enum err_code picture_open(const struct server_config *cfg, const struct memory_plan *plan,
                           struct picture **out, struct err *e)
{
    struct picture *p = mem_array(1, sizeof *p);
    *out = p;
    if (!p)
        return err_set(e, ERR_MEM, "picture: out of memory");
    p->cfg = cfg;
    p->plan = plan;
    p->n_slots = plan->slots ? plan->slots : DRAW_SLOTS;
    p->n = plan->drawers ? plan->drawers : 1;
    pthread_mutex_init(&p->lock, NULL);
    p->drawer = mem_array(p->n, sizeof *p->drawer);
    if (p->drawer)
        return ERR_OK;
    picture_close(out);
    return err_set(e, ERR_MEM, "picture: out of memory");
}

static void picture_text(char *out, size_t room, const char *text)
{
    snprintf(out, room, "%s", text ? text : "");
}

static void picture_span(uint32_t stage, double from_s, double to_s)
{
    static const char *const names[DRAW_STAGES] = {
        [DRAW_OPENS] = "open store", [DRAW_PICKS] = "pick tiles", [DRAW_LOADS] = "load tiles",
        [DRAW_DRAWS] = "draw",       [DRAW_MEASURES] = "measure", [DRAW_ENCODES] = "encode",
        [DRAW_MAKES] = "make"};
    if (stage < DRAW_STAGES)
        trace_span("drawing", names[stage], from_s, to_s);
}

enum err_code picture_start(struct picture *p, struct err *e)
{
    const struct server_config *cfg = p->cfg;
    struct draw_hello *h = mem_array(1, sizeof *h);
    if (!h)
        return err_set(e, ERR_MEM, "picture: out of memory");
    picture_text(h->device, sizeof h->device, cfg->device);
    picture_text(h->geoid, sizeof h->geoid, cfg->geoid);
    h->view_cache_bytes = p->plan->view_cache;
    h->memory_bytes = p->plan->drawing / p->n;
    h->slots = p->n_slots;
    h->view_gaussians = (uint64_t)cfg->view_gaussians;
    h->nice = PICTURE_NICE;
    h->log_json = log_is_json();
    double most_s = cfg->device_timeout_s;
    const struct worker_config w = {.hello = h,
                                    .n_hello = sizeof *h,
                                    .start_s = most_s > 0 ? fmax(most_s, START_S) : 0,
                                    .ask_s = most_s,
                                    .pause_s = PAUSE_S,
                                    .pause_most_s = PAUSE_MOST_S,
                                    .off_pause_s = cfg->again_s,
                                    .off_pause_most_s = 60 * cfg->again_s,
                                    .steady_s = STEADY_S,
                                    .span = picture_span};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < p->n && !rc; i++)
        rc = worker_open(&w, &p->drawer[i].worker, e);
    mem_free(h);
    return rc;
}

void picture_stop(struct picture *p)
{
    for (size_t i = 0; p && i < p->n; i++)
        if (p->drawer[i].worker)
            worker_stop(p->drawer[i].worker);
}

static void picture_forget(struct drawer *w)
{
    for (int i = 0; i < DRAW_SLOTS; i++)
        if (w->slot[i].ds)
            dataset_drop(&w->slot[i].ds);
    memset(w->slot, 0, sizeof w->slot);
    w->stale = 0;
}

void picture_close(struct picture **out)
{
    struct picture *p = *out;
    *out = NULL;
    if (!p)
        return;
    picture_stop(p); /* all at once */
    for (size_t i = 0; p->drawer && i < p->n; i++) {
        worker_close(&p->drawer[i].worker);
        picture_forget(&p->drawer[i]);
    }
    pthread_mutex_destroy(&p->lock);
    mem_free(p->drawer);
    mem_free(p);
}

/* How far a process is from drawing. */
static int picture_rank(enum worker_state s)
{
    static const int ranks[] = {
        [WORKER_READY] = 0, [WORKER_STARTING] = 1, [WORKER_AGAIN] = 2, [WORKER_OFF] = 3};
    return ranks[s];
}

static void picture_add(struct worker_status *all, const struct worker_status *one)
{
    const int rank = picture_rank(one->state), best = picture_rank(all->state);
    if (rank < best || (rank == best && one->wait_s < all->wait_s)) {
        all->state = one->state;
        all->wait_s = one->wait_s;
        all->pid = one->pid;
    }
    if ((one->known && !all->known) || !all->about[0])
        memcpy(all->about, one->about, sizeof all->about);
    all->known |= one->known;
    all->failing_s = fmin(all->failing_s, one->failing_s);
    all->starts += one->starts;
    all->crashes += one->crashes;
    all->kills += one->kills;
    all->cancels += one->cancels;
    all->renewals += one->renewals;
    all->cpu_s += one->cpu_s;
    all->peak_bytes = one->peak_bytes > all->peak_bytes ? one->peak_bytes : all->peak_bytes;
}

size_t picture_status(const struct picture *p, struct worker_status *out)
{
    size_t n_ready = 0;
    memset(out, 0, sizeof *out);
    for (size_t i = 0; i < p->n; i++) {
        struct worker_status one = {0};
        if (p->drawer[i].worker)
            worker_status(p->drawer[i].worker, &one);
        n_ready += one.state == WORKER_READY;
        if (i)
            picture_add(out, &one);
        else
            *out = one;
    }
    return n_ready;
}

size_t picture_held_bytes(const struct picture *p)
{
    size_t all = 0;
    for (size_t i = 0; i < p->n; i++) {
        struct worker_status one = {0};
        if (p->drawer[i].worker)
            worker_status(p->drawer[i].worker, &one);
        all += one.pid > 0 ? mem_held_bytes((int)one.pid) : 0;
    }
    return all;
}

bool picture_rests(const struct picture *p, size_t drawer)
{
    struct worker_status own, all;
    if (p->n == 1)
        return false;
    worker_status(p->drawer[drawer].worker, &own);
    return own.state != WORKER_READY && picture_status(p, &all) > 0;
}

enum picture_state picture_state(const struct picture *p)
{
    struct worker_status st;
    picture_status(p, &st);
    return st.known ? PICTURE_READY : st.state == WORKER_OFF ? PICTURE_OFF : PICTURE_STARTING;
}

void picture_about(struct picture *p, char *out, size_t n)
{
    struct worker_status st;
    picture_status(p, &st);
    if (st.state == WORKER_OFF)
        snprintf(out, n, "the device did not start, and is tried again; the server's log says why");
    else
        snprintf(out, n, "%s", st.about);
}

/* Has nobody but the slots this dataset? */
static bool picture_alone(const struct picture *p, const struct dataset *d)
{
    unsigned n = 0;
    for (size_t i = 0; i < p->n; i++)
        for (uint32_t k = 0; k < p->n_slots; k++)
            n += p->drawer[i].slot[k].ds == d;
    return dataset_is_last(d, n);
}

/* With the lock: the slot of a dataset. Those that nobody else has any more are emptied; then the
 * one unused for longest makes room. True: it has to be opened. */
static bool picture_slot(struct picture *p, struct drawer *w, struct dataset *d,
                         struct draw_request *q)
{
    uint32_t oldest = 0;
    q->drop = w->stale;
    w->stale = 0;
    q->opens = false;
    for (uint32_t i = 0; i < p->n_slots; i++) {
        if (w->slot[i].ds && picture_alone(p, w->slot[i].ds)) {
            dataset_drop(&w->slot[i].ds);
            w->slot[i].used = 0;
            q->drop |= 1u << i;
        }
        if (w->slot[i].ds == d) {
            q->slot = i;
            w->slot[i].used = ++w->tick;
            return false;
        }
        if (w->slot[i].used < w->slot[oldest].used)
            oldest = i;
    }
    if (w->slot[oldest].ds)
        dataset_drop(&w->slot[oldest].ds);
    q->slot = oldest;
    q->opens = true;
    w->slot[oldest].used = ++w->tick;
    return true;
}

static bool picture_stopped(const void *job)
{
    return job_cancelled(job);
}

enum err_code picture_make(struct picture *p, size_t drawer, const struct job *j, struct dataset *d,
                           struct draw_request *q, size_t limit, struct buf *out, struct err *e)
{
    uint64_t life = 0;
    struct drawer *w = &p->drawer[drawer];
    enum err_code rc = worker_ready(w->worker, picture_stopped, j, &life, e);
    if (rc)
        return rc;
    pthread_mutex_lock(&p->lock);
    if (life != w->life)
        picture_forget(w);
    w->life = life;
    bool opens = picture_slot(p, w, d, q);
    pthread_mutex_unlock(&p->lock);
    q->antialiased = d->meta.antialiased;
    q->lift_m = d->lift_m;
    snprintf(q->name, sizeof q->name, "%.*s", (int)sizeof q->name - 1, store_path(d->index));
    rc = worker_ask(w->worker, life, q, sizeof *q, opens ? d->fd : -1, limit, picture_stopped, j,
                    out, e);
    pthread_mutex_lock(&p->lock);
    if (opens && !rc) {
        w->slot[q->slot].ds = dataset_ref(d);
    } else if (opens) { /* opened again next time, whatever went wrong */
        w->slot[q->slot].used = 0;
        w->stale |= 1u << q->slot;
    }
    pthread_mutex_unlock(&p->lock);
    return rc;
}
