/* Who asks: addresses of clients, also of those behind a proxy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ADDRESS_H
#define SERVER_ADDRESS_H

#include "core/base.h"

struct sockaddr;

struct address { /* IPv4 as ::ffff:a.b.c.d; {0} is none */
    uint8_t ip[16];
};
enum { ADDRESS_NETS = 16, ADDRESS_TEXT = 48 };
struct address_nets { /* {0}: none */
    size_t n;
    struct {
        struct address base;
        unsigned bits; /* of 128 */
    } net[ADDRESS_NETS];
};

/* Of a socket's other end; {0} for anything but IPv4 and IPv6. */
struct address address_of_socket(const struct sockaddr *a);
/* Read text[n]: an address, as X-Forwarded-For writes it too ("1.2.3.4:567", "[::1]:80"). */
bool address_parse(const char *text, size_t n, struct address *out);
/* Read "127.0.0.1,10.0.0.0/8,fd00::/8". NULL and "" are none. ERR_ARG. */
enum err_code address_read_nets(const char *list, struct address_nets *out, struct err *e) ERR_USE;
bool address_in(const struct address_nets *nets, struct address a);
bool address_is_loopback(struct address a);
/* The client that `peer` asks for: the last address of X-Forwarded-For that is not a trusted proxy
 * itself, if peer is one; else peer. forwarded [n]: the values of all fields of that name in their
 * order, which are one list (RFC 9110, section 5.3). */
struct address address_client(const struct address_nets *trusted, struct address peer,
                              const char *const *forwarded, size_t n);
/* A number for a client: of an IPv6 address its /64, which one household has for itself. The secret
 * keeps strangers from choosing two addresses of one number. */
uint64_t address_number(struct address a, struct hash128 secret);
/* "1.2.3.4" or "2001:db8::1"; "-" for none. */
void address_write(struct address a, char *out, size_t room);
/* Its network alone: /24 of IPv4, /48 of IPv6. */
struct address address_network(struct address a);
/* Is this value of Host a name of this machine's own: localhost, 127.x, [::1], with or without a
 * port? NULL is none. */
bool address_host_is_loopback(const char *host);

#endif
