/* Where the time of a run goes: one clock that is always charged to exactly one kind of work, so
 * that the shares add up to the whole.
 *
 * Work on the device goes on while the host does other things. Who turns the clock to rare work
 * that waits for the device (densification, checkpoints) lets the device finish first, or that work
 * would pay for the step before it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SPENT_H
#define TRAIN_SPENT_H

#include <stddef.h>

struct json_t; /* jansson.h */

enum spent_on {
#define SPENT(name, key, text) SPENT_##name,
#include "train/spent.def"
#undef SPENT
    SPENT_COUNT
};

struct spent_times { /* seconds by kind of work; {0} is none */
    double s[SPENT_COUNT];
};
struct spent { /* a running clock; spent_start it */
    struct spent_times times;
    enum spent_on on;
    double since_s; /* of clock_s */
};

void spent_start(struct spent *c, enum spent_on on);
/* From now on time goes to `on`; returns what it went to. */
enum spent_on spent_turn(struct spent *c, enum spent_on on);
/* Up to this moment; the clock goes on. */
struct spent_times spent_now(struct spent *c);

double spent_total(const struct spent_times *t);
void spent_add(struct spent_times *to, const struct spent_times *t);
/* What was spent since `then`, an earlier spent_now. */
struct spent_times spent_since(const struct spent_times *now, const struct spent_times *then);
const char *spent_key(enum spent_on on);
/* "steps 24.1 s (83 %), densification 1.9 s (7 %), ...": the largest first, those below half a per
 * cent together. */
void spent_text(const struct spent_times *t, char *out, size_t size);

/* {"step": s, ...}, seconds; NULL when out of memory. And back: what is missing or no number is
 * 0. */
struct json_t *spent_json(const struct spent_times *t);
void spent_from_json(const struct json_t *o, struct spent_times *out);

#endif
