/* See origin.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/origin.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "server/base/address.h"

static bool origin_is_told(const struct services *s)
{
    return s->cfg->public_url && *s->cfg->public_url;
}

const char *origin_vary(const struct services *s, enum origin_vary also)
{
    static const char *const host[] =
        {"Host, X-Forwarded-Host, X-Forwarded-Proto",
         "Accept-Encoding, Host, X-Forwarded-Host, X-Forwarded-Proto",
         "Accept, Accept-Encoding, Host, X-Forwarded-Host, X-Forwarded-Proto"},
                             *const told[] = {NULL, "Accept-Encoding", "Accept, Accept-Encoding"};
    return origin_is_told(s) ? told[also] : host[also];
}

/* A name or an address, and a port: nothing that could end the address or be markup. */
static bool origin_is_host(const char *host)
{
    static const char plain[] =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_:[]";
    const size_t n = host ? strlen(host) : 0;
    return n && n < 256 && strspn(host, plain) == n;
}

static const char *origin_host(const struct request *r)
{
    return r->trusted && r->forwarded_host ? r->forwarded_host : r->host;
}

static bool origin_begins_with_https(const char *url)
{
    return !strncasecmp(url, "https:", strlen("https:"));
}

bool origin_is_tls(const struct services *s, const struct request *r)
{
    if (origin_is_told(s))
        return origin_begins_with_https(s->cfg->public_url);
    if (r->trusted && r->forwarded_proto)
        return !strcasecmp(r->forwarded_proto, "https");
    return s->tls && !r->admin;
}

/* Is `host` [n] what stands in --public-url before its path ("/"), or its port (":/")? */
static bool origin_is_public_host(const struct services *s, const char *host, size_t n,
                                  const char *before)
{
    const char *url = origin_is_told(s) ? strstr(s->cfg->public_url, "://") : NULL;
    return url && n && strcspn(url + 3, before) == n && !strncasecmp(host, url + 3, n);
}

bool origin_is_own_page(const struct services *s, const struct request *r)
{
    const char *host = r->origin ? strstr(r->origin, "://") : NULL, *own = origin_host(r);
    if (!r->from_page)
        return true;
    if (!host)
        return false;
    host += 3;
    return origin_is_told(s) ? origin_is_public_host(s, host, strlen(host), "/")
                             : own && !strcasecmp(host, own);
}

bool origin_is_operators(const struct services *s, const struct request *r)
{
    char name[256] = "";
    struct address a;
    const char *host = r->host;
    if (!host) /* HTTP/1.0, which no browser speaks */
        return true;
    const size_t n = strcspn(host, ":");
    if (address_host_is_loopback(host) || address_parse(host, strlen(host), &a))
        return true;
    if (origin_is_public_host(s, host, n, ":/"))
        return true;
    if (gethostname(name, sizeof name - 1))
        return false;
    return n && !strncasecmp(host, name, n) && (!name[n] || name[n] == '.');
}

/* What stands before the path of a signed address, behind `base` without its slash. "" where it
 * does not fit. */
static const char *origin_below(const char *base, const struct request *r, char out[ORIGIN_MAX])
{
    size_t n = strlen(base);
    while (n && base[n - 1] == '/')
        n--;
    if (snprintf(out, ORIGIN_MAX, "%.*s%.*s", (int)n, base, (int)r->n_prefix,
                 r->prefix ? r->prefix : "") >= ORIGIN_MAX)
        out[0] = '\0';
    return out;
}

const char *origin_of(const struct services *s, const struct request *r, char out[ORIGIN_MAX])
{
    char base[ORIGIN_MAX];
    out[0] = '\0';
    if (origin_is_told(s))
        return origin_below(s->cfg->public_url, r, out);
    if (r->proxied && !r->trusted)
        return out;
    if (origin_is_host(origin_host(r)) &&
        snprintf(base, sizeof base, "%s://%s%s", origin_is_tls(s, r) ? "https" : "http",
                 origin_host(r), s->cfg->base_path ? s->cfg->base_path : "") < ORIGIN_MAX)
        return origin_below(base, r, out);
    return out;
}

const char *origin_or_own(const struct services *s, const struct request *r, char out[ORIGIN_MAX])
{
    if (!*origin_of(s, r, out) && s->url)
        return origin_below(s->url, r, out);
    return out;
}

void origin_read(const struct services *s, const struct request *r, struct origin_places *out)
{
    const char *url = s->cfg->public_url, *base = s->cfg->base_path;
    out->public_url = url && *url ? origin_below(url, r, out->text[0]) : NULL;
    out->base_path = origin_below(base ? base : "", r, out->text[1]);
}
