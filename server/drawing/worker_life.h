/* The second process, for the threads that send requests and for the keeper. Internal to
 * server/worker_*.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORKER_LIFE_H
#define SERVER_WORKER_LIFE_H

#include <pthread.h>

#include "server/drawing/worker.h"

/* `lock` guards all except cfg and hello. */
struct worker {
    struct worker_config cfg;
    uint8_t *hello;
    struct pool_thread *keeper;
    pthread_mutex_t lock;
    pthread_cond_t changed; /* signals changes of state, asking and stopping */
    struct worker_status now;
    uint64_t life, number;
    int fd, memory; /* of this process; -1: none */
    bool asking;    /* a thread uses fd and memory, so the keeper must leave them open */
    /* failed: this process must end; killed: it was killed because it did not answer */
    bool failed, killed;
    bool leaves; /* it said that it ends, and is started again at once */
    bool stopping;
    double ready_s, asked_s; /* when it got ready; when the present call began, 0: none */
    double failing_since_s;  /* 0: all is well */
    double again_s;          /* earliest time of the next start */
    unsigned failures;       /* in a row */
    double off_pause_s;      /* the last pause of WORKER_OFF; 0: none since it was ready */
    double cpu_s;            /* of earlier processes */
};

/* The keeper's thread: it starts the process, waits for its end and starts it again, until
 * worker_stop. */
void worker_keep(void *user);
/* With the lock held, waits until something changes, at most wait_s. */
void worker_wait(struct worker *w, double wait_s);

/* Sends one packet, with a descriptor unless `with` is -1. ERR_IO: the other side is gone. */
enum err_code worker_packet_send(int fd, const struct worker_head *h, const void *bytes, size_t n,
                                 int with, struct err *e) ERR_USE;
/* Waits at most wait_ms for the answer to `number`. *got: it has come. ERR_IO: the connection has
 * ended. ERR_FORMAT: it is no answer. */
enum err_code worker_packet_receive(int fd, uint64_t number, int wait_ms, struct worker_answer *a,
                                    bool *got, struct err *e) ERR_USE;
/* Appends the n bytes of an answer. ERR_FORMAT: the file is too short. ERR_MEM. */
enum err_code worker_packet_take(int memory, size_t n, struct buf *out, struct err *e) ERR_USE;

#endif
