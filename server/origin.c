/* See origin.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/origin.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

const char ORIGIN_VARY[] = "Host, X-Forwarded-Host, X-Forwarded-Proto",
           ORIGIN_VARY_ENCODED[] = "Accept-Encoding, Host, X-Forwarded-Host, X-Forwarded-Proto";

/* A name or an address, and a port: nothing that could end the address or be markup. */
static bool origin_is_host(const char *host)
{
    static const char plain[] =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_:[]";
    const size_t n = host ? strlen(host) : 0;
    return n && n < 256 && strspn(host, plain) == n;
}

const char *origin_of(const struct services *s, const struct request *r, char out[ORIGIN_MAX])
{
    const char *scheme = s->tls && !r->admin ? "https" : "http", *host = r->host;
    const char *base = s->cfg->base_path ? s->cfg->base_path : "";
    out[0] = '\0';
    if (s->cfg->public_url && *s->cfg->public_url)
        return s->cfg->public_url;
    if (r->proxied && !r->trusted)
        return out;
    if (r->trusted && r->forwarded_host)
        host = r->forwarded_host;
    if (r->trusted && r->forwarded_proto)
        scheme = !strcasecmp(r->forwarded_proto, "https") ? "https" : "http";
    if (origin_is_host(host) &&
        snprintf(out, ORIGIN_MAX, "%s://%s%s", scheme, host, base) >= ORIGIN_MAX)
        out[0] = '\0';
    return out;
}
