/* Counters and their Prometheus text (exposition format 0.0.4). Requests are labelled by route
 * template and status, never by path, so the number of series is fixed. Counters are relaxed
 * atomics; the text is a snapshot that need not be consistent between lines.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <stdio.h>
#include <string.h>

static const int codes[METRICS_CODES] = {200, 204, 206, 304, 307, 400, 403, 404, 405, 413,
                                         414, 416, 422, 431, 499, 500, 501, 503, 504, 0};
static const double bounds_s[METRICS_BUCKETS] = {0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05,
                                                 0.1,    0.25,  0.5,    1,     2.5,  5,     10};
static const char *const classes[JOB_CLASSES] = {"view", "tile", "prefetch"};
static const char *const ends[JOB_ENDS] = {"ok", "error", "cancel", "shed", "timeout"};

void metrics_request(struct metrics *m, enum route route, int status, double seconds,
                     uint64_t bytes)
{
    int c = 0, b = 0;
    while (codes[c] && codes[c] != status)
        c++;
    while (b < METRICS_BUCKETS && seconds > bounds_s[b])
        b++;
    atomic_fetch_add_explicit(&m->requests[route][c], 1, memory_order_relaxed);
    if (b < METRICS_BUCKETS)
        atomic_fetch_add_explicit(&m->seconds_bucket[route][b], 1, memory_order_relaxed);
    atomic_fetch_add_explicit(&m->seconds_us[route], (uint64_t)(seconds * 1e6),
                              memory_order_relaxed);
    atomic_fetch_add_explicit(&m->response_bytes, bytes, memory_order_relaxed);
}

static void head(struct buf *out, const char *name, const char *type, const char *help)
{
    buf_printf(out, "# HELP citysplat_%s %s\n# TYPE citysplat_%s %s\n", name, help, name, type);
}

static void one(struct buf *out, const char *name, const char *type, const char *help,
                uint64_t value)
{
    head(out, name, type, help);
    buf_printf(out, "citysplat_%s %llu\n", name, (unsigned long long)value);
}

static void requests_text(struct metrics *m, struct buf *out)
{
    uint64_t total[ROUTE_COUNT] = {0};
    head(out, "http_requests_total", "counter",
         "Requests by route and status (0: another status).");
    for (int r = 0; r < ROUTE_COUNT; r++)
        for (int c = 0; c < METRICS_CODES; c++) {
            uint64_t n = atomic_load_explicit(&m->requests[r][c], memory_order_relaxed);
            total[r] += n;
            if (n)
                buf_printf(out, "citysplat_http_requests_total{route=\"%s\",code=\"%d\"} %llu\n",
                           route_path((enum route)r), codes[c], (unsigned long long)n);
        }
    head(out, "http_request_duration_seconds", "histogram", "From request line to last byte.");
    for (int r = 0; r < ROUTE_COUNT; r++) {
        if (!total[r])
            continue;
        const char *path = route_path((enum route)r);
        uint64_t sum = 0;
        for (int b = 0; b < METRICS_BUCKETS; b++) {
            sum += atomic_load_explicit(&m->seconds_bucket[r][b], memory_order_relaxed);
            buf_printf(
                out,
                "citysplat_http_request_duration_seconds_bucket{route=\"%s\",le=\"%g\"} %llu\n",
                path, bounds_s[b], (unsigned long long)sum);
        }
        buf_printf(out,
                   "citysplat_http_request_duration_seconds_bucket{route=\"%s\",le=\"+Inf\"} %llu\n"
                   "citysplat_http_request_duration_seconds_sum{route=\"%s\"} %.6f\n"
                   "citysplat_http_request_duration_seconds_count{route=\"%s\"} %llu\n",
                   path, (unsigned long long)total[r], path,
                   (double)atomic_load_explicit(&m->seconds_us[r], memory_order_relaxed) * 1e-6,
                   path, (unsigned long long)total[r]);
    }
}

static void jobs_text(struct jobs *jobs, struct buf *out)
{
    struct job_stats st;
    job_count(jobs, &st);
    head(out, "jobs_total", "counter", "Jobs by class and outcome.");
    for (int c = 0; c < JOB_CLASSES; c++)
        for (int end = 0; end < JOB_ENDS; end++)
            buf_printf(out, "citysplat_jobs_total{kind=\"%s\",outcome=\"%s\"} %llu\n", classes[c],
                       ends[end], (unsigned long long)st.ended[c][end]);
    head(out, "jobs_queued", "gauge", "Jobs that wait.");
    for (int c = 0; c < JOB_CLASSES; c++)
        buf_printf(out, "citysplat_jobs_queued{kind=\"%s\"} %llu\n", classes[c],
                   (unsigned long long)st.queued[c]);
    head(out, "jobs_running", "gauge", "Jobs that run.");
    for (int c = 0; c < JOB_CLASSES; c++)
        buf_printf(out, "citysplat_jobs_running{kind=\"%s\"} %llu\n", classes[c],
                   (unsigned long long)st.running[c]);
    head(out, "job_seconds_total", "counter", "Time spent in jobs.");
    for (int c = 0; c < JOB_CLASSES; c++)
        buf_printf(out, "citysplat_job_seconds_total{kind=\"%s\"} %.6f\n", classes[c], st.run_s[c]);
    one(out, "job_coalesced_total", "counter", "Requests that joined a job under way.",
        st.coalesced);
}

enum err_code metrics_text(struct services *s, struct buf *out, struct err *e)
{
    struct metrics *m = &s->metrics;
    struct cache_stats cs;
    requests_text(m, out);
    one(out, "http_response_bytes_total", "counter", "Bytes of bodies.",
        atomic_load(&m->response_bytes));
    one(out, "http_inflight", "gauge", "Requests being answered.", atomic_load(&m->inflight));
    one(out, "http_connections", "gauge", "Open connections.", atomic_load(&m->connections));
    one(out, "http_rejected_total", "counter", "Malformed requests refused.",
        atomic_load(&m->rejected));
    one(out, "client_aborts_total", "counter", "Clients that left before the answer was out.",
        atomic_load(&m->client_aborts));
    one(out, "reaped_connections_total", "counter", "Connections cut for being slow.",
        atomic_load(&m->reaped));
    one(out, "store_errors_total", "counter", "Tiles that could not be read or encoded.",
        atomic_load(&m->store_errors));
    one(out, "reload_failed_total", "counter", "Reloads that kept the old data.",
        atomic_load(&m->reload_failed));
    cache_count(s->cache, &cs);
    one(out, "cache_hits_total", "counter", "Lookups that found encoded bytes.", cs.hits);
    one(out, "cache_misses_total", "counter", "Lookups that did not.", cs.misses);
    one(out, "cache_evictions_total", "counter", "Entries that made room.", cs.evictions);
    one(out, "cache_entries", "gauge", "Entries.", cs.entries);
    one(out, "cache_bytes", "gauge", "Bytes held.", cs.bytes);
    if (s->jobs)
        jobs_text(s->jobs, out);
    struct catalog *c = services_catalog(s);
    head(out, "dataset_info", "gauge", "Revisions served.");
    for (size_t i = 0; i < c->n; i++)
        buf_printf(out, "citysplat_dataset_info{ds=\"%s\",rev=\"%s\"} 1\n", c->ds[i]->meta.name,
                   c->ds[i]->meta.revision);
    catalog_drop(&c);
    head(out, "build_info", "gauge", "Program version.");
    buf_printf(out, "citysplat_build_info{version=\"%s\"} 1\n", CITYSPLAT_VERSION);
    head(out, "uptime_seconds", "gauge", "Since start.");
    buf_printf(out, "citysplat_uptime_seconds %.3f\n", clock_s() - s->start_s);
    head(out, "process_cpu_seconds_total", "counter", "CPU time of the process.");
    buf_printf(out, "citysplat_process_cpu_seconds_total %.3f\n", clock_cpu_s());
    head(out, "process_peak_bytes", "gauge", "Peak resident set.");
    buf_printf(out, "citysplat_process_peak_bytes %llu\n", (unsigned long long)mem_peak_bytes());
    return buf_check(out, e);
}
