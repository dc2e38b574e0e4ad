/* A second process of the same program that does what must not take this one down: it is started,
 * asked one thing at a time, killed when it does not answer, and started again when it has ended.
 * What it is asked are bytes to this file; draw.h knows them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORKER_H
#define SERVER_WORKER_H

#include <sys/types.h>

#include "core/base.h"

#define WORKER_ARGUMENT "draw-for-serve" /* the program's only argument in its second process */
enum { WORKER_REQUEST_MAX = 16384, WORKER_ABOUT = 160 };

/* ---- this process ---- */

struct worker;
struct worker_config {
    const void *hello; /* [n_hello], copied: the first thing that it is told, to get ready */
    size_t n_hello;
    double start_s; /* longest time to get ready; 0: any */
    double ask_s;   /* longest time for one answer; 0: any */
    double pause_s; /* before the third start; doubles up to */
    double pause_most_s;
    double steady_s; /* whoever was well for so long begins anew: no pause */
};
enum worker_state {
    WORKER_STARTING, /* for the first time */
    WORKER_READY,
    WORKER_OFF,  /* it said at its first start that it never will be; about says why */
    WORKER_AGAIN /* it has ended; it is started again, after wait_s */
};
struct worker_status {
    enum worker_state state;
    char about[WORKER_ABOUT]; /* what it said when it was ready, kept from then on */
    bool known;               /* it was ready once */
    double wait_s;            /* until the next start */
    double failing_s;         /* since it ended for the first time without being well since */
    pid_t pid;                /* 0: none */
    uint64_t starts, crashes, kills, cancels; /* kills: of those that did not answer */
    double cpu_s;                             /* of all, as far as they told */
    uint64_t peak_bytes;                      /* of the last one */
};

/* Start it, and a thread that keeps it. worker_close it. ERR_MEM; that it does not start is told by
 * its status. */
enum err_code worker_open(const struct worker_config *cfg, struct worker **out,
                          struct err *e) ERR_USE;
/* Tell it to end, and kill it if it does not within a second. No call may be under way. */
void worker_close(struct worker **w);
/* From now on calls under way end soon: ERR_CANCEL. Any thread. */
void worker_stop(struct worker *w);
void worker_status(struct worker *w, struct worker_status *out); /* any thread */
/* One thread at a time, as the next one. Wait until it is ready; *life is another number after each
 * start: a new one knows nothing of what the one before was told. ERR_BUSY: it pauses before it is
 * started again; ERR_DEVICE: it is off; ERR_CANCEL: stop (may be NULL) said so. */
enum err_code worker_ready(struct worker *w, bool (*stop)(const void *user), const void *user,
                           uint64_t *life, struct err *e) ERR_USE;
/* Ask this life of it; its answer is appended to out, at most `limit` bytes. fd goes along unless
 * it is -1. It is told when stop says that nobody wants the answer any more. Its own error;
 * ERR_DEVICE: it ended at this, or was ended because it did not answer in time or answered
 * nonsense; ERR_BUSY: that life is over; ERR_CANCEL, ERR_MEM. */
enum err_code worker_ask(struct worker *w, uint64_t life, const void *request, size_t n, int fd,
                         size_t limit, bool (*stop)(const void *user), const void *user,
                         struct buf *out, struct err *e) ERR_USE;

/* ---- the other process ---- */

struct worker_service {
    /* Get ready: *user is passed to the others, about is text for the status. */
    enum err_code (*open)(const void *hello, size_t n, void **user, char about[WORKER_ABOUT],
                          struct err *e);
    /* fd is -1, or taken by the callee. */
    enum err_code (*run)(void *user, const void *request, size_t n, int fd, struct buf *out,
                         struct err *e);
    void (*close)(void *user); /* also after an open that failed, if it set *user */
};
bool worker_asked(int argc, char **argv); /* Is this process to be that one? */
/* Answer until the other process ends. Returns the exit code. */
int worker_main(const struct worker_service *s);
/* Does nobody want what is being made any more? To be asked now and then: a microsecond. user is
 * not looked at. In any other process: no. */
bool worker_cancelled(const void *user);

/* ---- between the two ---- */

struct worker_head { /* in front of each request; a packet each */
    uint32_t magic, cancel;
    uint64_t number;
};
struct worker_answer { /* the bytes themselves are in the shared file, which `memory` went along for
                          with the first request */
    uint32_t magic, code;
    uint64_t number, n_bytes, peak_bytes;
    double cpu_s;
    char text[sizeof((struct err *)NULL)->msg]; /* of the error; of the first answer: about */
};
enum { WORKER_MAGIC = 0x43535744, WORKER_FD = 3 };

#endif
