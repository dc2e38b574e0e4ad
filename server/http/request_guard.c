/* Refuses requests that libmicrohttpd 0.9.75 accepts and that a proxy in front could read
 * differently: both Content-Length and Transfer-Encoding, or two of one; a transfer coding other
 * than chunked; two Hosts; control bytes; targets that are not a path; unknown methods. Such a
 * request gets a 4xx or 501, and the connection is closed (RFC 9112, sections 3.2, 6.1, 6.3, 11.2).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/request_guard.h"

#include <string.h>
#include <strings.h>

#include "server/base/address.h"
#include "server/base/text.h"

static bool request_guard_name_is(const char *name, size_t n, const char *want)
{
    /* Every field is held against twenty names: nearly all differ in the first letter. */
    return n && (name[0] | 0x20) == (want[0] | 0x20) && n == strlen(want) &&
           !strncasecmp(name, want, n);
}

/* What RFC 3986 allows in a host and a port; it may be empty. */
static bool request_guard_is_host(const char *p)
{
    for (; *p; p++) /* strspn makes a table of its words each time */
        if (!((*p >= 'a' && *p <= 'z') || (*p >= '0' && *p <= ';') || (*p >= 'A' && *p <= 'Z') ||
              strchr("-._~!$&'()*+,=%[]", *p)))
            return false;
    return true;
}

static bool request_guard_clean_name(const char *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)p[i] <= 0x20 || (unsigned char)p[i] >= 0x7f || p[i] == ':')
            return false;
    return n > 0;
}

/* Digits only; false for anything else or beyond 2^53. */
static bool request_guard_read_length(const char *p, size_t n, uint64_t *out)
{
    uint64_t v = 0;
    for (size_t i = 0; i < n; i++) {
        if (p[i] < '0' || p[i] > '9' || v > (uint64_t)1 << 53)
            return false;
        v = v * 10 + (uint64_t)(p[i] - '0');
    }
    *out = v;
    return n > 0;
}

/* Priority: u=7 (RFC 9218) and Sec-Purpose: prefetch go behind everything else. */
static void request_guard_keep_field(struct request *r, const char *name, size_t n,
                                     const char *value)
{
    const struct {
        const char *name;
        const char **to;
    } kept[] = {
        {"Accept", &r->accept},
        {"Accept-Encoding", &r->accept_encoding},
        {"If-None-Match", &r->if_none_match},
        {"If-Match", &r->if_match},
        {"If-Range", &r->if_range},
        {"Range", &r->range},
        {"Authorization", &r->authorization},
        {"Cookie", &r->cookie},
        {"Origin", &r->origin},
        {"If-Modified-Since", &r->if_modified_since},
        {"If-Unmodified-Since", &r->if_unmodified_since},
        {"Referer", &r->referer},
        {"User-Agent", &r->agent},
        {"X-Request-Id", &r->id},
    };
    for (size_t i = 0; i < sizeof kept / sizeof *kept; i++)
        if (request_guard_name_is(name, n, kept[i].name) && !*kept[i].to)
            *kept[i].to = value;
    if ((request_guard_name_is(name, n, "Sec-Purpose") && strstr(value, "prefetch")) ||
        (request_guard_name_is(name, n, "Priority") &&
         (strstr(value, "u=6") || strstr(value, "u=7"))))
        r->prefetch = true;
}

