/* Slow work, away from the HTTP threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_JOB_H
#define SERVER_JOB_H

#include "server/body.h"

/* JOB_MOTION: pictures of streams that follow a camera. A stream asks for one at a time, so they
 * are not counted against rates of clients. JOB_PREFETCH and JOB_AHEAD: tiles and pictures that
 * nobody looks at yet; they run when nothing else waits. */
enum job_class { JOB_VIEW, JOB_TILE, JOB_PREFETCH, JOB_MAP, JOB_MOTION, JOB_AHEAD, JOB_CLASSES };
bool job_is_picture(enum job_class cls); /* of a view, now or ahead */
/* JOB_SHED: a queue was full; JOB_LIMITED: the client asks too much. */
enum job_end { JOB_OK, JOB_ERROR, JOB_CANCELLED, JOB_SHED, JOB_TIMEOUT, JOB_LIMITED, JOB_ENDS };
enum { JOB_BURST_S = 10 }; /* rates of clients are averages over this time */

struct job_result {
    enum job_end end;
    enum err_code code;
    char msg[256];
    struct body *body; /* a reference of the waiter's own when end is JOB_OK */
    double queue_s, run_s;
    bool coalesced; /* another request had started this job */
    int retry_s;    /* of JOB_LIMITED: when to ask again */
};

/* Someone who wants a job's result. Lives in the caller's memory from job_submit until it was
 * woken. */
struct job_waiter {
    /* Called exactly once, on another thread, under no lock, unless job_submit refused or job_leave
     * claimed the waiter. The waiter may be freed from inside. */
    void (*wake)(struct job_waiter *w);
    struct job_result result; /* set before wake */
    struct job_waiter *next;  /* the rest belongs to job_*.c */
    struct job *job;
    double deadline_s;
};

struct job; /* one run; passed to the functions below */
struct job_config {
    size_t tile_threads; /* they run JOB_TILE, then JOB_PREFETCH, each client's oldest first */
    bool view_thread;    /* one thread draws: JOB_VIEW, each client's newest first, JOB_MAP and
                         JOB_MOTION, each client's oldest first, in turns, then JOB_AHEAD */
    size_t queue_limit[JOB_CLASSES];
    double client_views_s, client_tiles_s; /* new ones a second of one client; 0: any number */
    double stop_s; /* how long job_stop waits for the thread that draws; 0 = 10 s */
    double slow_s; /* a failed job is not tried again for this long, doubling to 60 s; 0 = 2 s */
    void *user;
    /* Make the body of `work`; poll job_cancelled where it is cheap. Tile threads pass worker
     * 0..n-1. */
    enum err_code (*run)(void *user, const struct job *j, void *work, size_t worker,
                         struct body **out, struct err *e);
    void (*drop)(void *user, void *work); /* free the work */
    /* Is it of use to nobody but those who wait for it? Then it is cancelled when they have gone,
     * even while it runs. NULL: pictures are. */
    bool (*passing)(const void *work); /* called under the lock: it only looks */
    void (*stop)(void *user); /* by job_stop: what still runs is to end soon; may be NULL */
};
struct job_stats {
    uint64_t ended[JOB_CLASSES][JOB_ENDS], coalesced, queued[JOB_CLASSES], running[JOB_CLASSES];
    double run_s[JOB_CLASSES]; /* sum */
};
struct jobs;
/* job_close it. ERR_MEM. */
enum err_code job_open(const struct job_config *cfg, struct jobs **out, struct err *e) ERR_USE;
/* Ask for the work named `id` (equal ids are equal bytes). `work` is owned by the callee from here
 * on. ERR_OK: w will be woken. ERR_BUSY: the queue is full or the server is stopping; ERR_LIMIT:
 * the client asks too much; w->result says so and w is not woken. A known failure is refused the
 * same way with its own code and end JOB_ERROR. `client` (any number that tells clients apart)
 * keeps queues fair: clients take turns, and when a queue is full the one with most in it gives
 * way, which is ERR_LIMIT where it is an older picture of the one who asks. */
enum err_code job_submit(struct jobs *js, enum job_class cls, struct hash128 id, void *work,
                         uint64_t client, double timeout_s, struct job_waiter *w) ERR_USE;
/* The client is gone. True: w was still waiting, is out of the job now and will not be woken. A job
 * that lost its last waiter is dropped from the queue; a running one is cancelled where it is
 * passing, else finished for the cache. */
bool job_leave(struct jobs *js, struct job_waiter *w);
enum job_class job_class_of(struct jobs *js, const struct job_waiter *w); /* while w waits */
bool job_cancelled(const struct job *j);
/* Wake waiters whose deadline is over; called a few times a second. */
void job_tick(struct jobs *js, double now_s);
/* Seconds after which asking again makes sense: 1..10. */
int job_retry_after(struct jobs *js, enum job_class cls);
void job_count(struct jobs *js, struct job_stats *out);
bool job_idle(struct jobs *js); /* nothing queued, nothing running */
/* What failed may be tried again at once: its cause may be gone. */
void job_forgive(struct jobs *js);
/* How long the thread that draws has been at what it does now, its start counted; 0: it waits for
 * work. */
double job_drawing_s(struct jobs *js);
/* Refuse new work, wake every waiter with JOB_SHED, wait for the running jobs (cancelled), join.
 * False: the thread that draws does not end (stop_s): a driver hangs, which nobody can stop, and
 * nothing that it uses may be freed. */
bool job_stop(struct jobs *js);
/* job_stop, then free. False: as there; *js stays, and this may be tried again. */
bool job_close(struct jobs **js);

#endif
