/* Clients of IPv6. A household has a /64, but whoever has a /56 or a /48 has thousands of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CROWD_H
#define SERVER_CROWD_H

#include "server/address.h"

struct crowd; /* thread-safe */

enum { CROWD_MOST = 8 /* most parts of a network that are clients of their own at a time */ };
enum { CROWD_S = 60 /* how long a part counts after its last request */ };

/* secret: strangers who do not know it cannot choose networks that share a place in the table.
 * ERR_MEM. */
enum err_code crowd_open(struct hash128 secret, struct crowd **out, struct err *e) ERR_USE;
void crowd_close(struct crowd **c);
/* The network that counts as the client at `a`: the /64. If more than CROWD_MOST /64s of a /56 ask
 * within CROWD_S, the /56 is one client. The same holds for more than CROWD_MOST /56s of a /48.
 * IPv4: the address. */
struct address crowd_client(struct crowd *c, struct address a, double now_s);

#endif
