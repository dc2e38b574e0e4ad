/* Ends connections of clients that are slow, idle or gone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WATCH_H
#define SERVER_WATCH_H

#include "server/services.h"

enum watch_phase { WATCH_IDLE, WATCH_HEADER, WATCH_BODY, WATCH_WORK, WATCH_SEND, WATCH_STREAM };
struct view_stream;
struct watch;
struct watch_slot;
/* Watches up to `most` connections. At that number a new connection displaces another. gone() is
 * called without a lock when a waiting client has hung up and its job was left; it must resume the
 * connection. ERR_MEM. */
enum err_code watch_open(size_t most, struct services *s, void (*gone)(struct job_waiter *w),
                         struct watch **out, struct err *e) ERR_USE;
void watch_close(struct watch **w);
/* Adds a connection of a client, which may have `limit` of them (0: no limit). If there are too
 * many, of this client or in all, another one is ended: an idle one, or one that is slow to send
 * its request or to read an answer. It is one of this client, or of the client with most
 * connections. *over: there is no such connection. NULL: no slot. */
struct watch_slot *watch_add(struct watch *w, int fd, uint64_t client, size_t limit, bool *over);
void watch_remove(struct watch *w, struct watch_slot *slot);
/* Enters a phase that must end within `timeout_s` (0 = no limit). Lock-free. */
void watch_phase(struct watch_slot *slot, enum watch_phase phase, double timeout_s);
/* As watch_phase, for a caller that has the time of clock_s(). */
void watch_phase_at(struct watch_slot *slot, enum watch_phase phase, double timeout_s,
                    double now_s);
/* counts requests of the connection: 1, 2, ... */
uint32_t watch_requests(struct watch_slot *slot);
/* Watch whether the client hangs up while w waits for its job. Call watch_expect before job_submit,
 * watch_arm after it, and watch_disarm before resuming. If watch_disarm came first, watch_arm does
 * nothing. */
void watch_expect(struct watch *w, struct watch_slot *slot);
void watch_arm(struct watch *w, struct watch_slot *slot, struct job_waiter *waiter);
/* The same for the reader of a stream, until watch_disarm. The stream ends when the reader hangs
 * up. */
void watch_arm_stream(struct watch *w, struct watch_slot *slot, struct view_stream *st);
void watch_disarm(struct watch *w, struct watch_slot *slot);
/* ends reading on idle connections, before the server stops */
void watch_stop_idle(struct watch *w);

#endif
