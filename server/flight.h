/* Bodies that are alive: a job has made them, and they are not freed yet, because the cache holds
 * them or a client is still reading. Requests for one of them share it, however large it is. Their
 * bytes count against a budget.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FLIGHT_H
#define SERVER_FLIGHT_H

#include "server/body.h"

struct flight;
/* limit_bytes: budget for bodies that the cache does not hold. Call flight_close after the last
 * body is dropped. ERR_MEM. */
enum err_code flight_open(size_t limit_bytes, struct flight **out, struct err *e) ERR_USE;
void flight_close(struct flight **f);
/* Returns a reference to the live body of this name, or NULL. Any thread. */
struct body *flight_get(struct flight *f, struct hash128 id);
/* Adds a body before it is shared. It is removed when it is freed. */
void flight_add(struct flight *f, struct hash128 id, struct body *b);
/* Reserves room for a body of about `bytes` before it is made. Call flight_release with the same
 * number after flight_add, or after a failure. `cached`: bytes of live bodies that the cache holds.
 * ERR_BUSY: slow readers hold too many bytes. A single body is allowed even if it is larger than
 * the budget. */
enum err_code flight_reserve(struct flight *f, size_t bytes, size_t cached, struct err *e) ERR_USE;
void flight_release(struct flight *f, size_t bytes);
/* Bytes that count against the limit: live bodies beyond `cached`, and bodies that are being made.
 */
size_t flight_held(const struct flight *f, size_t cached);
size_t flight_limit(const struct flight *f);
/* Bytes of all live bodies. */
size_t flight_bytes(const struct flight *f);

#endif
