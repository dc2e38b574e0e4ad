/* A queue in which clients have equal parts of the time.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FAIR_QUEUE_H
#define SERVER_FAIR_QUEUE_H

#include "core/base.h"

struct fair_queue_client;
struct fair_queue_item { /* part of each queued thing; {0} until fair_queue_add */
    struct fair_queue_item *newer, *older;
    struct fair_queue_client *client;
    double ms; /* time that it is predicted to take */
};
struct fair_queue; /* one queue; the caller holds the lock */

/* newest_first: of a client's items the newest is served first and the oldest is shed first
 * (pictures). Else it is the other way round. Call fair_queue_close when the queue is empty.
 * ERR_MEM. */
enum err_code fair_queue_open(bool newest_first, struct fair_queue **out, struct err *e) ERR_USE;
void fair_queue_close(struct fair_queue **q);
/* Adds an item of a client, which takes about `ms`. `client` is any number that identifies one. */
void fair_queue_add(struct fair_queue *q, struct fair_queue_item *it, uint64_t client, double ms);
void fair_queue_remove(struct fair_queue *q, struct fair_queue_item *it);
/* Returns the next item and leaves it in the queue. NULL: the queue is empty. */
struct fair_queue_item *fair_queue_first(struct fair_queue *q);
/* As fair_queue_first, of the clients whose next item takes less than `ms`. */
struct fair_queue_item *fair_queue_first_below(struct fair_queue *q, double ms);
/* Returns whether `client`, which has no item in the queue, would be served next if it had one. */
bool fair_queue_is_due(struct fair_queue *q, uint64_t client);
/* Removes an item that fair_queue_first or fair_queue_first_below returned, and advances the clock
 * of its client by the predicted time. */
void fair_queue_take(struct fair_queue *q, struct fair_queue_item *it);
/* Removes and returns the next item: that of the client with the least clock. A client's clock is
 * the time that it had; when it begins to wait, it is set forward to that of the client served
 * last. NULL: the queue is empty. */
struct fair_queue_item *fair_queue_next(struct fair_queue *q);
/* Chooses the item to shed when `client` wants to add one to a full queue. The item stays in the
 * queue; NULL means that the new item is refused. It is an item of the client with most items, the
 * new one included. If several clients have equally many, it is one of the client that had a turn
 * last. */
struct fair_queue_item *fair_queue_shed(struct fair_queue *q, uint64_t client);
/* `client` also wants this item. If it has fewer items than the owner, the item counts as its own
 * from now on. */
void fair_queue_join(struct fair_queue *q, struct fair_queue_item *it, uint64_t client);
/* Notes that an item of `client` took `ms` longer (below 0: shorter) than predicted. */
void fair_queue_charge(struct fair_queue *q, uint64_t client, double ms);
/* Time of all that would be served before a new item of `client`, in ms of one thread. */
double fair_queue_wait_ms(struct fair_queue *q, uint64_t client);
/* The oldest item of a client; NULL: it has none. */
struct fair_queue_item *fair_queue_oldest(struct fair_queue *q, uint64_t client);
uint64_t fair_queue_owner(const struct fair_queue_item *it);
size_t fair_queue_count(const struct fair_queue *q);

#endif
