/* Addresses of clients. Anybody can write X-Forwarded-For. It is used only if the proxy that sent
 * it is trusted, and from its end, because a proxy appends.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/address.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "server/base/text.h"

static const uint8_t address_v4_prefix[12] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};

static struct address address_of_v4(const void *four)
{
    struct address a;
    memcpy(a.ip, address_v4_prefix, 12);
    memcpy(a.ip + 12, four, 4);
    return a;
}

bool address_is_v4(struct address a)
{
    return !memcmp(a.ip, address_v4_prefix, 12);
}

struct address address_of_socket(const struct sockaddr *s)
{
    struct address a = {0};
    if (s && s->sa_family == AF_INET)
        a = address_of_v4(&((const struct sockaddr_in *)(const void *)s)->sin_addr);
    else if (s && s->sa_family == AF_INET6)
        memcpy(a.ip, &((const struct sockaddr_in6 *)(const void *)s)->sin6_addr, 16);
    return a;
}

static bool address_parse_bare(const char *text, size_t n, struct address *out)
{
    char plain[INET6_ADDRSTRLEN + 1];
    struct in_addr v4;
    if (n >= sizeof plain)
        return false;
    memcpy(plain, text, n);
    plain[n] = '\0';
    if (inet_pton(AF_INET, plain, &v4) != 1)
        return inet_pton(AF_INET6, plain, out->ip) == 1;
    *out = address_of_v4(&v4);
    return true;
}

bool address_parse(const char *text, size_t n, struct address *out)
{
    const char *close = n && *text == '[' ? memchr(text, ']', n) : NULL;
    if (close)
        return address_parse_bare(text + 1, (size_t)(close - text) - 1, out);
    const char *colon = memchr(text, ':', n);
    bool port = colon && !memchr(colon + 1, ':', (size_t)(text + n - colon) - 1);
    return address_parse_bare(text, port ? (size_t)(colon - text) : n, out);
}

/* One "ADDRESS" or "ADDRESS/BITS". */
static bool address_read_net(const char *text, size_t n, struct address_nets *out)
{
    const char *slash = memchr(text, '/', n);
    size_t n_address = slash ? (size_t)(slash - text) : n;
    struct address a;
    if (out->n == ADDRESS_NETS || !address_parse_bare(text, n_address, &a))
        return false;
    unsigned most = address_is_v4(a) ? 32 : 128, bits = most;
    if (slash) {
        char *end;
        unsigned long v = strtoul(slash + 1, &end, 10);
        if (end != text + n || end == slash + 1 || slash[1] < '0' || slash[1] > '9' || v > most)
            return false;
        bits = (unsigned)v;
    }
    out->net[out->n].base = a;
    out->net[out->n++].bits = bits + 128 - most;
    return true;
}

enum err_code address_read_nets(const char *list, struct address_nets *out, struct err *e)
{
    *out = (struct address_nets){0};
    for (const char *p = list ? list : ""; *p;) {
        size_t n = strcspn(p, ", ");
        if (n && !address_read_net(p, n, out))
            return err_set(e, ERR_ARG,
                           "--trusted-proxy %s: not a list of at most %d addresses or networks "
                           "(127.0.0.1,10.0.0.0/8,fd00::/8)",
                           list, ADDRESS_NETS);
        p += n + (p[n] != '\0');
    }
    return ERR_OK;
}

bool address_in(const struct address_nets *nets, struct address a)
{
    for (size_t i = 0; i < nets->n; i++) {
        unsigned whole = nets->net[i].bits / 8, rest = nets->net[i].bits % 8;
        const uint8_t *base = nets->net[i].base.ip;
        if (!memcmp(base, a.ip, whole) &&
            (!rest || ((base[whole] ^ a.ip[whole]) & (0xff << (8 - rest)) & 0xff) == 0))
            return true;
    }
    return false;
}

bool address_is_loopback(struct address a)
{
    static const struct address one = {.ip = {[15] = 1}};
    return address_is_v4(a) ? a.ip[12] == 127 : !memcmp(&a, &one, sizeof one);
}

/* From peer, a trusted proxy, along one field to the first address that is none. False: nobody can
 * tell who comes before peer. */
static bool address_follow(const struct address_nets *trusted, const char *forwarded,
                           struct address *peer)
{
    for (size_t end = strlen(forwarded); end;) {
        size_t at = end;
        while (at && forwarded[at - 1] != ',')
            at--;
        size_t from = at, to = end;
        while (from < to && (forwarded[from] == ' ' || forwarded[from] == '\t'))
            from++;
        while (to > from && (forwarded[to - 1] == ' ' || forwarded[to - 1] == '\t'))
            to--;
        struct address a;
        if (!address_parse(forwarded + from, to - from, &a))
            return false; /* nobody can tell who that is: the one who passed it on */
        *peer = a;
        if (!address_in(trusted, a))
            break;
        end = at ? at - 1 : 0;
    }
    return true;
}

struct address address_client(const struct address_nets *trusted, struct address peer,
                              const char *const *forwarded, size_t n)
{
    while (n && address_in(trusted, peer) && address_follow(trusted, forwarded[n - 1], &peer))
        n--;
    return peer;
}

uint64_t address_number(struct address a, struct hash128 secret)
{
    struct { /* no padding */
        struct hash128 secret;
        struct address a;
    } name = {secret, a};
    if (!address_is_v4(a))
        memset(name.a.ip + 8, 0, 8);
    return hash_bytes(&name, sizeof name).lo;
}

bool address_host_is_loopback(const char *host)
{
    struct address a;
    if (!host)
        return false;
    size_t n = strcspn(host, ":");
    if (n == strlen("localhost") && !strncasecmp(host, "localhost", n))
        return true;
    if (*host != '[' && *host != ':' && (*host < '0' || *host > '9'))
        return false; /* a name */
    return address_parse(host, strlen(host), &a) && address_is_loopback(a);
}

void address_write(struct address a, char *out, size_t room)
{
    static const struct address none;
    char v4[ADDRESS_TEXT], *p = v4;
    for (int i = 12; i < 16; i++) { /* inet_ntop does it by printf, once a line of the log */
        p = text_put_uint(p, a.ip[i]);
        *p++ = i < 15 ? '.' : '\0';
    }
    if (address_is_v4(a) && (size_t)(p - v4) <= room)
        memcpy(out, v4, (size_t)(p - v4));
    else if (!memcmp(&a, &none, sizeof a) || !inet_ntop(AF_INET6, a.ip, out, (socklen_t)room))
        snprintf(out, room, "-");
}

struct address address_network(struct address a)
{
    size_t keep = address_is_v4(a) ? 15 : 6;
    memset(a.ip + keep, 0, sizeof a.ip - keep);
    return a;
}
