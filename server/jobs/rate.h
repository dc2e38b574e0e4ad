/* Limits how many requests a second a client may make: token buckets.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_RATE_H
#define SERVER_RATE_H

#include "core/base.h"

struct rate; /* for one kind of request; the caller holds the lock */

/* Allows per_s on average over burst_s seconds; 0: no limit. ERR_MEM. */
enum err_code rate_open(double per_s, double burst_s, struct rate **out, struct err *e) ERR_USE;
void rate_close(struct rate **r);
/* Takes one token of `client` and returns 0. If there is none, it takes nothing and returns the
 * seconds until there is one. */
double rate_take(struct rate *r, uint64_t client, double now_s);
/* Gives back the token that was just taken. */
void rate_give(struct rate *r, uint64_t client);

#endif
