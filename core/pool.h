/* Threads. All threads of the program are made here, except those of libmicrohttpd and OpenCL.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_POOL_H
#define CORE_POOL_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

/* Calls fn(user, i) once for every i in [0, n), on up to `threads` threads (0 = one a core). It
 * returns when all calls have ended. Any thread may get any i, so results must depend on i alone.
 * After a call returns other than ERR_OK no new calls begin. The code and message of the lowest i
 * that failed are returned. */
enum err_code pool_for(size_t n, size_t threads,
                       enum err_code (*fn)(void *user, size_t i, struct err *e), void *user,
                       struct err *e) ERR_USE;
/* The number of threads that 0 stands for: the limit of pool_limit, else the number of cores that
 * are online. At least 1. */
size_t pool_cores(void);
/* Limits the number of threads (0 = no limit) of pool_for and of a CPU device that is opened later.
 * Call it before threads start. */
void pool_limit(size_t threads);
/* From now on pool_for in this thread makes all calls itself. Use it in threads that together
 * already occupy all cores. */
void pool_alone(void);

/* Starts one background thread that calls fn(user) once. pool_join waits for it and frees it.
 * ERR_MEM. */
struct pool_thread;
enum err_code pool_start(void (*fn)(void *user), void *user, struct pool_thread **out,
                         struct err *e) ERR_USE;
void pool_join(struct pool_thread **t);

/* Initialises a condition whose waits use the clock of clock_s(). That clock cannot be set. If
 * waits used the time of day, a wait of a second would last a day when somebody puts the clock back
 * by a day. */
void pool_cond_init(pthread_cond_t *c);
/* Waits until the condition is signalled (true) or clock_s() reaches end_s (false). Like
 * every wait on a condition, it may return before either. */
bool pool_cond_wait(pthread_cond_t *c, pthread_mutex_t *lock, double end_s);

#endif
