/* Pictures for clients that cannot draw Gaussians, made by the process that draws (draw.c). This
 * side knows the datasets, and decides which of them that process has open in which slot. It
 * forgets that when a new process starts. Without a device the server still answers tiles, and says
 * why it has no pictures.
 *
 * The slots belong to the drawing thread; the worker has its own lock.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/picture.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/trace.h"
#include "lod/store.h"

enum { PICTURE_NICE = 5 };
static const double PAUSE_S = 0.25, PAUSE_MOST_S = 30, STEADY_S = 10;
static const double START_S = 60; /* at least: kernels may have to be compiled */

struct picture {
    const struct server_config *cfg;
    const struct memory_plan *plan;
    uint32_t n_slots;
    struct worker *worker; /* NULL: not started */
    uint64_t life, tick;
    uint32_t stale; /* a bit a slot: it may hold what is not known here */
    struct {
        struct dataset *ds; /* a reference: a file that was restored is another dataset */
        uint64_t used;
    } slot[DRAW_SLOTS];
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
    return ERR_OK;
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
    picture_text(h->geoid_dir, sizeof h->geoid_dir, cfg->geoid_dir);
    h->view_cache_bytes = p->plan->view_cache;
    h->memory_bytes = p->plan->drawing;
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
                                    .steady_s = STEADY_S,
                                    .span = picture_span};
    enum err_code rc = worker_open(&w, &p->worker, e);
    mem_free(h);
    return rc;
}

void picture_stop(struct picture *p)
{
    if (p && p->worker)
        worker_stop(p->worker);
}

static void picture_forget(struct picture *p)
{
    for (int i = 0; i < DRAW_SLOTS; i++)
        if (p->slot[i].ds)
            dataset_drop(&p->slot[i].ds);
    memset(p->slot, 0, sizeof p->slot);
    p->stale = 0;
}

void picture_close(struct picture **out)
{
    struct picture *p = *out;
    *out = NULL;
    if (!p)
        return;
    worker_close(&p->worker);
    picture_forget(p);
    mem_free(p);
}

void picture_status(const struct picture *p, struct worker_status *out)
{
    memset(out, 0, sizeof *out);
    if (p->worker)
        worker_status(p->worker, out);
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
    snprintf(out, n, "%s", st.about);
}

/* The slot of a dataset. Those that nobody else has any more are emptied; then the one unused for
 * longest makes room. True: it has to be opened. */
static bool picture_slot(struct picture *p, struct dataset *d, struct draw_request *q)
{
    uint32_t oldest = 0;
    q->drop = p->stale;
    p->stale = 0;
    q->opens = false;
    for (uint32_t i = 0; i < p->n_slots; i++) {
        if (p->slot[i].ds && dataset_is_last(p->slot[i].ds)) {
            dataset_drop(&p->slot[i].ds);
            p->slot[i].used = 0;
            q->drop |= 1u << i;
        }
        if (p->slot[i].ds == d) {
            q->slot = i;
            p->slot[i].used = ++p->tick;
            return false;
        }
        if (p->slot[i].used < p->slot[oldest].used)
            oldest = i;
    }
    if (p->slot[oldest].ds)
        dataset_drop(&p->slot[oldest].ds);
    q->slot = oldest;
    q->opens = true;
    p->slot[oldest].used = ++p->tick;
    return true;
}

static bool picture_stopped(const void *job)
{
    return job_cancelled(job);
}

enum err_code picture_make(struct picture *p, const struct job *j, struct dataset *d,
                           struct draw_request *q, size_t limit, struct buf *out, struct err *e)
{
    uint64_t life = 0;
    enum err_code rc = worker_ready(p->worker, picture_stopped, j, &life, e);
    if (rc)
        return rc;
    if (life != p->life)
        picture_forget(p);
    p->life = life;
    bool opens = picture_slot(p, d, q);
    q->antialiased = d->meta.antialiased;
    snprintf(q->name, sizeof q->name, "%.*s", (int)sizeof q->name - 1, store_path(d->index));
    rc = worker_ask(p->worker, life, q, sizeof *q, opens ? d->fd : -1, limit, picture_stopped, j,
                    out, e);
    if (opens && !rc) {
        p->slot[q->slot].ds = dataset_ref(d);
    } else if (opens) { /* opened again next time, whatever went wrong */
        p->slot[q->slot].used = 0;
        p->stale |= 1u << q->slot;
    }
    return rc;
}
