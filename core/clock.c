/* Monotonic time since the process started, and CPU time.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stddef.h>
#include <time.h>

#include "core/base.h"

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
