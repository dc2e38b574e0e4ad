/* Where the time of a run goes: one clock that is always charged to exactly one kind of work, so
 * that the shares add up to the whole.
 *
 * Work on the device goes on while the host does other things. Before the clock is turned to work
 * that waits for the device (densification, checkpoints), let the device finish. Otherwise that
 * work is charged with the step before it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TIMING_H
#define TRAIN_TIMING_H

#include <stddef.h>

struct json_t; /* jansson.h */

enum timing_on {
#define TIMING(name, key, text) TIMING_##name,
#include "train/timing.def"
#undef TIMING
    TIMING_COUNT
};

struct timing_seconds { /* seconds by kind of work; {0} is none */
    double s[TIMING_COUNT];
};
struct timing { /* a running clock; timing_start it */
    struct timing_seconds times;
    enum timing_on on;
    double since_s;          /* of clock_s */
    const double *compile_s; /* of the device: seconds spent on compiling so far; NULL: unknown */
    double compiled_s;       /* of them, those that TIMING_COMPILE has */
};

void timing_start(struct timing *c, enum timing_on on);
/* From now on what *compile_s (borrowed) grows by goes to TIMING_COMPILE, whatever the clock is
 * on. */
void timing_compiles(struct timing *c, const double *compile_s);
/* From now on time goes to `on`; returns what it went to. */
enum timing_on timing_turn(struct timing *c, enum timing_on on);
/* Up to this moment; the clock goes on. */
struct timing_seconds timing_now(struct timing *c);

double timing_total(const struct timing_seconds *t);
void timing_add(struct timing_seconds *to, const struct timing_seconds *t);
/* What was spent since `then`, an earlier timing_now. */
struct timing_seconds timing_since(const struct timing_seconds *now,
                                   const struct timing_seconds *then);
const char *timing_key(enum timing_on on);
/* "steps 24.1 s (83 %), densification 1.9 s (7 %), ...": the largest first. Kinds below half a per
 * cent are added up. */
void timing_text(const struct timing_seconds *t, char *out, size_t size);

/* {"step": s, ...}, seconds; NULL when out of memory. And back: what is missing or no number is
 * 0. */
struct json_t *timing_json(const struct timing_seconds *t);
void timing_from_json(const struct json_t *o, struct timing_seconds *out);

#endif
