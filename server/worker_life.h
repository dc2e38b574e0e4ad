/* The second process between those who ask it and the keeper: internal to server/worker_*.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORKER_LIFE_H
#define SERVER_WORKER_LIFE_H

#include <pthread.h>

#include "server/worker.h"

/* Everything but cfg and hello is guarded by `lock`. */
struct worker {
    struct worker_config cfg;
    uint8_t *hello;
    struct pool_thread *keeper;
    pthread_mutex_t lock;
    pthread_cond_t changed; /* state, asking, stopping */
    struct worker_status now;
    uint64_t life, number;
    int fd, memory;      /* of this life; -1: none */
    bool asking;         /* somebody uses fd and memory: the keeper leaves them open */
    bool failed, killed; /* this life is to end; it was killed because it did not answer */
    bool stopping;
    double ready_s, asked_s; /* when it was ready; when the last call began, 0: none is under way */
    double failing_since_s;  /* 0: all is well */
    double again_s;          /* not before this */
    unsigned failures;       /* in a row */
    double cpu_s;            /* of the lives before */
};

/* The keeper's thread: start it, wait for its end, start it again, until worker_stop. */
void worker_keep(void *user);
/* Under the lock: until something has changed, at most wait_s. */
void worker_wait(struct worker *w, double wait_s);

/* One packet, with a descriptor unless `with` is -1. ERR_IO: nobody is there. */
enum err_code worker_packet_send(int fd, const struct worker_head *h, const void *bytes, size_t n,
                                 int with, struct err *e) ERR_USE;
/* Wait at most wait_ms for the answer to `number`. *got: it is there. ERR_IO: the connection has
 * ended. ERR_FORMAT: that is none. */
enum err_code worker_packet_receive(int fd, uint64_t number, int wait_ms, struct worker_answer *a,
                                    bool *got, struct err *e) ERR_USE;
/* Append the n bytes of an answer. A short file is an answer that is none: ERR_FORMAT. ERR_MEM. */
enum err_code worker_packet_take(int memory, size_t n, struct buf *out, struct err *e) ERR_USE;

#endif
