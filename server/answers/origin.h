/* The address of the service as a client sees it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ORIGIN_H
#define SERVER_ORIGIN_H

#include "server/answers/response.h"

enum { ORIGIN_MAX = 1024 };
/* Vary for answers that depend on origin_of and on what `also` names. With --public-url no answer
 * depends on the Host that a client sends. NULL: it depends on nothing. */
enum origin_vary { ORIGIN_ALONE, ORIGIN_ENCODED, ORIGIN_ACCEPTED };
const char *origin_vary(const struct services *s, enum origin_vary also);
/* Writes the origin: --public-url, else "https://HOST/BASE" from the request, and behind it the
 * prefix of a signed address. The request gives Host and the listener's scheme; behind a trusted
 * proxy (--trusted-proxy) it gives X-Forwarded-Host and X-Forwarded-Proto if the proxy sends them.
 * "": not known, because Host is no valid name, or an untrusted proxy, which may have another name,
 * is in between. */
const char *origin_of(const struct services *s, const struct request *r, char out[ORIGIN_MAX]);
/* As origin_of. If the origin is not known: the address on which the server listens, if it is a
 * single one. */
const char *origin_or_own(const struct services *s, const struct request *r, char out[ORIGIN_MAX]);
/* Returns whether clients reach the service by TLS, as far as it is known. */
bool origin_is_tls(const struct services *s, const struct request *r);
/* Returns whether the page that made the request belongs to the service itself: its Origin is that
 * of --public-url, or, without that option, of the request's host name. True if no page made it. */
bool origin_is_own_page(const struct services *s, const struct request *r);
/* Returns whether the request names the operators' listener by a name that no outsider can point at
 * its address: a loopback name, an IP address, the host of --public-url, or the name of this
 * machine. A page whose own name leads to this machine (DNS rebinding) names itself. */
bool origin_is_operators(const struct services *s, const struct request *r);

/* --public-url and --base-path, each followed by the prefix of a signed address. */
struct origin_places {
    const char *public_url, *base_path; /* NULL: none */
    char text[2][ORIGIN_MAX];
};
void origin_read(const struct services *s, const struct request *r, struct origin_places *out);

#endif
