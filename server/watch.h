/* Clients that are slow, idle or gone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WATCH_H
#define SERVER_WATCH_H

#include "server/services.h"

enum watch_phase { WATCH_IDLE, WATCH_HEADER, WATCH_BODY, WATCH_WORK, WATCH_SEND, WATCH_STREAM };
struct motion_stream;
struct watch;
struct watch_slot;
/* For `most` connections; at that number new ones take the places of others. gone() is called under
 * no lock when a waiting client has hung up and its job was left; it must resume the connection. */
enum err_code watch_open(size_t most, struct services *s, void (*gone)(struct job_waiter *w),
                         struct watch **out, struct err *e) ERR_USE;
void watch_close(struct watch **w);
/* A new connection of a client, who may have `limit` of them (0: any number). Where there are too
 * many, of the client or in all, one that is idle, or slow with its request or with reading an
 * answer, is ended instead: of this client, or of whoever has most. *over: there is none such.
 * NULL: no slot. */
struct watch_slot *watch_add(struct watch *w, int fd, uint64_t client, size_t limit, bool *over);
void watch_remove(struct watch *w, struct watch_slot *slot);
/* Enter a phase that must end within `timeout_s` (0 = for ever). Lock-free. */
void watch_phase(struct watch_slot *slot, enum watch_phase phase, double timeout_s);
/* The same for a caller that has just asked clock_s(). */
void watch_phase_at(struct watch_slot *slot, enum watch_phase phase, double timeout_s,
                    double now_s);
uint32_t watch_requests(struct watch_slot *slot); /* counts requests of the connection: 1, 2, ... */
/* While w waits for its job, look whether the client hangs up: expect before job_submit, arm after
 * it, disarm before resuming (if that came first, arm does nothing). */
void watch_expect(struct watch *w, struct watch_slot *slot);
void watch_arm(struct watch *w, struct watch_slot *slot, struct job_waiter *waiter);
/* The same of a reader of a stream, which is ended when it hangs up; until watch_disarm. */
void watch_arm_stream(struct watch *w, struct watch_slot *slot, struct motion_stream *st);
void watch_disarm(struct watch *w, struct watch_slot *slot);
void watch_stop_idle(struct watch *w); /* end of reading for idle connections: used to drain */

#endif
