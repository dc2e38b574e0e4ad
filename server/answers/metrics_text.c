/* Prometheus text (exposition format 0.0.4) of the counters: a snapshot that need not be consistent
 * between lines.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/metrics_text.h"

#include <stdio.h>
#include <string.h>

#include "server/answers/view_stream.h"

static const char *const metrics_text_classes[JOB_CLASSES] = {
    "view", "tile", "prefetch", "map", "motion", "ahead", "slow", "errand"};
static const char *const metrics_text_ends[JOB_ENDS] = {"ok",   "error",   "cancel",
                                                        "shed", "timeout", "limited"};

static void metrics_text_head(struct buf *out, const char *name, const char *type, const char *help)
{
    buf_printf(out, "# HELP citysplat_%s %s\n# TYPE citysplat_%s %s\n", name, help, name, type);
}

static void metrics_text_one(struct buf *out, const char *name, const char *type, const char *help,
                             uint64_t value)
{
    metrics_text_head(out, name, type, help);
    buf_printf(out, "citysplat_%s %llu\n", name, (unsigned long long)value);
}

static uint64_t metrics_text_read(_Atomic uint64_t *counter)
{
    return atomic_load_explicit(counter, memory_order_relaxed);
}

static uint64_t metrics_text_total(struct metrics_route *m)
{
    uint64_t total = 0;
    for (int c = 0; c < METRICS_CODES; c++)
        total += metrics_text_read(&m->requests[c]);
    return total;
}

static void metrics_text_duration(struct metrics_route *m, const char *path, struct buf *out)
{
    const uint64_t total = metrics_text_total(m);
    uint64_t sum = 0;
    for (int b = 0; b < METRICS_BUCKETS && total; b++) {
        sum += metrics_text_read(&m->seconds_bucket[b]);
        buf_printf(out,
                   "citysplat_http_request_duration_seconds_bucket{route=\"%s\",le=\"%g\"} %llu\n",
                   path, metrics_bounds_s[b], (unsigned long long)sum);
    }
    if (total)
        buf_printf(out,
                   "citysplat_http_request_duration_seconds_bucket{route=\"%s\",le=\"+Inf\"} %llu\n"
                   "citysplat_http_request_duration_seconds_sum{route=\"%s\"} %.6f\n"
                   "citysplat_http_request_duration_seconds_count{route=\"%s\"} %llu\n",
                   path, (unsigned long long)total, path,
                   (double)metrics_text_read(&m->seconds_us) * 1e-6, path,
                   (unsigned long long)total);
}

static void metrics_text_requests(const struct router *routes, struct metrics *m, struct buf *out)
{
    size_t n;
    const struct route *rows = router_rows(routes, &n);
    metrics_text_head(out, "http_requests_total", "counter",
                      "Requests by route and status (0: another status).");
    for (size_t r = 0; r <= n; r++)
        for (int c = 0; c < METRICS_CODES; c++) {
            const uint64_t count = metrics_text_read(&m->route[r].requests[c]);
            if (count)
                buf_printf(out, "citysplat_http_requests_total{route=\"%s\",code=\"%d\"} %llu\n",
                           route_path(r < n ? &rows[r] : NULL), metrics_codes[c],
                           (unsigned long long)count);
        }
    metrics_text_head(out, "http_request_duration_seconds", "histogram",
                      "From request line to last byte.");
    for (size_t r = 0; r <= n; r++)
        metrics_text_duration(&m->route[r], route_path(r < n ? &rows[r] : NULL), out);
}

static void metrics_text_jobs(struct jobs *jobs, struct buf *out)
{
    struct job_stats st;
    job_count(jobs, &st);
    metrics_text_head(out, "jobs_total", "counter", "Jobs by class and outcome.");
    for (int c = 0; c < JOB_CLASSES; c++)
        for (int end = 0; end < JOB_ENDS; end++)
            buf_printf(out, "citysplat_jobs_total{kind=\"%s\",outcome=\"%s\"} %llu\n",
                       metrics_text_classes[c], metrics_text_ends[end],
                       (unsigned long long)st.ended[c][end]);
    metrics_text_head(out, "jobs_queued", "gauge", "Jobs that wait.");
    for (int c = 0; c < JOB_CLASSES; c++)
        buf_printf(out, "citysplat_jobs_queued{kind=\"%s\"} %llu\n", metrics_text_classes[c],
                   (unsigned long long)st.queued[c]);
    metrics_text_head(out, "jobs_running", "gauge", "Jobs that run.");
    for (int c = 0; c < JOB_CLASSES; c++)
        buf_printf(out, "citysplat_jobs_running{kind=\"%s\"} %llu\n", metrics_text_classes[c],
                   (unsigned long long)st.running[c]);
    metrics_text_head(out, "job_seconds_total", "counter", "Time spent in jobs.");
    for (int c = 0; c < JOB_CLASSES; c++)
        buf_printf(out, "citysplat_job_seconds_total{kind=\"%s\"} %.6f\n", metrics_text_classes[c],
                   st.run_s[c]);
    metrics_text_one(out, "job_coalesced_total", "counter", "Requests that joined a job under way.",
                     st.coalesced);
}

static void metrics_text_real(struct buf *out, const char *name, const char *help, double value)
{
    metrics_text_head(out, name, "gauge", help);
    buf_printf(out, "citysplat_%s %.6g\n", name, value);
}

/* What an alert looks at: stores, pictures, the last reload, the certificate. */
static void metrics_text_health(struct services *s, struct buf *out)
{
    struct worker_status st;
    struct metrics *m = &s->metrics;
    struct catalog *c = services_catalog(s);
    size_t n_bad = c->n_absent;
    for (size_t i = 0; i < c->n_current; i++)
        n_bad += atomic_load(&c->ds[i]->n_failed) != 0;
    metrics_text_one(out, "datasets", "gauge", "Datasets that are served.", c->n_current);
    metrics_text_one(out, "stores_degraded", "gauge",
                     "Stores that are not served as they are now, or not all of them.", n_bad);
    catalog_drop(&c);
    metrics_text_one(out, "pictures_on", "gauge", "1: pictures can be drawn.",
                     s->picture && picture_status(s->picture, &st) > 0);
    metrics_text_one(out, "last_reload_successful", "gauge",
                     "1: the start or the last reload found nothing wrong.",
                     atomic_load(&m->reload_well));
    metrics_text_one(out, "last_reload_success_timestamp_seconds", "gauge",
                     "When the server started or last reloaded without an error.",
                     atomic_load(&m->reload_good_s));
    if (s->tls)
        metrics_text_real(out, "certificate_days_left", "Days until the certificate expires.",
                          tls_days_left(s->tls));
}

