/* Bodies that are alive: a job has made them, and they are not freed yet, because the cache holds
 * them or a client is still reading. Requests for one of them share it, however large it is. Their
 * bytes count against a budget.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LIVE_BODIES_H
#define SERVER_LIVE_BODIES_H

#include "server/base/body.h"

struct live_bodies;
/* limit_bytes: budget for bodies that the cache does not hold. Call live_bodies_close after the
 * last body is dropped. ERR_MEM. */
enum err_code live_bodies_open(size_t limit_bytes, struct live_bodies **out, struct err *e) ERR_USE;
void live_bodies_close(struct live_bodies **f);
/* Returns a reference to the live body of this name, or NULL. Any thread. */
struct body *live_bodies_get(struct live_bodies *f, struct hash128 id);
/* Adds a body before it is shared. It is removed when it is freed. */
void live_bodies_add(struct live_bodies *f, struct hash128 id, struct body *b);
/* Reserves room for a body of about `bytes` before it is made. Call live_bodies_release with the
 * same number after live_bodies_add, or after a failure. `cached`: bytes of live bodies that the
 * cache holds. ERR_BUSY: slow readers hold too many bytes. A single body is allowed even if it is
 * larger than the budget. */
enum err_code live_bodies_reserve(struct live_bodies *f, size_t bytes, size_t cached,
                                  struct err *e) ERR_USE;
void live_bodies_release(struct live_bodies *f, size_t bytes);
/* Bytes that count against the limit: live bodies beyond `cached`, and bodies that are being made.
 */
size_t live_bodies_held(const struct live_bodies *f, size_t cached);
size_t live_bodies_limit(const struct live_bodies *f);
/* Bytes of all live bodies. */
size_t live_bodies_bytes(const struct live_bodies *f);

#endif
