/* Token buckets, one a client, in a table of sets. A new client replaces the least recently used
 * one of its set. That bucket is full again by then, or there are very many clients.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/rate.h"

#include <math.h>

enum { RATE_SETS = 1024, RATE_WAYS = 4 };

struct rate_bucket {
    uint64_t client;
    double tokens, at_s; /* at_s 0: free */
};
struct rate {
    double per_s, most;
    struct rate_bucket bucket[RATE_SETS][RATE_WAYS];
};

enum err_code rate_open(double per_s, double burst_s, struct rate **out, struct err *e)
{
    *out = mem_array(1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "limits of clients: out of memory");
    (*out)->per_s = per_s;
    (*out)->most = fmax(1, per_s * burst_s);
    return ERR_OK;
}

void rate_close(struct rate **r)
{
    mem_free(*r);
    *r = NULL;
}

static struct rate_bucket *rate_find(struct rate *r, uint64_t client)
{
    struct rate_bucket *set = r->bucket[client % RATE_SETS];
    for (int i = 0; i < RATE_WAYS; i++)
        if (set[i].client == client && set[i].at_s > 0)
            return &set[i];
    return NULL;
}

void rate_give(struct rate *r, uint64_t client)
{
    struct rate_bucket *b = rate_find(r, client);
    if (b)
        b->tokens = fmin(r->most, b->tokens + 1);
}

double rate_take(struct rate *r, uint64_t client, double now_s)
{
    struct rate_bucket *set = r->bucket[client % RATE_SETS], *b = rate_find(r, client);
    if (r->per_s <= 0)
        return 0;
    if (!b) {
        b = &set[0];
        for (int i = 1; i < RATE_WAYS; i++)
            if (set[i].at_s < b->at_s)
                b = &set[i];
        *b = (struct rate_bucket){client, r->most, now_s};
    }
    b->tokens = fmin(r->most, b->tokens + fmax(0, now_s - b->at_s) * r->per_s);
    b->at_s = now_s;
    if (b->tokens < 1)
        return (1 - b->tokens) / r->per_s;
    b->tokens -= 1;
    return 0;
}
