/* Spans in memory, and the file they end in.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/trace.h"

#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"

enum { TRACE_TRACKS_MAX = 64, TRACE_FIRST = 4096 };

struct trace_row {
    const char *name;
    double from_s, to_s;
    uint32_t track;
    bool overlaps;
};
static struct trace {
    const char *_Atomic path; /* NULL: there is no trace */
    char part[FILE_PATH_MAX];
    double start_s, start_cpu_s;
    pthread_mutex_t lock; /* guards all below */
    struct trace_row *rows;
    size_t n, room, dropped, n_tracks;
    const char *tracks[TRACE_TRACKS_MAX];
} trace = {.lock = PTHREAD_MUTEX_INITIALIZER};

enum err_code trace_begin(const char *path, struct err *e)
{
    if (trace.path)
        return err_set(e, ERR_ARG, "%s: %s is being recorded already", path, trace.path);
    enum err_code rc = file_begin(path, trace.part, e);
    FILE *f = rc ? NULL : fopen(trace.part, "w");
    if (!rc && !f)
        rc = err_errno(e, ERR_IO, "%s: a trace cannot be written there", path);
    if (f)
        fclose(f);
    if (rc)
        return rc;
    trace.rows = mem_array(TRACE_FIRST, sizeof *trace.rows);
    if (!trace.rows) {
        file_abort(trace.part);
        return err_set(e, ERR_MEM, "out of memory for a trace");
    }
    trace.room = TRACE_FIRST;
    trace.n = trace.dropped = trace.n_tracks = 0;
    trace.start_s = clock_s();
    trace.start_cpu_s = clock_cpu_s();
    trace.path = path;
    return ERR_OK;
}

bool trace_on(void)
{
    return trace.path != NULL;
}

/* Room for one more row; false: it is dropped. */
static bool trace_room(void)
{
    if (trace.n < trace.room)
        return true;
    if (trace.room == TRACE_SPANS_MAX)
        return false;
    struct trace_row *more = mem_array(2 * trace.room, sizeof *more);
    if (!more)
        return false;
    memcpy(more, trace.rows, trace.n * sizeof *more);
    mem_free(trace.rows);
    trace.rows = more;
    trace.room *= 2;
    return true;
}

static uint32_t trace_track(const char *name)
{
    size_t k = 0;
    while (k < trace.n_tracks && strcmp(trace.tracks[k], name) != 0)
        k++;
    if (k == TRACE_TRACKS_MAX)
        return TRACE_TRACKS_MAX - 1;
    if (k == trace.n_tracks)
        trace.tracks[trace.n_tracks++] = name;
    return (uint32_t)k;
}

static void trace_add(const char *track, const struct trace_row *row)
{
    if (!trace.path)
        return;
    pthread_mutex_lock(&trace.lock);
    if (trace.path) { /* still */
        struct trace_row r = *row, *last = trace.n ? &trace.rows[trace.n - 1] : NULL;
        r.track = trace_track(track);
        if (last && last->name == r.name && last->track == r.track && last->to_s == r.from_s &&
            !r.overlaps)
            last->to_s = r.to_s; /* it went on */
        else if (trace.rows && trace_room())
            trace.rows[trace.n++] = r;
        else
            trace.dropped++;
    }
    pthread_mutex_unlock(&trace.lock);
}

void trace_span(const char *track, const char *name, double from_s, double to_s)
{
    trace_add(track, &(struct trace_row){.name = name, .from_s = from_s, .to_s = to_s});
}

void trace_overlap(const char *track, const char *name, double from_s, double to_s)
{
    trace_add(track,
              &(struct trace_row){.name = name, .from_s = from_s, .to_s = to_s, .overlaps = true});
}

/* Viewers draw spans of one thread as nested. Spans that overlap are pairs of events with a number.
 */
static void trace_print_overlap(FILE *f, const struct trace_row *r, size_t number)
{
    const char *track = trace.tracks[r->track];
    fprintf(f,
            ",\n{\"name\":\"%s\",\"cat\":\"%s\",\"ph\":\"b\",\"id\":%zu,\"pid\":1,\"tid\":%u,"
            "\"ts\":%.1f}",
            r->name, track, number, r->track + 1, 1e6 * (r->from_s - trace.start_s));
    fprintf(f,
            ",\n{\"name\":\"%s\",\"cat\":\"%s\",\"ph\":\"e\",\"id\":%zu,\"pid\":1,\"tid\":%u,"
            "\"ts\":%.1f}",
            r->name, track, number, r->track + 1, 1e6 * (r->to_s - trace.start_s));
}

/* Names are literals of ours, without characters that JSON would escape. Times are microseconds. */
static void trace_print(FILE *f)
{
    fputs("{\"displayTimeUnit\":\"ms\",\"traceEvents\":[\n"
          "{\"name\":\"process_name\",\"ph\":\"M\",\"pid\":1,\"args\":{\"name\":\"citysplat\"}}",
          f);
    for (size_t k = 0; k < trace.n_tracks; k++)
        fprintf(f,
                ",\n{\"name\":\"thread_name\",\"ph\":\"M\",\"pid\":1,\"tid\":%zu,"
                "\"args\":{\"name\":\"%s\"}}",
                k + 1, trace.tracks[k]);
    for (size_t i = 0; i < trace.n; i++) {
        const struct trace_row *r = &trace.rows[i];
        if (r->overlaps) {
            trace_print_overlap(f, r, i);
            continue;
        }
        fprintf(
            f, ",\n{\"name\":\"%s\",\"ph\":\"X\",\"pid\":1,\"tid\":%u,\"ts\":%.1f,\"dur\":%.1f}",
            r->name, r->track + 1, 1e6 * (r->from_s - trace.start_s), 1e6 * (r->to_s - r->from_s));
    }
    fprintf(f, "\n],\"otherData\":{\"dropped\":%zu}}\n", trace.dropped);
}

static void trace_sum(struct trace_result *out)
{
    double device_s = 0.0;
    *out = (struct trace_result){.spans = trace.n, .dropped = trace.dropped};
    out->seconds = clock_s() - trace.start_s;
    for (size_t i = 0; i < trace.n; i++)
        if (!strcmp(trace.tracks[trace.rows[i].track], "device")) /* one after the other */
            device_s += trace.rows[i].to_s - trace.rows[i].from_s;
    if (out->seconds > 0.0) {
        out->device = device_s / out->seconds;
        out->cores = (clock_cpu_s() - trace.start_cpu_s) / out->seconds;
    }
}

enum err_code trace_end(struct trace_result *out, struct err *e)
{
    *out = (struct trace_result){0};
    pthread_mutex_lock(&trace.lock);
    const char *path = trace.path;
    trace.path = NULL;
    pthread_mutex_unlock(&trace.lock);
    if (!path)
        return ERR_OK;
    trace_sum(out);
    FILE *f = fopen(trace.part, "w");
    bool bad = !f;
    if (f) {
        trace_print(f);
        bad = ferror(f) != 0;
        bad = fclose(f) || bad;
    }
    enum err_code rc = bad ? err_errno(e, ERR_IO, "%s: the trace cannot be written", path)
                           : file_commit(trace.part, path, e);
    if (rc)
        file_abort(trace.part);
    mem_free(trace.rows);
    trace.rows = NULL;
    return rc;
}
