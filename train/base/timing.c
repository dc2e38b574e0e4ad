/* The clock of train/base/timing.h, and its times as text and JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/base/timing.h"

#include <stdbool.h>
#include <stdio.h>

#include <jansson.h>

#include "core/base.h"
#include "core/trace.h"

#define TIMING_SHOWN 0.005 /* of the whole: smaller shares are shown together */

static const struct {
    const char *key, *text;
} timing_names[TIMING_COUNT] = {
#define TIMING(name, key, text) {#key, text},
#include "train/base/timing.def"
#undef TIMING
};

void timing_start(struct timing *c, enum timing_on on)
{
    *c = (struct timing){.on = on, .since_s = clock_s()};
}

void timing_compiles(struct timing *c, const double *compile_s)
{
    c->compile_s = compile_s;
    c->compiled_s = *compile_s;
}

enum timing_on timing_turn(struct timing *c, enum timing_on on)
{
    enum timing_on was = c->on;
    double now = clock_s(), compiled = c->compile_s ? *c->compile_s - c->compiled_s : 0.0;
    c->compiled_s += compiled;
    c->times.s[TIMING_COMPILE] += compiled;
    c->times.s[was] += now - c->since_s - compiled;
    trace_span("work", timing_names[was].text, c->since_s, now);
    c->since_s = now;
    c->on = on;
    return was;
}

struct timing_seconds timing_now(struct timing *c)
{
    (void)timing_turn(c, c->on);
    return c->times;
}

double timing_total(const struct timing_seconds *t)
{
    double sum = 0.0;
    for (size_t i = 0; i < TIMING_COUNT; i++)
        sum += t->s[i];
    return sum;
}

void timing_add(struct timing_seconds *to, const struct timing_seconds *t)
{
    for (size_t i = 0; i < TIMING_COUNT; i++)
        to->s[i] += t->s[i];
}

struct timing_seconds timing_since(const struct timing_seconds *now,
                                   const struct timing_seconds *then)
{
    struct timing_seconds d;
    for (size_t i = 0; i < TIMING_COUNT; i++)
        d.s[i] = now->s[i] - then->s[i];
    return d;
}

void timing_text(const struct timing_seconds *t, char *out, size_t size)
{
    double total = timing_total(t), rest = t->s[TIMING_OTHER];
    bool shown[TIMING_COUNT] = {[TIMING_OTHER] = true};
    size_t at = 0;
    out[0] = '\0';
    for (size_t k = 1; k < TIMING_COUNT; k++) {
        size_t most = 0;
        for (size_t i = 1; i < TIMING_COUNT; i++)
            if (!shown[i] && (!most || t->s[i] > t->s[most]))
                most = i;
        shown[most] = true;
        if (!(t->s[most] >= TIMING_SHOWN * total) || !(t->s[most] > 0.0)) {
            rest += t->s[most];
            continue;
        }
        int n = snprintf(out + at, size - at, "%s %.1f s (%.0f %%), ", timing_names[most].text,
                         t->s[most], 100.0 * t->s[most] / total);
        at += (size_t)n < size - at ? (size_t)n : size - at - 1;
    }
    snprintf(out + at, size - at, "%s %.1f s", timing_names[TIMING_OTHER].text, rest);
}

json_t *timing_json(const struct timing_seconds *t)
{
    json_t *o = json_object();
    for (size_t i = 0; o && i < TIMING_COUNT; i++)
        if (json_object_set_new(o, timing_names[i].key, json_real(t->s[i]))) {
            json_decref(o);
            o = NULL;
        }
    return o;
}

void timing_from_json(const json_t *o, struct timing_seconds *out)
{
    for (size_t i = 0; i < TIMING_COUNT; i++) {
        double s = json_number_value(json_object_get(o, timing_names[i].key));
        out->s[i] = s >= 0.0 ? s : 0.0;
    }
}
