/* A queue in which clients have equal parts of the time, so that a client with a thousand requests,
 * or with dear ones, delays only itself. Each client has a list of waiting items and a clock, which
 * advances by what its items take. The client whose clock is least is served. The clock of one that
 * begins to wait is set to that of the client served last, so nobody saves time up (start-time fair
 * queueing: Goyal, Vin, Cheng 1996; the result is that of deficit round robin with a quantum of
 * zero). Waiting clients are sorted by their clocks. Taking and adding an item are a few pointer
 * operations. The list is searched for the item to shed.
 *
 * Clients are in a table of sets. A new client replaces the one in its set that had no turn for the
 * longest time. If all clients of a set are waiting, two share an entry and a turn.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/jobs/fair_queue.h"

#include <math.h>

#define FAIR_QUEUE_LEAST_MS 1e-3 /* nothing is for nothing */
enum { FAIR_QUEUE_SETS = 512, FAIR_QUEUE_WAYS = 4 };

struct fair_queue_client {
    uint64_t number;
    double clock_ms, ms; /* clock 0: never served; ms: of its items */
    struct fair_queue_item *newest, *oldest;
    size_t n;
    struct fair_queue_client *earlier, *later; /* in the row, while n > 0 */
};
struct fair_queue {
    bool newest_first;
    double now_ms; /* clock of the client that was served last, before it was */
    size_t n;
    struct fair_queue_client *first, *last; /* the row */
    struct fair_queue_client client[FAIR_QUEUE_SETS][FAIR_QUEUE_WAYS];
};

enum err_code fair_queue_open(bool newest_first, struct fair_queue **out, struct err *e)
{
    *out = mem_array(1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "queue: out of memory");
    (*out)->newest_first = newest_first;
    return ERR_OK;
}

void fair_queue_close(struct fair_queue **q)
{
    mem_free(*q);
    *q = NULL;
}

/* The place of a client, NULL if it is not known. */
static struct fair_queue_client *fair_queue_known(struct fair_queue *q, uint64_t number)
{
    struct fair_queue_client *set = q->client[number % FAIR_QUEUE_SETS];
    for (int i = 0; i < FAIR_QUEUE_WAYS; i++)
        if (set[i].number == number && (set[i].clock_ms > 0 || set[i].n))
            return &set[i];
    return NULL;
}

static struct fair_queue_client *fair_queue_place(struct fair_queue *q, uint64_t number)
{
    struct fair_queue_client *set = q->client[number % FAIR_QUEUE_SETS],
                             *c = fair_queue_known(q, number);
    if (c)
        return c;
    for (int i = 0; i < FAIR_QUEUE_WAYS; i++)
        if (!set[i].n && (!c || set[i].clock_ms < c->clock_ms))
            c = &set[i];
    if (!c)
        return &set[0];
    *c = (struct fair_queue_client){.number = number};
    return c;
}

/* Into the row, which ascends by clocks. */
static void fair_queue_row_add(struct fair_queue *q, struct fair_queue_client *c)
{
    struct fair_queue_client *before = q->last;
    while (before && before->clock_ms > c->clock_ms)
        before = before->earlier;
    c->earlier = before;
    c->later = before ? before->later : q->first;
    *(c->earlier ? &c->earlier->later : &q->first) = c;
    *(c->later ? &c->later->earlier : &q->last) = c;
}

static void fair_queue_row_remove(struct fair_queue *q, struct fair_queue_client *c)
{
    *(c->earlier ? &c->earlier->later : &q->first) = c->later;
    *(c->later ? &c->later->earlier : &q->last) = c->earlier;
    c->earlier = c->later = NULL;
}

void fair_queue_add(struct fair_queue *q, struct fair_queue_item *it, uint64_t client, double ms)
{
    struct fair_queue_client *c = fair_queue_place(q, client);
    it->client = c;
    it->older = c->newest;
    it->newer = NULL;
    *(c->newest ? &c->newest->newer : &c->oldest) = it;
    c->newest = it;
    it->ms = ms;
    c->ms += ms;
    q->n++;
    if (c->n++)
        return;
    c->clock_ms = fmax(c->clock_ms, q->now_ms);
    fair_queue_row_add(q, c);
}

void fair_queue_remove(struct fair_queue *q, struct fair_queue_item *it)
{
    struct fair_queue_client *c = it->client;
    *(it->newer ? &it->newer->older : &c->newest) = it->older;
    *(it->older ? &it->older->newer : &c->oldest) = it->newer;
    c->ms -= it->ms;
    *it = (struct fair_queue_item){0};
    q->n--;
    if (!--c->n)
        fair_queue_row_remove(q, c);
}

