/* A second process of the same program, for work whose crash must not end this one. It is started,
 * gets one request at a time, is killed if it does not answer, and is started again if it ends.
 * Requests are opaque bytes here; draw.h defines them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORKER_H
#define SERVER_WORKER_H

#include <sys/types.h>

#include "core/base.h"

/* the only argument of the program in its second process */
#define WORKER_ARGUMENT "draw-for-serve"
enum { WORKER_REQUEST_MAX = 16384, WORKER_ABOUT = 160, WORKER_SPANS = 8 };

/* ---- this process ---- */

struct worker;
struct worker_config {
    const void *hello; /* [n_hello], copied: the first message, to get ready */
    size_t n_hello;
    double start_s; /* longest time for the process to get ready; 0: no limit */
    double ask_s;   /* longest time for one answer; 0: no limit */
    double pause_s; /* pause before the third start; it doubles up to pause_most_s */
    double pause_most_s;
    /* pause after a first start at which the process said that it cannot work; doubles too */
    double off_pause_s, off_pause_most_s;
    double steady_s; /* after this time without a failure the pause starts anew */
    /* Called for what an answer says about its making, by the thread that asked; may be NULL. The
     * process may say anything, but 0 < from_s <= to_s <= now. */
    void (*span)(uint32_t what, double from_s, double to_s);
};
enum worker_state {
    WORKER_STARTING, /* for the first time */
    WORKER_READY,
    WORKER_OFF,  /* it said that it cannot work, and never did; it is tried again after wait_s */
    WORKER_AGAIN /* it has ended, and will be started after wait_s */
};
struct worker_status {
    enum worker_state state;
    /* text that it sent when it got ready, kept from then on; of WORKER_OFF: the first line of why,
     * which is for those who run the server, as it may be a driver's */
    char about[WORKER_ABOUT];
    bool known;       /* it was ready once */
    double wait_s;    /* until the next start */
    double failing_s; /* since its first unexpected end, until it is well again */
    pid_t pid;        /* 0: it does not run */
    /* kills: because it did not answer; renewals: because it held too much memory */
    uint64_t starts, crashes, kills, cancels, renewals;
    double cpu_s;        /* of all processes, as far as they reported it */
    uint64_t peak_bytes; /* of the last process */
};

/* Starts the process, and a thread that keeps it running. Close *out with worker_close. ERR_MEM. A
 * failed start is reported by worker_status. */
enum err_code worker_open(const struct worker_config *cfg, struct worker **out,
                          struct err *e) ERR_USE;
/* Ends the process, and kills it if it does not end within a second. No call may be in progress. */
void worker_close(struct worker **w);
/* Makes calls in progress end soon with ERR_CANCEL. Any thread. */
void worker_stop(struct worker *w);
void worker_status(struct worker *w, struct worker_status *out); /* any thread */
/* Waits until it is ready. *life is a new number after each start, because a new process knows
 * nothing of earlier messages. Only one thread at a time may call this and worker_ask. ERR_BUSY: it
 * pauses before the next start, or is off. ERR_CANCEL: `stop` (may be NULL) returned true. */
enum err_code worker_ready(struct worker *w, bool (*stop)(const void *user), const void *user,
                           uint64_t *life, struct err *e) ERR_USE;
/* Sends a request to the process `life`, with the descriptor fd unless that is -1, and appends its
 * answer to `out`, at most `limit` bytes. If `stop` returns true, the process is told that nobody
 * wants the answer. Returns an error of the process itself, or: ERR_DEVICE: the device failed,
 * which is logged, or the process ended during the request, or was ended because it was too slow
 * or its answer invalid. ERR_BUSY: this process has ended already. ERR_CANCEL, ERR_MEM. */
enum err_code worker_ask(struct worker *w, uint64_t life, const void *request, size_t n, int fd,
                         size_t limit, bool (*stop)(const void *user), const void *user,
                         struct buf *out, struct err *e) ERR_USE;

/* ---- the other process ---- */

struct worker_service {
    /* Gets ready. *user is passed to the other functions; about is text for the status. */
    enum err_code (*open)(const void *hello, size_t n, void **user, char about[WORKER_ABOUT],
                          struct err *e);
    /* fd is -1, or owned by the function. */
    enum err_code (*run)(void *user, const void *request, size_t n, int fd, struct buf *out,
                         struct err *e);
    void (*close)(void *user); /* also called after a failed open, if that set *user */
    /* Called after each answer, while nobody waits; may be NULL. True: the process is to be
     * replaced by a new one after its next answer, if it is age_s old by now. */
    bool (*rest)(void *user);
    double age_s;
};
bool worker_asked(int argc, char **argv); /* returns whether this process is the second one */
/* Answers requests until the other process ends. Returns the exit code. */
int worker_main(const struct worker_service *s);
/* Returns whether nobody wants the present answer any more. Call it from time to time; it takes a
 * microsecond. `user` is ignored. In other processes it returns false. */
bool worker_cancelled(const void *user);
/* Notes when a part of the present answer was made, by clock_s(): struct worker_config has `span`.
 * More than WORKER_SPANS an answer are dropped. */
void worker_span(uint32_t what, double from_s, double to_s);

/* ---- messages between the two ---- */

struct worker_head { /* before each request; each is one packet */
    uint32_t magic, cancel;
    uint64_t number;
};
/* the answer's bytes are in the shared file `memory`, which was sent with the first request */
struct worker_answer {
    uint32_t magic, code;
    uint32_t leaves; /* the process ends after this answer, and wants to be started again */
    uint32_t n_spans;
    uint64_t number, n_bytes, peak_bytes;
    double cpu_s, sent_s; /* sent_s and the spans: by the clock of that process */
    struct worker_part {
        uint32_t what;
        double from_s, to_s;
    } span[WORKER_SPANS];
    char text[sizeof((struct err *)NULL)->msg]; /* of the error; in the first answer: about */
};
enum { WORKER_MAGIC = 0x43535744, WORKER_FD = 3 };

#endif
