/* Monotonic time since the process started, CPU time, and the stop flag that signals set.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <signal.h>
#include <stddef.h>
#include <time.h>

#include "core/base.h"

static volatile sig_atomic_t clock_stop; /* set by the signal handler alone */

static double clock_of(clockid_t id)
{
    struct timespec t;
    if (clock_gettime(id, &t))
        return 0.0;
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

double clock_s(void)
{
    static double start; /* of the first call; a race would only move the zero by microseconds */
    double now = clock_of(CLOCK_MONOTONIC);
    if (start <= 0.0)
        start = now;
    return now - start;
}

double clock_cpu_s(void)
{
    return clock_of(CLOCK_PROCESS_CPUTIME_ID);
}

static void clock_on_signal(int sig)
{
    clock_stop = 1;
    /* The second one gets the default action: the user means it. */
    struct sigaction dfl = {.sa_handler = SIG_DFL};
    sigaction(sig, &dfl, NULL);
}

void clock_catch_signals(void)
{
    struct sigaction sa = {.sa_handler = clock_on_signal};
    sigemptyset(&sa.sa_mask);
    sigaction(SIGINT, &sa, NULL);
    sigaction(SIGTERM, &sa, NULL);
}

bool clock_stopping(void)
{
    return clock_stop != 0;
}
