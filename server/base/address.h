/* Addresses of clients, also of those behind a proxy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ADDRESS_H
#define SERVER_ADDRESS_H

#include "core/base.h"

struct sockaddr;

struct address { /* IPv4 as ::ffff:a.b.c.d; {0}: none */
    uint8_t ip[16];
};
enum { ADDRESS_NETS = 16, ADDRESS_TEXT = 48 };
struct address_nets { /* {0}: none */
    size_t n;
    struct {
        struct address base;
        unsigned bits; /* length of the prefix, at most 128 */
    } net[ADDRESS_NETS];
};

/* The address of a socket's other end. {0}: it is neither IPv4 nor IPv6. */
struct address address_of_socket(const struct sockaddr *a);
/* Parses text [n]: an address, also with a port as in X-Forwarded-For ("1.2.3.4:567", "[::1]:80").
 */
bool address_parse(const char *text, size_t n, struct address *out);
/* Parses "127.0.0.1,10.0.0.0/8,fd00::/8". NULL and "" give an empty list. ERR_ARG. */
enum err_code address_read_nets(const char *list, struct address_nets *out, struct err *e) ERR_USE;
bool address_in(const struct address_nets *nets, struct address a);
bool address_is_loopback(struct address a);
bool address_is_v4(struct address a);
/* The client of a request that came from `peer`. If peer is a trusted proxy, it is the last address
 * of X-Forwarded-For that is not a trusted proxy; else it is peer. forwarded [n]: the values of all
 * fields of that name, in order; they form one list (RFC 9110, section 5.3). */
struct address address_client(const struct address_nets *trusted, struct address peer,
                              const char *const *forwarded, size_t n);
/* A number for a client. For IPv6 it is that of the /64, which one household owns. The secret
 * prevents attackers from choosing two addresses with the same number. */
uint64_t address_number(struct address a, struct hash128 secret);
/* Writes "1.2.3.4" or "2001:db8::1"; "-": none. */
void address_write(struct address a, char *out, size_t room);
/* The network of an address: /24 of IPv4, /48 of IPv6. */
struct address address_network(struct address a);
/* Returns whether this value of Host names this machine: localhost, 127.x or [::1], with or without
 * a port. NULL: false. */
bool address_host_is_loopback(const char *host);

#endif
