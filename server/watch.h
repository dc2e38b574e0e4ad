/* Clients that are slow, idle or gone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WATCH_H
#define SERVER_WATCH_H

#include "server/services.h"

enum watch_phase { WATCH_IDLE, WATCH_HEADER, WATCH_BODY, WATCH_WORK, WATCH_SEND };
struct watch;
struct watch_slot;
/* Connections up to `limit`. gone() is called under no lock when a waiting client has hung up and
 * its job was left; it must resume the connection. */
enum err_code watch_open(size_t limit, struct services *s, void (*gone)(struct job_waiter *w),
                         struct watch **out, struct err *e) ERR_USE;
void watch_close(struct watch **w);
struct watch_slot *watch_add(struct watch *w, int fd); /* NULL when full */
void watch_remove(struct watch *w, struct watch_slot *slot);
/* Enter a phase that must end within `timeout_s` (0 = for ever). Lock-free. */
void watch_phase(struct watch_slot *slot, enum watch_phase phase, double timeout_s);
uint32_t watch_requests(struct watch_slot *slot); /* counts requests of the connection: 1, 2, ... */
/* While w waits for its job, look whether the client hangs up: expect before job_submit, arm after
 * it, disarm before resuming (if that came first, arm does nothing). */
void watch_expect(struct watch *w, struct watch_slot *slot);
void watch_arm(struct watch *w, struct watch_slot *slot, struct job_waiter *waiter);
void watch_disarm(struct watch *w, struct watch_slot *slot);
void watch_stop_idle(struct watch *w); /* end of reading for idle connections: used to drain */

#endif
