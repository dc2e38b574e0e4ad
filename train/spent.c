/* The clock of train/spent.h and how its times are shown.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/spent.h"

#include <stdbool.h>
#include <stdio.h>

#include <jansson.h>

#include "core/base.h"

#define SPENT_SHOWN 0.005 /* of the whole: smaller shares are shown together */

static const struct {
    const char *key, *text;
} spent_names[SPENT_COUNT] = {
#define SPENT(name, key, text) {#key, text},
#include "train/spent.def"
#undef SPENT
};

void spent_start(struct spent *c, enum spent_on on)
{
    *c = (struct spent){.on = on, .since_s = clock_s()};
}

enum spent_on spent_turn(struct spent *c, enum spent_on on)
{
    enum spent_on was = c->on;
    double now = clock_s();
    c->times.s[was] += now - c->since_s;
    c->since_s = now;
    c->on = on;
    return was;
}

struct spent_times spent_now(struct spent *c)
{
    (void)spent_turn(c, c->on);
    return c->times;
}

double spent_total(const struct spent_times *t)
{
    double sum = 0.0;
    for (size_t i = 0; i < SPENT_COUNT; i++)
        sum += t->s[i];
    return sum;
}

void spent_add(struct spent_times *to, const struct spent_times *t)
{
    for (size_t i = 0; i < SPENT_COUNT; i++)
        to->s[i] += t->s[i];
}

struct spent_times spent_since(const struct spent_times *now, const struct spent_times *then)
{
    struct spent_times d;
    for (size_t i = 0; i < SPENT_COUNT; i++)
        d.s[i] = now->s[i] - then->s[i];
    return d;
}

const char *spent_key(enum spent_on on)
{
    return spent_names[on].key;
}

void spent_text(const struct spent_times *t, char *out, size_t size)
{
    double total = spent_total(t), rest = t->s[SPENT_OTHER];
    bool shown[SPENT_COUNT] = {[SPENT_OTHER] = true};
    size_t at = 0;
    out[0] = '\0';
    for (size_t k = 1; k < SPENT_COUNT; k++) {
        size_t most = 0;
        for (size_t i = 1; i < SPENT_COUNT; i++)
            if (!shown[i] && (!most || t->s[i] > t->s[most]))
                most = i;
        shown[most] = true;
        if (!(t->s[most] >= SPENT_SHOWN * total) || !(t->s[most] > 0.0)) {
            rest += t->s[most];
            continue;
        }
        int n = snprintf(out + at, size - at, "%s %.1f s (%.0f %%), ", spent_names[most].text,
                         t->s[most], 100.0 * t->s[most] / total);
        at += (size_t)n < size - at ? (size_t)n : size - at - 1;
    }
    snprintf(out + at, size - at, "%s %.1f s", spent_names[SPENT_OTHER].text, rest);
}

json_t *spent_json(const struct spent_times *t)
{
    json_t *o = json_object();
    for (size_t i = 0; o && i < SPENT_COUNT; i++)
        if (json_object_set_new(o, spent_names[i].key, json_real(t->s[i]))) {
            json_decref(o);
            o = NULL;
        }
    return o;
}

void spent_from_json(const json_t *o, struct spent_times *out)
{
    for (size_t i = 0; i < SPENT_COUNT; i++) {
        double s = json_number_value(json_object_get(o, spent_names[i].key));
        out->s[i] = s >= 0.0 ? s : 0.0;
    }
}
