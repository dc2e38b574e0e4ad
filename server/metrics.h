/* Counters. All fields are atomics; any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_METRICS_H
#define SERVER_METRICS_H

#include <stdatomic.h>

#include "server/target.h"

enum { METRICS_CODES = 28, METRICS_BUCKETS = 14 };
struct metrics {
    _Atomic uint64_t requests[ROUTE_COUNT][METRICS_CODES];
    _Atomic uint64_t seconds_bucket[ROUTE_COUNT][METRICS_BUCKETS], seconds_us[ROUTE_COUNT];
    _Atomic uint64_t response_bytes, inflight, connections, client_aborts, reaped, displaced,
        store_errors, reload_failed, rejected;
};
extern const int metrics_codes[METRICS_CODES]; /* 0 ends them: another status */
extern const double metrics_bounds_s[METRICS_BUCKETS];

void metrics_request(struct metrics *m, enum route route, int status, double seconds,
                     uint64_t bytes);

#endif
