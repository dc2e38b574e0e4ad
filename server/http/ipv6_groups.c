/* Networks that ask, with the last byte and the time of each smaller network in them. They are in a
 * table of sets of fixed size. A new network replaces the one in its set that asked longest ago.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/ipv6_groups.h"

#include <pthread.h>
#include <string.h>

enum { IPV6_GROUPS_SETS = 256, IPV6_GROUPS_WAYS = 4 };
enum {
    IPV6_GROUPS_SITE = 6,
    IPV6_GROUPS_HOME = 7,
    IPV6_GROUPS_NET = 8 /* bytes of /48, /56, /64 */
};

struct ipv6_groups_net {
    uint8_t prefix[IPV6_GROUPS_HOME], bytes; /* bytes 0: free */
    uint8_t part[IPV6_GROUPS_MOST];          /* the byte behind the prefix */
    double part_s[IPV6_GROUPS_MOST];         /* when it asked; 0: free */
    double joined_s;                         /* one client until then */
    double used_s;
};
struct ipv6_groups {
    pthread_mutex_t lock;
    struct hash128 secret;
    struct ipv6_groups_net net[IPV6_GROUPS_SETS][IPV6_GROUPS_WAYS];
};

enum err_code ipv6_groups_open(struct hash128 secret, struct ipv6_groups **out, struct err *e)
{
    *out = mem_array(1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "networks of clients: out of memory");
    (*out)->secret = secret;
    pthread_mutex_init(&(*out)->lock, NULL);
    return ERR_OK;
}

void ipv6_groups_close(struct ipv6_groups **c)
{
    if (*c)
        pthread_mutex_destroy(&(*c)->lock);
    mem_free(*c);
    *c = NULL;
}

/* The entry of a's network of so many bytes, a new one if there is none. */
static struct ipv6_groups_net *ipv6_groups_find(struct ipv6_groups *c, const struct address *a,
                                                uint8_t bytes)
{
    struct { /* no padding */
        struct hash128 secret;
        uint8_t prefix[IPV6_GROUPS_HOME], bytes;
    } name = {.secret = c->secret, .bytes = bytes};
    memcpy(name.prefix, a->ip, bytes);
    struct ipv6_groups_net *set = c->net[hash_bytes(&name, sizeof name).lo % IPV6_GROUPS_SETS],
                           *oldest = set;
    for (int i = 0; i < IPV6_GROUPS_WAYS; i++) {
        if (set[i].bytes == bytes && !memcmp(set[i].prefix, a->ip, bytes))
            return &set[i];
        if (set[i].used_s < oldest->used_s)
            oldest = &set[i];
    }
    *oldest = (struct ipv6_groups_net){.bytes = bytes};
    memcpy(oldest->prefix, a->ip, bytes);
    return oldest;
}

/* By the lock: whether a's network of so many bytes is one client, now that a asks. */
static bool ipv6_groups_joined(struct ipv6_groups *c, const struct address *a, uint8_t bytes,
                               double now_s)
{
    struct ipv6_groups_net *n = ipv6_groups_find(c, a, bytes);
    int place = -1;
    n->used_s = now_s;
    for (int i = 0; i < IPV6_GROUPS_MOST; i++) {
        const bool live = n->part_s[i] > 0 && now_s - n->part_s[i] < IPV6_GROUPS_S;
        if (live && n->part[i] == a->ip[bytes]) {
            place = i;
            break;
        }
        if (!live)
            place = i;
    }
    if (place < 0) {
        n->joined_s = now_s + IPV6_GROUPS_S;
    } else {
        n->part[place] = a->ip[bytes];
        n->part_s[place] = now_s;
    }
    return now_s < n->joined_s;
}

struct address ipv6_groups_client(struct ipv6_groups *c, struct address a, double now_s)
{
    if (address_is_v4(a))
        return a;
    pthread_mutex_lock(&c->lock);
    const size_t keep = ipv6_groups_joined(c, &a, IPV6_GROUPS_SITE, now_s)   ? IPV6_GROUPS_SITE
                        : ipv6_groups_joined(c, &a, IPV6_GROUPS_HOME, now_s) ? IPV6_GROUPS_HOME
                                                                             : IPV6_GROUPS_NET;
    pthread_mutex_unlock(&c->lock);
    memset(a.ip + keep, 0, sizeof a.ip - keep);
    return a;
}