static void fair_queue_set_clock(struct fair_queue *q, struct fair_queue_client *c, double clock_ms)
{
    if (c->n)
        fair_queue_row_remove(q, c);
    c->clock_ms = clock_ms;
    if (c->n)
        fair_queue_row_add(q, c);
}

static struct fair_queue_item *fair_queue_of(const struct fair_queue *q,
                                             const struct fair_queue_client *c)
{
    return !c ? NULL : q->newest_first ? c->newest : c->oldest;
}

struct fair_queue_item *fair_queue_first(struct fair_queue *q)
{
    return fair_queue_of(q, q->first);
}

struct fair_queue_item *fair_queue_first_below(struct fair_queue *q, double ms)
{
    const struct fair_queue_client *c = q->first;
    while (c && fair_queue_of(q, c)->ms >= ms)
        c = c->later;
    return fair_queue_of(q, c);
}

bool fair_queue_is_due(struct fair_queue *q, uint64_t client)
{
    const struct fair_queue_client *c = fair_queue_known(q, client);
    return c && !c->n && (!q->first || fmax(c->clock_ms, q->now_ms) < q->first->clock_ms);
}

void fair_queue_take(struct fair_queue *q, struct fair_queue_item *it)
{
    struct fair_queue_client *c = it->client;
    const double ms = fmax(it->ms, FAIR_QUEUE_LEAST_MS);
    /* whoever begins to wait does not come behind a client that was passed over */
    q->now_ms = fmax(q->now_ms, q->first->clock_ms);
    fair_queue_remove(q, it);
    fair_queue_set_clock(q, c, c->clock_ms + ms);
}

struct fair_queue_item *fair_queue_next(struct fair_queue *q)
{
    struct fair_queue_item *it = fair_queue_first(q);
    if (it)
        fair_queue_take(q, it);
    return it;
}

void fair_queue_charge(struct fair_queue *q, uint64_t client, double ms)
{
    struct fair_queue_client *c = fair_queue_known(q, client);
    if (c) /* it does not go back beyond what was served meanwhile */
        fair_queue_set_clock(q, c, fmax(c->clock_ms + ms, q->now_ms + FAIR_QUEUE_LEAST_MS));
}

double fair_queue_wait_ms(struct fair_queue *q, uint64_t client)
{
    const struct fair_queue_client *own = fair_queue_known(q, client);
    const double mine = own ? own->ms : 0, until = fmax(own ? own->clock_ms : 0, q->now_ms) + mine;
    double wait = mine;
    for (const struct fair_queue_client *c = q->first; c; c = c->later)
        if (c != own && c->clock_ms <= until)
            wait += fmin(c->ms, until - c->clock_ms + c->oldest->ms);
    return wait;
}

struct fair_queue_item *fair_queue_oldest(struct fair_queue *q, uint64_t client)
{
    const struct fair_queue_client *c = fair_queue_known(q, client);
    return c && c->n ? c->oldest : NULL;
}

struct fair_queue_item *fair_queue_shed(struct fair_queue *q, uint64_t client)
{
    struct fair_queue_client *asks = fair_queue_known(q, client), *most = NULL;
    size_t n_asks = (asks ? asks->n : 0) + 1;
    for (struct fair_queue_client *c = q->last; c; c = c->earlier)
        if (c != asks && (!most || c->n > most->n))
            most = c;
    const double clock_ms = fmax(asks ? asks->clock_ms : 0, q->now_ms);
    if (!most || n_asks > most->n || (n_asks == most->n && clock_ms >= most->clock_ms))
        most = asks; /* may be NULL */
    if (!most || !most->n || (most == asks && !q->newest_first))
        return NULL;
    return q->newest_first ? most->oldest : most->newest;
}

void fair_queue_join(struct fair_queue *q, struct fair_queue_item *it, uint64_t client)
{
    struct fair_queue_client *c = fair_queue_known(q, client);
    if (c == it->client || (c && c->n >= it->client->n) || (!c && it->client->n < 2))
        return;
    const double ms = it->ms;
    fair_queue_remove(q, it);
    fair_queue_add(q, it, client, ms);
}

uint64_t fair_queue_owner(const struct fair_queue_item *it)
{
    return it->client->number;
}

size_t fair_queue_count(const struct fair_queue *q)
{
    return q->n;
}
