/* The last failures, by the name of the work.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/failure.h"

#include <math.h>
#include <stdio.h>

static struct failure *failure_of(struct failures *f, struct hash128 id)
{
    for (size_t i = 0; i < FAILURE_KEPT; i++)
        if (f->kept[i].pause_s > 0 && f->kept[i].id.lo == id.lo && f->kept[i].id.hi == id.hi)
            return &f->kept[i];
    return NULL;
}

const struct failure *failure_find(const struct failures *f, struct hash128 id, double now_s)
{
    const struct failure *x = failure_of((struct failures *)(uintptr_t)f, id);
    return x && now_s < x->until_s ? x : NULL;
}

void failure_note(struct failures *f, struct hash128 id, enum err_code code, const char *msg,
                  double now_s)
{
    struct failure *x = failure_of(f, id);
    double pause_s = x ? fmin(x->pause_s * 2, 60) : f->pause_s;
    if (!x)
        x = &f->kept[f->next++ % FAILURE_KEPT];
    *x = (struct failure){.id = id, .code = code, .until_s = now_s + pause_s, .pause_s = pause_s};
    snprintf(x->msg, sizeof x->msg, "%s", msg);
}

void failure_forget(struct failures *f, struct hash128 id)
{
    struct failure *x = failure_of(f, id);
    if (x)
        x->pause_s = 0;
}

void failure_forget_all(struct failures *f)
{
    *f = (struct failures){.pause_s = f->pause_s};
}
