/* How many things a second a client may ask for: token buckets.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_RATE_H
#define SERVER_RATE_H

#include "core/base.h"

struct rate; /* of one kind of thing; the caller has the lock */

/* per_s on average over burst_s seconds; 0: no limit. ERR_MEM. */
enum err_code rate_open(double per_s, double burst_s, struct rate **out, struct err *e) ERR_USE;
void rate_close(struct rate **r);
/* One more of `client`: 0 when it may have it, else the seconds until it may (nothing is taken). */
double rate_take(struct rate *r, uint64_t client, double now_s);
/* What was just taken came to nothing: it is given back. */
void rate_give(struct rate *r, uint64_t client);

#endif
