/* Whose job comes next: a queue in which clients take turns.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TURN_H
#define SERVER_TURN_H

#include "core/base.h"

struct turn_client;
struct turn_item { /* in what waits; {0} until turn_add */
    struct turn_item *newer, *older;
    struct turn_client *client;
};
struct turns; /* one queue; the caller has the lock */

/* newest_first: of a client's items the newest comes first, and the oldest gives way (pictures);
 * else the oldest comes first, and the newest gives way. turn_close it when it is empty.
 * ERR_MEM. */
enum err_code turn_open(bool newest_first, struct turns **out, struct err *e) ERR_USE;
void turn_close(struct turns **q);
/* Put an item of a client (any number that tells clients apart) at its end of the queue. */
void turn_add(struct turns *q, struct turn_item *it, uint64_t client);
void turn_remove(struct turns *q, struct turn_item *it);
/* Take out what comes next: of the client whose last turn is longest ago. NULL: nothing waits. */
struct turn_item *turn_next(struct turns *q);
/* The queue is full, and `client` comes with one more: the item that gives way, still in the queue,
 * or NULL: the new one does. It is one of whoever has most, the new one counted; of several, of the
 * one who had a turn last. */
struct turn_item *turn_shed(struct turns *q, uint64_t client);
/* `client` wants this item as well: from now on it counts as its own, if it has fewer than the
 * owner. */
void turn_join(struct turns *q, struct turn_item *it, uint64_t client);
uint64_t turn_owner(const struct turn_item *it);
size_t turn_count(const struct turns *q);

#endif