/* Fields by which proxies say that they are there, and for whom. */
static bool request_guard_is_proxys(const char *name, size_t n)
{
    static const char *const names[] = {"Forwarded",        "Via",
                                        "X-Real-IP",        "X-Client-IP",
                                        "Client-IP",        "True-Client-IP",
                                        "CF-Connecting-IP", "X-Cluster-Client-IP"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (request_guard_name_is(name, n, names[i]))
            return true;
    return n > strlen("X-Forwarded") && !strncasecmp(name, "X-Forwarded", strlen("X-Forwarded"));
}

void request_guard_field(struct request_guard *f, const char *name, size_t n_name,
                         const char *value, size_t n_value)
{
    value = value ? value : "";
    f->n++;
    if (!request_guard_clean_name(name, n_name) || !text_is_clean(value, n_value))
        f->bad = true;
    if (request_guard_name_is(name, n_name, "Content-Length")) {
        f->n_length++;
        f->bad |= !request_guard_read_length(value, n_value, &f->length);
    } else if (request_guard_name_is(name, n_name, "Transfer-Encoding")) {
        f->n_coding++;
        f->coding_bad |= strcasecmp(value, "chunked") != 0;
    } else if (request_guard_name_is(name, n_name, "Host")) {
        f->n_host++;
        f->bad |= !request_guard_is_host(value);
        f->req->host = value;
    } else if (request_guard_is_proxys(name, n_name)) {
        f->req->proxied = true;
        if (request_guard_name_is(name, n_name, "X-Forwarded-Host"))
            f->req->forwarded_host = value;
        if (request_guard_name_is(name, n_name, "X-Forwarded-Proto"))
            f->req->forwarded_proto = value;
        if (request_guard_name_is(name, n_name, "X-Forwarded-For") &&
            f->req->n_forwarded < REQUEST_FIELDS_MAX)
            f->req->forwarded[f->req->n_forwarded++] = value;
    } else {
        f->has_origin |= request_guard_name_is(name, n_name, "Origin");
        f->req->from_page = f->has_origin;
        request_guard_keep_field(f->req, name, n_name, value);
    }
}

void request_guard_authority(struct request_guard *g, const char *authority)
{
    g->bad |= !request_guard_is_host(authority);
    g->req->host = authority;
}

const char *request_guard_method_name(enum method m)
{
    static const char *const names[] = {"GET",    "HEAD",    "POST",  "PUT",
                                        "DELETE", "OPTIONS", "OTHER", "UNKNOWN"};
    return names[m];
}

bool request_guard_alone(const struct request_guard *g, const char *version)
{
    return !g->req->proxied && !g->has_origin && strcmp(version, "HTTP/1.0") != 0;
}

enum method request_guard_method(const char *name)
{
    static const struct {
        const char *name;
        enum method method;
    } methods[] = {
        {"GET", METHOD_GET},         {"HEAD", METHOD_HEAD},   {"POST", METHOD_POST},
        {"OPTIONS", METHOD_OPTIONS}, {"PUT", METHOD_PUT},     {"DELETE", METHOD_DELETE},
        {"PATCH", METHOD_OTHER},     {"TRACE", METHOD_OTHER}, {"CONNECT", METHOD_OTHER},
    };
    for (size_t i = 0; i < sizeof methods / sizeof *methods; i++)
        if (!strcmp(name, methods[i].name))
            return methods[i].method;
    return METHOD_UNKNOWN;
}

int request_guard_check(const struct request_guard *f, const struct server_config *cfg,
                        const char *version, const char **why)
{
    const struct request *r = f->req;
    bool old = !strcmp(version, "HTTP/1.0");
    bool bodyless = r->method == METHOD_GET || r->method == METHOD_HEAD;
    *why = "the request is malformed";
    if (f->n > REQUEST_FIELDS_MAX)
        return *why = "the request has too many header fields", 431;
    if (!r->target || r->target_size > (size_t)cfg->max_target_bytes)
        return *why = "the request target is too long", 414;
    if (!old && !f->n_host && !f->bad)
        return *why = "a request of HTTP/1.1 needs the header field Host", 400;
    if (f->bad || f->n_length + f->n_coding > 1 || f->n_host > 1 || (old && f->n_coding) ||
        r->target[0] != '/')
        return 400;
    if (r->method == METHOD_UNKNOWN)
        return *why = "this server does not know the method", 501;
    if (f->coding_bad)
        return *why = "the only transfer coding is chunked", 501;
    if (bodyless && (f->n_coding || (f->n_length && f->length)))
        return *why = "a GET or HEAD has no body", 400;
    if (f->length > (uint64_t)cfg->max_body_kb << 10)
        return *why = "the body is too large", 413;
    return 0;
}