/* The process that draws. */
static void metrics_text_drawing(struct services *s, struct buf *out)
{
    struct worker_status st;
    const size_t n_ready = picture_status(s->picture, &st);
    metrics_text_one(out, "drawing_up", "gauge", "Processes that are ready to draw.", n_ready);
    metrics_text_one(out, "drawing_starts_total", "counter", "Their starts.", st.starts);
    metrics_text_one(out, "drawing_crashes_total", "counter", "Ends that nobody asked for.",
                     st.crashes);
    metrics_text_one(out, "drawing_kills_total", "counter",
                     "Ends because it did not answer in --device-timeout-s.", st.kills);
    metrics_text_one(out, "drawing_renewals_total", "counter",
                     "Ends because it held more memory than its share.", st.renewals);
    metrics_text_one(out, "drawing_cancels_total", "counter",
                     "Pictures that it gave up because nobody waited any more.", st.cancels);
    metrics_text_head(out, "drawing_seconds", "gauge", "Time that a picture under way takes.");
    buf_printf(out, "citysplat_drawing_seconds %.3f\n", s->jobs ? job_drawing_s(s->jobs) : 0);
    metrics_text_head(out, "drawing_cpu_seconds_total", "counter", "Their CPU time.");
    buf_printf(out, "citysplat_drawing_cpu_seconds_total %.3f\n", st.cpu_s);
    metrics_text_one(out, "drawing_peak_bytes", "gauge", "Peak resident set of one.",
                     st.peak_bytes);
}

static void metrics_text_disk(struct services *s, struct buf *out)
{
    struct disk_stats st;
    disk_count(s->disk, &st);
    metrics_text_one(out, "disk_cache_hits_total", "counter", "Results read from --cache-dir.",
                     st.hits);
    metrics_text_one(out, "disk_cache_misses_total", "counter", "Results that were not there.",
                     st.misses);
    metrics_text_one(out, "disk_cache_writes_total", "counter", "Results written there.",
                     st.written);
    metrics_text_one(out, "disk_cache_evictions_total", "counter", "Files that made room.",
                     st.evicted);
    metrics_text_one(out, "disk_cache_damaged_total", "counter",
                     "Files that were not what was written: removed.", st.damaged);
    metrics_text_one(out, "disk_cache_failed_total", "counter", "Writes that failed.", st.failed);
    metrics_text_one(out, "disk_cache_entries", "gauge", "Files.", st.entries);
    metrics_text_one(out, "disk_cache_bytes", "gauge", "Bytes held.", st.bytes);
}

static void metrics_text_streams(struct services *s, struct buf *out)
{
    struct view_stream_counts streams;
    view_stream_count(s->view_streams, &streams);
    metrics_text_one(out, "streams", "gauge", "Streams of pictures that are open.",
                     streams.streams);
    metrics_text_one(out, "stream_pictures_total", "counter", "Pictures of streams.",
                     streams.pictures);
    metrics_text_one(out, "stream_full_pictures_total", "counter",
                     "Those drawn in full, of cameras at rest.", streams.full);
    metrics_text_one(out, "stream_encoders", "gauge", "Encoders of streams as video, open now.",
                     streams.encoders);
    metrics_text_one(out, "stream_encoder_bytes", "gauge", "Memory that they may take.",
                     streams.encoder_bytes);
    metrics_text_one(out, "stream_frames_total", "counter", "Pictures of streams that are video.",
                     streams.frames);
    metrics_text_head(out, "stream_encode_seconds_total", "counter",
                      "Time to encode these, without drawing.");
    buf_printf(out, "citysplat_stream_encode_seconds_total %.6f\n", streams.encode_s);
}

