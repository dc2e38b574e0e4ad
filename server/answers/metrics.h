/* Counters. All fields are atomics; any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_METRICS_H
#define SERVER_METRICS_H

#include <stdatomic.h>

#include "core/base.h"

enum { METRICS_CODES = 28, METRICS_BUCKETS = 14 };
struct metrics_route {
    _Atomic uint64_t requests[METRICS_CODES], seconds_bucket[METRICS_BUCKETS], seconds_us;
};
struct metrics {
    /* [n_routes], the last one for requests without a route; free with metrics_free */
    struct metrics_route *route;
    size_t n_routes;
    _Atomic uint64_t response_bytes, inflight, connections, client_aborts, reaped, displaced,
        store_errors, reload_failed, rejected, memory_short, reload_good_s;
    _Atomic bool reload_well; /* the last one; reload_good_s: the last good one, since 1970 */
};
extern const int metrics_codes[METRICS_CODES]; /* ended by 0, which stands for other statuses */
extern const double metrics_bounds_s[METRICS_BUCKETS];

/* Allocates counters for so many routes. ERR_MEM. */
enum err_code metrics_open(struct metrics *m, size_t n, struct err *e) ERR_USE;
void metrics_free(struct metrics *m);
/* Counts a request. route: its number, or the number of all routes for none. */
void metrics_request(struct metrics *m, size_t route, int status, double seconds, uint64_t bytes);

#endif
