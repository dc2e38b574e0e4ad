/* Measures the time of a run by kind of work. There is one clock, and it always counts for exactly
 * one kind, so the shares add up to the whole.
 *
 * The device works while the host does other things. Wait for the device before the clock is turned
 * to work that waits for it, such as densification or checkpoints. Otherwise the time of the step
 * before is counted there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TIMING_H
#define TRAIN_TIMING_H

#include <stddef.h>

struct json_t; /* jansson.h */

enum timing_on {
#define TIMING(name, key, text) TIMING_##name,
#include "train/base/timing.def"
#undef TIMING
    TIMING_COUNT
};

struct timing_seconds { /* seconds by kind of work; {0} is none */
    double s[TIMING_COUNT];
};
struct timing { /* a running clock; start it with timing_start */
    struct timing_seconds times;
    enum timing_on on;
    double since_s;          /* clock_s at the last turn */
    const double *compile_s; /* the device's seconds of compiling so far; NULL: not known */
    double compiled_s;       /* part of *compile_s that TIMING_COMPILE has counted */
};

void timing_start(struct timing *c, enum timing_on on);
/* From now on, growth of *compile_s (borrowed) counts as TIMING_COMPILE, whatever the clock is on.
 */
void timing_compiles(struct timing *c, const double *compile_s);
/* From now on time counts for `on`. Returns the kind before. */
enum timing_on timing_turn(struct timing *c, enum timing_on on);
/* The times up to now. The clock goes on. */
struct timing_seconds timing_now(struct timing *c);

double timing_total(const struct timing_seconds *t);
void timing_add(struct timing_seconds *to, const struct timing_seconds *t);
/* The times between `then`, an earlier timing_now, and `now`. */
struct timing_seconds timing_since(const struct timing_seconds *now,
                                   const struct timing_seconds *then);
/* Writes "steps 24.1 s (83 %), densification 1.9 s (7 %), ...", largest first. Kinds below half a
 * per cent are added up. */
void timing_text(const struct timing_seconds *t, char *out, size_t size);

/* Convert times to {"step": s, ...} in seconds (NULL: out of memory), and back. Missing or invalid
 * members become 0. */
struct json_t *timing_json(const struct timing_seconds *t);
void timing_from_json(const struct json_t *o, struct timing_seconds *out);

#endif
