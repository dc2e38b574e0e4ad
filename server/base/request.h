/* A request, as the guard leaves it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_REQUEST_H
#define SERVER_REQUEST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct auth;

enum method {
    METHOD_GET,
    METHOD_HEAD,
    METHOD_POST,
    METHOD_PUT,
    METHOD_DELETE,
    METHOD_OPTIONS,
    METHOD_OTHER,
    METHOD_UNKNOWN
};
enum { REQUEST_FIELDS_MAX = 64 }; /* requests with more are refused */
struct request {                  /* borrowed from the connection */
    enum method method;
    const char *target; /* as sent */
    size_t target_size;
    /* NULL: absent */
    const char *accept, *accept_encoding, *if_none_match, *if_match, *if_range, *range;
    const char *authorization, *cookie, *origin;
    const char *forwarded[REQUEST_FIELDS_MAX]; /* [n_forwarded], X-Forwarded-For */
    size_t n_forwarded;
    const char *host, *forwarded_host, *forwarded_proto; /* NULL: absent */
    bool proxied;                                        /* a proxy announced itself */
    bool trusted;                /* the connection comes from a trusted proxy */
    const char *referer, *agent; /* for the log */
    const char *id;              /* id of the request; NULL: none */
    bool id_sent;                /* the client or a proxy sent the id, so the answer repeats it */
    uint64_t client;             /* number of who asks, of a POST alone: address_number */
    bool admin;                  /* it came to the listener for operators */
    const char *if_modified_since, *if_unmodified_since;
    const void *body;
    size_t body_size;
    bool prefetch;     /* Sec-Purpose: prefetch, or a low Priority */
    bool from_page;    /* it has Origin: a page of some site made it */
    struct auth *auth; /* as it is while this request is answered; NULL: all is public */
    /* of a signed address: its seal [n_seal], and all that stands before the path [n_prefix]; NULL:
     * none. target is without this prefix. */
    const char *seal, *prefix;
    size_t n_seal, n_prefix;
    /* Host, if the client is this machine and nothing indicates another client behind it. That it
     * names this machine is for who asks to check (address_host_is_loopback): few do. */
    const char *own_host;
};

#endif
