/* Monotonic time since the process started, and CPU time.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdatomic.h>
#include <stddef.h>
#include <sys/resource.h>
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
    static _Atomic double start; /* of the first call, whichever thread's that is */
    double now = clock_of(CLOCK_MONOTONIC), from = atomic_load(&start);
    if (from <= 0.0 && atomic_compare_exchange_strong(&start, &from, now))
        from = now;
    return now - from;
}

double clock_cpu_s(void)
{
    return clock_of(CLOCK_PROCESS_CPUTIME_ID);
}

double clock_children_s(void)
{
    struct rusage u;
    if (getrusage(RUSAGE_CHILDREN, &u))
        return 0.0;
    return (double)(u.ru_utime.tv_sec + u.ru_stime.tv_sec) +
           1e-6 * (double)(u.ru_utime.tv_usec + u.ru_stime.tv_usec);
}

int64_t clock_days(int64_t year, int64_t month, int64_t day)
{
    const int64_t m = (month + 9) % 12, y = year - (month < 3); /* a year begins in March */
    return 365 * y + y / 4 - y / 100 + y / 400 + (153 * m + 2) / 5 + day - 719469;
}
