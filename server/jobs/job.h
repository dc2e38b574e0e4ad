/* Runs slow work outside the HTTP threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_JOB_H
#define SERVER_JOB_H

#include "server/base/body.h"
#include "server/jobs/cost.h"

/* JOB_MOTION: pictures of streams that follow a camera. A stream requests one at a time, so they do
 * not count against rates of clients. JOB_SLOW: work that was submitted as JOB_TILE and takes long.
 * While there are quick tiles, one of several tile threads is reserved for them. JOB_PREFETCH and
 * JOB_AHEAD: tiles and pictures that nobody looks at yet; they run when nothing else waits.
 * JOB_ERRAND: waits for another thread and takes no time of a processor, so it has a thread of its
 * own and does not count against rates of clients. */
enum job_class {
    JOB_VIEW,
    JOB_TILE,
    JOB_PREFETCH,
    JOB_MAP,
    JOB_MOTION,
    JOB_AHEAD,
    JOB_SLOW,
    JOB_ERRAND,
    JOB_CLASSES
};
bool job_is_picture(enum job_class cls); /* picture of a view, requested now or ahead */
/* JOB_SHED: a queue was full, or the wait would be longer than the deadline. JOB_LIMITED: the
 * client requests too much. */
enum job_end { JOB_OK, JOB_ERROR, JOB_CANCELLED, JOB_SHED, JOB_TIMEOUT, JOB_LIMITED, JOB_ENDS };
enum { JOB_BURST_S = 10 }; /* rates of clients are averages over this time */

struct job_result {
    enum job_end end;
    enum err_code code;
    char msg[256];
    struct body *body; /* if end is JOB_OK, a reference that the waiter owns */
    double queue_s, run_s;
    bool coalesced; /* another request had started this job */
    int retry_s;    /* when to ask again; 0: not known */
};

/* A request that waits for a job's result. It lives in the caller's memory from job_submit until it
 * is woken. */
struct job_waiter {
    /* Called exactly once, in another thread and without a lock, unless job_submit refused the
     * waiter or job_leave claimed it. It may free the waiter. */
    void (*wake)(struct job_waiter *w);
    struct job_result result; /* set before wake */
    struct job_waiter *next;  /* this and the rest belong to job_*.c */
    struct job *job;
    double deadline_s;
};

struct job; /* one run; passed to the functions below */
struct job_config {
    /* threads for JOB_TILE, then JOB_PREFETCH; of each client the oldest first */
    size_t tile_threads;
    /* threads that draw: JOB_VIEW (of each client the newest first), JOB_MAP and JOB_MOTION (of
     * each client the oldest first) in turns, then JOB_AHEAD. While there is quick work, one of
     * several begins nothing that takes long. */
    size_t draw_threads;
    /* Returns whether this thread that draws (0..n-1) leaves work to the others now. Called with
     * the lock held, so it must not block. NULL: none does. */
    bool (*rests)(void *user, size_t drawer);
    size_t queue_limit[JOB_CLASSES]; /* of JOB_SLOW and JOB_ERRAND: that of JOB_TILE */
    /* Estimates the time of work by a formula, in ms, and gives its kind (cost.h). The queue learns
     * from the time that it took. Called with the lock held. NULL: 1 ms. */
    double (*cost)(const void *work, struct cost_kind *kind);
    double client_views_s, client_tiles_s; /* new jobs a second for one client; 0: no limit */
    double stop_s; /* how long job_stop waits for the threads that draw; 0 = 10 s */
    /* a failed job is not repeated for this time, which doubles up to 60 s; 0 = 2 s */
    double slow_s;
    void *user;
    /* Makes the body of `work`. It should call job_cancelled where that is cheap. Tile threads pass
     * worker 0..n-1, those that draw and the one for errands the next numbers. */
    enum err_code (*run)(void *user, const struct job *j, void *work, size_t worker,
                         struct body **out, struct err *e);
    void (*drop)(void *user, void *work); /* frees the work */
    /* Returns whether the result is useful only to the clients that wait. The job is then cancelled
     * when they have gone, even while it runs. NULL: only pictures are. */
    bool (*passing)(const void *work); /* called with the lock held, so it must not block */
    void (*stop)(void *user); /* called by job_stop to end running work soon; may be NULL */
};
struct job_stats {
    uint64_t ended[JOB_CLASSES][JOB_ENDS], coalesced, queued[JOB_CLASSES], running[JOB_CLASSES];
    double run_s[JOB_CLASSES]; /* sum */
};
struct jobs;
/* Starts the threads. Close *out with job_close. ERR_MEM. */
enum err_code job_open(const struct job_config *cfg, struct jobs **out, struct err *e) ERR_USE;
/* Requests the work named `id`; equal ids mean equal bytes. The function takes over `work`. ERR_OK:
 * w will be woken. ERR_BUSY: the queue is full, or the server is stopping. ERR_LIMIT: the client
 * requests too much. A failure that is remembered returns its own code, with end JOB_ERROR. After
 * an error w->result has the reason, and w is not woken. `client`, any number that identifies a
 * client, keeps queues fair: clients have equal parts of the time. Work that would wait longer than
 * timeout_s is refused; if it is a JOB_VIEW and the client has older ones waiting, the oldest is
 * shed instead. When a queue is full, the client with most items in it loses one. If that is an
 * older picture of the requesting client, the result is ERR_LIMIT. */
enum err_code job_submit(struct jobs *js, enum job_class cls, struct hash128 id, void *work,
                         uint64_t client, double timeout_s, struct job_waiter *w) ERR_USE;
/* Removes a waiter whose client is gone. True: w was still waiting and will not be woken. A queued
 * job without waiters is dropped. A running one is cancelled if `passing` says so, else finished
 * for the cache. */
bool job_leave(struct jobs *js, struct job_waiter *w);
enum job_class job_class_of(struct jobs *js, const struct job_waiter *w); /* while w waits */
bool job_cancelled(const struct job *j);
size_t job_drawer(const struct job *j); /* 0..n-1: the thread that draws it */
/* Wakes waiters whose deadline has passed. Call it a few times a second. */
void job_tick(struct jobs *js, double now_s);
/* Seconds after which asking again makes sense: 1..10. */
int job_retry_after(struct jobs *js, enum job_class cls);
void job_count(struct jobs *js, struct job_stats *out);
bool job_idle(struct jobs *js); /* whether nothing is queued or running */
/* Allows failed work to be repeated at once, because its cause may be gone. */
void job_forgive(struct jobs *js);
/* How long a thread that draws has been at its present work, including its start, at most; 0: they
 * wait for work. */
double job_drawing_s(struct jobs *js);
/* Refuses new work, wakes every waiter with JOB_SHED, cancels running jobs, waits for them and
 * joins the threads. False: a thread that draws did not end within stop_s, because a driver hangs.
 * Nothing that it uses may then be freed. */
bool job_stop(struct jobs *js);
/* As job_stop, then frees. False: as job_stop; *js remains, and the call may be repeated. */
bool job_close(struct jobs **js);

#endif
