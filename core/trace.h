/* A record of what ran when, as a file in Chrome's trace event format. chrome://tracing and
 * ui.perfetto.dev show it. A process has at most one trace. Without a trace, a span costs one
 * comparison.
 *
 * Tracks of a training: "work" is the kind of work (train/base/timing.h), "device" its kernels,
 * "photographs" what the loader reads, "host 1" and so on the threads of a parallel loop.
 * Of a server: "requests", "queue", "tiles 1" and so on the threads that encode, "pictures" the
 * thread that waits for the process that draws, "drawing" what that process does.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_TRACE_H
#define CORE_TRACE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { TRACE_SPANS_MAX = 1 << 20 }; /* later spans are dropped and counted */

/* From now on spans are kept, for a file at `path` (borrowed until trace_end). Call it before a
 * device is opened and before threads start. ERR_ARG: there is a trace already. ERR_IO, ERR_LIMIT:
 * no file can be written at `path`. ERR_MEM. */
enum err_code trace_begin(const char *path, struct err *e) ERR_USE;
bool trace_on(void);
/* `track` and `name` are string literals. Times are those of clock_s(). Any thread. */
void trace_span(const char *track, const char *name, double from_s, double to_s);
/* The same for spans that overlap others of their track. */
void trace_overlap(const char *track, const char *name, double from_s, double to_s);

struct trace_result {
    size_t spans, dropped;
    double seconds; /* from trace_begin to trace_end */
    double device;  /* share of the time in which kernels ran, 0..1 */
    double cores;   /* processor seconds a second: mean number of busy cores */
};
/* Writes the file under another name, renames it, and stops recording. Call it after a failed run
 * too, because the spans until the failure are useful. Spans of threads that go on are ignored from
 * then on. ERR_IO. */
enum err_code trace_end(struct trace_result *out, struct err *e) ERR_USE;

#endif
