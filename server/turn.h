/* A queue in which clients have equal parts of the time.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TURN_H
#define SERVER_TURN_H

#include "core/base.h"

struct turn_client;
struct turn_item { /* part of each queued thing; {0} until turn_add */
    struct turn_item *newer, *older;
    struct turn_client *client;
    double ms; /* time that it is predicted to take */
};
struct turns; /* one queue; the caller holds the lock */

/* newest_first: of a client's items the newest is served first and the oldest is shed first
 * (pictures). Else it is the other way round. Call turn_close when the queue is empty. ERR_MEM. */
enum err_code turn_open(bool newest_first, struct turns **out, struct err *e) ERR_USE;
void turn_close(struct turns **q);
/* Adds an item of a client, which takes about `ms`. `client` is any number that identifies one. */
void turn_add(struct turns *q, struct turn_item *it, uint64_t client, double ms);
void turn_remove(struct turns *q, struct turn_item *it);
/* Returns the next item and leaves it in the queue. NULL: the queue is empty. */
struct turn_item *turn_first(struct turns *q);
/* As turn_first, of the clients whose next item takes less than `ms`. */
struct turn_item *turn_first_below(struct turns *q, double ms);
/* Returns whether `client`, which has no item in the queue, would be served next if it had one. */
bool turn_is_due(struct turns *q, uint64_t client);
/* Removes an item that turn_first or turn_first_below returned. Its client's time goes on. */
void turn_take(struct turns *q, struct turn_item *it);
/* Removes and returns the next item. It belongs to the client that had least time, counted from
 * when it began to wait. NULL: the queue is empty. */
struct turn_item *turn_next(struct turns *q);
/* Chooses the item to shed when `client` wants to add one to a full queue. The item stays in the
 * queue; NULL means that the new item is refused. It is an item of the client with most items, the
 * new one included. If several clients have equally many, it is one of the client that had a turn
 * last. */
struct turn_item *turn_shed(struct turns *q, uint64_t client);
/* `client` also wants this item. If it has fewer items than the owner, the item counts as its own
 * from now on. */
void turn_join(struct turns *q, struct turn_item *it, uint64_t client);
/* Notes that an item of `client` took `ms` longer (below 0: shorter) than predicted. */
void turn_charge(struct turns *q, uint64_t client, double ms);
/* Time of all that would be served before a new item of `client`, in ms of one thread. */
double turn_wait_ms(struct turns *q, uint64_t client);
/* The oldest item of a client; NULL: it has none. */
struct turn_item *turn_oldest(struct turns *q, uint64_t client);
uint64_t turn_owner(const struct turn_item *it);
size_t turn_count(const struct turns *q);

#endif
