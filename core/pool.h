/* Threads. All threads of the program but libmicrohttpd's and OpenCL's are made here.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_POOL_H
#define CORE_POOL_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

/* Call fn(user, i) for every i in [0, n), on up to `threads` threads (0 = one per core). Blocks
 * until all are done. Each i runs exactly once; which thread runs it is not defined, so results
 * must depend on i alone. The first non-ERR_OK result stops handing out work and is returned with
 * its message; among several failures the lowest i wins. */
enum err_code pool_for(size_t n, size_t threads,
                       enum err_code (*fn)(void *user, size_t i, struct err *e), void *user,
                       struct err *e) ERR_USE;
/* Threads that 0 stands for: the limit if there is one, else the online cores; at least 1. */
size_t pool_cores(void);
/* Use at most this many threads (0 = no limit), here and in a CPU device that is opened afterwards.
 * Call it before threads start. */
void pool_limit(size_t threads);
/* This thread is one of as many as there is work for: from now on its pool_for calls fn itself. */
void pool_alone(void);

/* One background thread that runs fn(user) once; pool_join waits and frees. Used for prefetching.
 * ERR_MEM. */
struct pool_thread;
enum err_code pool_start(void (*fn)(void *user), void *user, struct pool_thread **out,
                         struct err *e) ERR_USE;
void pool_join(struct pool_thread **t);

/* A condition that is waited for by the clock of clock_s(), which nobody can set: with the day's
 * time a wait of a second lasts a day when the clock is put back. */
void pool_cond_init(pthread_cond_t *c);
/* Wait until it is signalled, or clock_s() is end_s: false. As all such waits it may end early. */
bool pool_cond_wait(pthread_cond_t *c, pthread_mutex_t *lock, double end_s);

#endif
