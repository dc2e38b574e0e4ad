/* A queue in which clients take turns, so that a client with a thousand requests delays only
 * itself. Each client has a list of waiting items. Waiting clients are sorted by the time of their
 * last turn. Taking and adding an item are a few pointer operations. The list is searched for the
 * item to shed.
 *
 * Clients are in a table of sets. A new client replaces the one in its set that had no turn for the
 * longest time. If all clients of a set are waiting, two share an entry and a turn.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/turn.h"

enum { TURN_SETS = 512, TURN_WAYS = 4 };

struct turn_client {
    uint64_t number, served; /* served: turn of its last; 0: none yet */
    struct turn_item *newest, *oldest;
    size_t n;
    struct turn_client *earlier, *later; /* in the row, while n > 0 */
};
struct turns {
    bool newest_first;
    uint64_t turn;
    size_t n;
    struct turn_client *first, *last; /* the row */
    struct turn_client client[TURN_SETS][TURN_WAYS];
};

enum err_code turn_open(bool newest_first, struct turns **out, struct err *e)
{
    *out = mem_array(1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "queue: out of memory");
    (*out)->newest_first = newest_first;
    return ERR_OK;
}

void turn_close(struct turns **q)
{
    mem_free(*q);
    *q = NULL;
}

/* The place of a client, NULL if it is not known. */
static struct turn_client *turn_known(struct turns *q, uint64_t number)
{
    struct turn_client *set = q->client[number % TURN_SETS];
    for (int i = 0; i < TURN_WAYS; i++)
        if (set[i].number == number && (set[i].served || set[i].n))
            return &set[i];
    return NULL;
}

static struct turn_client *turn_place(struct turns *q, uint64_t number)
{
    struct turn_client *set = q->client[number % TURN_SETS], *c = turn_known(q, number);
    if (c)
        return c;
    for (int i = 0; i < TURN_WAYS; i++)
        if (!set[i].n && (!c || set[i].served < c->served))
            c = &set[i];
    if (!c)
        return &set[0];
    *c = (struct turn_client){.number = number};
    return c;
}

/* Into the row, which ascends by `served`. */
static void turn_row_add(struct turns *q, struct turn_client *c)
{
    struct turn_client *before = q->last;
    while (before && before->served > c->served)
        before = before->earlier;
    c->earlier = before;
    c->later = before ? before->later : q->first;
    *(c->earlier ? &c->earlier->later : &q->first) = c;
    *(c->later ? &c->later->earlier : &q->last) = c;
}

static void turn_row_remove(struct turns *q, struct turn_client *c)
{
    *(c->earlier ? &c->earlier->later : &q->first) = c->later;
    *(c->later ? &c->later->earlier : &q->last) = c->earlier;
    c->earlier = c->later = NULL;
}

void turn_add(struct turns *q, struct turn_item *it, uint64_t client)
{
    struct turn_client *c = turn_place(q, client);
    it->client = c;
    it->older = c->newest;
    it->newer = NULL;
    *(c->newest ? &c->newest->newer : &c->oldest) = it;
    c->newest = it;
    q->n++;
    if (!c->n++)
        turn_row_add(q, c);
}

void turn_remove(struct turns *q, struct turn_item *it)
{
    struct turn_client *c = it->client;
    *(it->newer ? &it->newer->older : &c->newest) = it->older;
    *(it->older ? &it->older->newer : &c->oldest) = it->newer;
    *it = (struct turn_item){0};
    q->n--;
    if (!--c->n)
        turn_row_remove(q, c);
}

struct turn_item *turn_next(struct turns *q)
{
    struct turn_client *c = q->first;
    struct turn_item *it = !c ? NULL : q->newest_first ? c->newest : c->oldest;
    if (!it)
        return NULL;
    turn_remove(q, it);
    if (c->n)
        turn_row_remove(q, c);
    c->served = ++q->turn;
    if (c->n)
        turn_row_add(q, c);
    return it;
}

struct turn_item *turn_shed(struct turns *q, uint64_t client)
{
    struct turn_client *asks = turn_known(q, client), *most = NULL;
    size_t n_asks = (asks ? asks->n : 0) + 1;
    for (struct turn_client *c = q->last; c; c = c->earlier)
        if (c != asks && (!most || c->n > most->n))
            most = c;
    uint64_t served = asks ? asks->served : 0;
    if (!most || n_asks > most->n || (n_asks == most->n && served >= most->served))
        most = asks; /* may be NULL */
    if (!most || !most->n || (most == asks && !q->newest_first))
        return NULL;
    return q->newest_first ? most->oldest : most->newest;
}

void turn_join(struct turns *q, struct turn_item *it, uint64_t client)
{
    struct turn_client *c = turn_known(q, client);
    if (c == it->client || (c && c->n >= it->client->n) || (!c && it->client->n < 2))
        return;
    turn_remove(q, it);
    turn_add(q, it, client);
}

uint64_t turn_owner(const struct turn_item *it)
{
    return it->client->number;
}

size_t turn_count(const struct turns *q)
{
    return q->n;
}
