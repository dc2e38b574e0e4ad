/* Counters. Their labels are route template and status, never a path, so the number of series is
 * fixed. Atomics are relaxed: no thread waits.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/metrics.h"

const int metrics_codes[METRICS_CODES] = {200, 201, 204, 206, 303, 304, 307, 308, 400, 401,
                                          403, 404, 405, 409, 412, 413, 414, 416, 422, 429,
                                          431, 499, 500, 501, 503, 504, 507, 0};
const double metrics_bounds_s[METRICS_BUCKETS] = {0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05,
                                                  0.1,    0.25,  0.5,    1,     2.5,  5,     10};

enum err_code metrics_open(struct metrics *m, size_t n, struct err *e)
{
    m->n_routes = n + 1;
    m->route = mem_array(n + 1, sizeof *m->route);
    return m->route ? ERR_OK : err_set(e, ERR_MEM, "metrics: out of memory");
}

void metrics_free(struct metrics *m)
{
    mem_free(m->route);
    m->route = NULL;
}

void metrics_request(struct metrics *m, size_t route, int status, double seconds, uint64_t bytes)
{
    struct metrics_route *to = &m->route[route];
    int c = 0, b = 0;
    while (metrics_codes[c] && metrics_codes[c] != status)
        c++;
    while (b < METRICS_BUCKETS && seconds > metrics_bounds_s[b])
        b++;
    atomic_fetch_add_explicit(&to->requests[c], 1, memory_order_relaxed);
    if (b < METRICS_BUCKETS)
        atomic_fetch_add_explicit(&to->seconds_bucket[b], 1, memory_order_relaxed);
    atomic_fetch_add_explicit(&to->seconds_us, (uint64_t)(seconds * 1e6), memory_order_relaxed);
    atomic_fetch_add_explicit(&m->response_bytes, bytes, memory_order_relaxed);
}
