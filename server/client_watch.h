/* Ends connections of clients that are slow, idle or gone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CLIENT_WATCH_H
#define SERVER_CLIENT_WATCH_H

#include "server/answers/services.h"

enum client_watch_phase {
    CLIENT_WATCH_IDLE,
    CLIENT_WATCH_HEADER,
    CLIENT_WATCH_BODY,
    CLIENT_WATCH_WORK,
    CLIENT_WATCH_SEND,
    CLIENT_WATCH_STREAM
};
struct view_stream;
struct client_watch;
struct client_watch_slot;
/* Watches up to `most` connections. At that number a new connection displaces another. gone() is
 * called without a lock when a waiting client has hung up and its job was left; it must resume the
 * connection. ERR_MEM. */
enum err_code client_watch_open(size_t most, struct services *s, void (*gone)(struct job_waiter *w),
                                struct client_watch **out, struct err *e) ERR_USE;
void client_watch_close(struct client_watch **w);
/* Adds a connection of a client, which may have `limit` of them (0: no limit). If there are too
 * many, of this client or in all, another one is ended: an idle one, or one that is slow to send
 * its request or to read an answer. It is one of this client, or of the client with most
 * connections. *over: there is no such connection. NULL: no slot. */
struct client_watch_slot *client_watch_add(struct client_watch *w, int fd, uint64_t client,
                                           size_t limit, bool *over);
void client_watch_remove(struct client_watch *w, struct client_watch_slot *slot);
/* Enters a phase that must end within `timeout_s` (0 = no limit). Lock-free. */
void client_watch_phase(struct client_watch_slot *slot, enum client_watch_phase phase,
                        double timeout_s);
/* As client_watch_phase, for a caller that has the time of clock_s(). */
void client_watch_phase_at(struct client_watch_slot *slot, enum client_watch_phase phase,
                           double timeout_s, double now_s);
/* counts requests of the connection: 1, 2, ... */
uint32_t client_watch_requests(struct client_watch_slot *slot);
/* Watch whether the client hangs up while w waits for its job. Call client_watch_expect before
 * job_submit, client_watch_arm after it, and client_watch_disarm before resuming. If
 * client_watch_disarm came first, client_watch_arm does nothing. */
void client_watch_expect(struct client_watch *w, struct client_watch_slot *slot);
void client_watch_arm(struct client_watch *w, struct client_watch_slot *slot,
                      struct job_waiter *waiter);
/* The same for the reader of a stream, until client_watch_disarm. The stream ends when the reader
 * hangs up. */
void client_watch_arm_stream(struct client_watch *w, struct client_watch_slot *slot,
                             struct view_stream *st);
void client_watch_disarm(struct client_watch *w, struct client_watch_slot *slot);
/* ends reading on idle connections, before the server stops */
void client_watch_stop_idle(struct client_watch *w);

#endif