/* The cache, and all else that holds answers. */
static void metrics_text_memory(struct services *s, struct buf *out)
{
    struct cache_stats cs;
    cache_count(s->cache, &cs);
    metrics_text_one(out, "cache_hits_total", "counter", "Lookups that found encoded bytes.",
                     cs.hits);
    metrics_text_one(out, "cache_misses_total", "counter", "Lookups that did not.", cs.misses);
    metrics_text_one(out, "cache_evictions_total", "counter", "Entries that made room.",
                     cs.evictions);
    metrics_text_one(out, "inflight_bytes", "gauge",
                     "Bytes of answers that are made or sent and not in the cache.",
                     live_bodies_held(s->live_bodies, cache_bytes(s->cache)));
    metrics_text_one(out, "inflight_limit_bytes", "gauge", "Above it answers are refused.",
                     live_bodies_limit(s->live_bodies));
    metrics_text_one(out, "memory_budget_bytes", "gauge", "--memory.", s->plan.budget);
    metrics_text_one(out, "memory_held_bytes", "gauge",
                     "Memory of the server and its drawing process that cannot be dropped.",
                     services_held_bytes(s));
    if (s->plan.budget)
        metrics_text_real(out, "memory_held_ratio", "Its share of --memory.",
                          (double)services_held_bytes(s) / (double)s->plan.budget);
    metrics_text_one(out, "memory_short_total", "counter",
                     "Answers refused because memory ran out.",
                     atomic_load(&s->metrics.memory_short));
    metrics_text_one(out, "live_bytes", "gauge",
                     "Bytes of live answers, those in the cache among them.",
                     live_bodies_bytes(s->live_bodies));
    metrics_text_one(out, "cache_entries", "gauge", "Entries.", cs.entries);
    metrics_text_one(out, "cache_bytes", "gauge", "Bytes held.", cs.bytes);
}

enum err_code metrics_text_write(struct services *s, struct buf *out, struct err *e)
{
    struct metrics *m = &s->metrics;
    metrics_text_requests(s->routes, m, out);
    metrics_text_one(out, "http_response_bytes_total", "counter", "Bytes of bodies.",
                     atomic_load(&m->response_bytes));
    metrics_text_one(out, "http_inflight", "gauge", "Requests being answered.",
                     atomic_load(&m->inflight));
    metrics_text_one(out, "http_connections", "gauge", "Open connections.",
                     atomic_load(&m->connections));
    metrics_text_one(out, "http_rejected_total", "counter", "Malformed requests refused.",
                     atomic_load(&m->rejected));
    metrics_text_one(out, "client_aborts_total", "counter",
                     "Clients that left before the answer was out.",
                     atomic_load(&m->client_aborts));
    metrics_text_one(out, "reaped_connections_total", "counter", "Connections cut for being slow.",
                     atomic_load(&m->reaped));
    metrics_text_one(out, "displaced_connections_total", "counter",
                     "Connections that gave way to new ones at a limit.",
                     atomic_load(&m->displaced));
    metrics_text_one(out, "store_errors_total", "counter",
                     "Tiles that could not be read or encoded.", atomic_load(&m->store_errors));
    metrics_text_one(out, "reload_failed_total", "counter", "Reloads that kept the old data.",
                     atomic_load(&m->reload_failed));
    metrics_text_streams(s, out);
    if (s->picture)
        metrics_text_drawing(s, out);
    metrics_text_memory(s, out);
    if (s->disk)
        metrics_text_disk(s, out);
    if (s->jobs)
        metrics_text_jobs(s->jobs, out);
    metrics_text_health(s, out);
    struct catalog *c = services_catalog(s);
    metrics_text_head(out, "dataset_info", "gauge", "Revisions served.");
    for (size_t i = 0; i < c->n; i++)
        buf_printf(out, "citysplat_dataset_info{ds=\"%s\",rev=\"%s\"} 1\n", c->ds[i]->meta.name,
                   c->ds[i]->meta.revision);
    catalog_drop(&c);
    metrics_text_head(out, "build_info", "gauge", "Program version.");
    buf_printf(out, "citysplat_build_info{version=\"%s\"} 1\n", CITYSPLAT_VERSION);
    metrics_text_head(out, "uptime_seconds", "gauge", "Since start.");
    buf_printf(out, "citysplat_uptime_seconds %.3f\n", clock_s() - s->start_s);
    metrics_text_head(out, "process_cpu_seconds_total", "counter", "CPU time of the process.");
    buf_printf(out, "citysplat_process_cpu_seconds_total %.3f\n", clock_cpu_s());
    metrics_text_head(out, "process_peak_bytes", "gauge", "Peak resident set.");
    buf_printf(out, "citysplat_process_peak_bytes %llu\n", (unsigned long long)mem_peak_bytes());
    return buf_check(out, e);
}
