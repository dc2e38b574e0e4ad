/* Bodies that are alive: made by a job and not yet freed, whether the cache holds them or a client
 * is still reading. Who asks for one of them shares it, however large it is, and their bytes count
 * against a budget.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FLIGHT_H
#define SERVER_FLIGHT_H

#include "server/body.h"

struct flight;
/* limit_bytes: of bodies that the cache does not hold. flight_close it after the last body is
 * dropped. ERR_MEM. */
enum err_code flight_open(size_t limit_bytes, struct flight **out, struct err *e) ERR_USE;
void flight_close(struct flight **f);
/* A reference to the live body of this name, or NULL. Any thread. */
struct body *flight_get(struct flight *f, struct hash128 id);
/* Enter a body, before it is shared; it leaves by itself when it is freed. */
void flight_add(struct flight *f, struct hash128 id, struct body *b);
/* Make room for a body of about `bytes` before it is made; flight_release the same number after
 * flight_add, or on failure. `cached`: bytes of live bodies that the cache answers for. ERR_BUSY:
 * what slow readers hold leaves no room. One body goes even where it is larger than the budget. */
enum err_code flight_reserve(struct flight *f, size_t bytes, size_t cached, struct err *e) ERR_USE;
void flight_release(struct flight *f, size_t bytes);
/* What the limit holds for: bytes of live bodies beyond `cached`, and of those that are being
 * made. */
size_t flight_held(const struct flight *f, size_t cached);
/* Bytes of all live bodies. */
size_t flight_bytes(const struct flight *f);

#endif
