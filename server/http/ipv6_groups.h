/* Clients of IPv6. A household has a /64, but whoever has a /56 or a /48 has thousands of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_IPV6_GROUPS_H
#define SERVER_IPV6_GROUPS_H

#include "server/base/address.h"

struct ipv6_groups; /* thread-safe */

enum { IPV6_GROUPS_MOST = 8 /* most parts of a network that are clients of their own at a time */ };
enum { IPV6_GROUPS_S = 60 /* how long a part counts after its last request */ };

/* secret: attackers who do not know it cannot choose networks that share a place in the table.
 * ERR_MEM. */
enum err_code ipv6_groups_open(struct hash128 secret, struct ipv6_groups **out,
                               struct err *e) ERR_USE;
void ipv6_groups_close(struct ipv6_groups **c);
/* The network that counts as the client at `a`: the /64. If more than IPV6_GROUPS_MOST /64s of a
 * /56 ask within IPV6_GROUPS_S, the /56 is one client. The same holds for more than
 * IPV6_GROUPS_MOST /56s of a /48. IPv4: the address. */
struct address ipv6_groups_client(struct ipv6_groups *c, struct address a, double now_s);

#endif
