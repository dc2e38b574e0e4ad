/* The header fields of a response. Any page may read every answer (RFC 9110; CORS as in the Fetch
 * standard). This is safe for two reasons. Answers for this machine alone are not sent to requests
 * with an Origin, which pages of other sites send (request_guard_alone). Answers that need a token
 * are sent only to its holders.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/headers.h"

#include <stdio.h>
#include <string.h>

#include "server/base/condition.h"

static void headers_add(struct headers *h, const char *name, const char *value)
{
    if (!name || !value || !*value || h->n == HEADERS_MAX)
        return;
    h->field[h->n].name = name;
    h->field[h->n++].value = value;
}

/* Of the server's own cache (RFC 9211). */
static const char *headers_cache_status(const struct response *r)
{
    if (!r->cache || r->status >= 400)
        return NULL;
    return !strcmp(r->cache, "hit")      ? "citysplat; hit"
           : !strcmp(r->cache, "miss")   ? "citysplat; fwd=miss; stored"
           : !strcmp(r->cache, "shared") ? "citysplat; fwd=miss; collapsed"
                                         : "citysplat; fwd=bypass";
}

static void headers_add_numbers(const struct response *r, struct headers *h)
{
    if (r->status == 206)
        snprintf(
            h->range, sizeof h->range, "bytes %llu-%llu/%llu", (unsigned long long)r->range_first,
            (unsigned long long)(r->range_first + r->size - 1), (unsigned long long)r->range_total);
    else if (r->status == 416)
        snprintf(h->range, sizeof h->range, "bytes */%llu", (unsigned long long)r->range_total);
    if (r->retry_after_s)
        snprintf(h->retry, sizeof h->retry, "%d", r->retry_after_s);
    if (r->queue_s >= 0)
        snprintf(h->timing, sizeof h->timing, "queue;dur=%.1f, job;dur=%.1f", r->queue_s * 1e3,
                 r->run_s * 1e3);
    headers_add(h, "Content-Range", h->range);
    headers_add(h, "Retry-After", h->retry);
    headers_add(h, "Server-Timing", h->timing);
}

bool headers_repeat_id(const struct response *r)
{
    return r->id_sent && (!r->cache_control || strstr(r->cache_control, "no-store"));
}

void headers_make(const struct response *r, bool last, struct headers *h)
{
    const bool known =
        r->status == 304; /* the client has what describes the bytes (RFC 9110, 15.4.5) */
    h->n = 0;
    h->range[0] = h->retry[0] = h->timing[0] = '\0';
    headers_add(h, "Content-Type", known ? NULL : r->type);
    headers_add(h, "Cache-Control", r->cache_control);
    headers_add(h, "ETag", r->etag);
    if (r->modified_s) {
        condition_date(r->modified_s, h->modified);
        headers_add(h, "Last-Modified", h->modified);
    }
    headers_add(h, "Vary", r->vary);
    headers_add(h, "Content-Encoding", known ? NULL : r->encoding);
    headers_add(h, "Allow", r->allow);
    headers_add(h, "Location", r->location);
    headers_add(h, "Set-Cookie", r->set_cookie);
    headers_add(h, "Link", known ? NULL : r->hints);
    headers_add(h, r->tag_header, r->surrogate);
    headers_add(h, "Cache-Status", headers_cache_status(r));
    if (r->id && (r->id_sent ? headers_repeat_id(r) : r->status >= 400))
        headers_add(h, "X-Request-Id", r->id);
    if (r->unauthorized)
        headers_add(h, "WWW-Authenticate", "Bearer");
    if (r->accept_ranges && !known)
        headers_add(h, "Accept-Ranges", "bytes");
    headers_add_numbers(r, h);
    if (r->stream[0]) /* nginx would gather pictures until its buffer is full */
        headers_add(h, "X-Accel-Buffering", "no");
    if (!r->same_origin)
        headers_add(h, "Access-Control-Allow-Origin", "*");
    if (!known)
        headers_add(h, "X-Content-Type-Options", "nosniff");
    if (r->secret)
        headers_add(h, "Referrer-Policy", "strict-origin");
    if (r->same_origin) { /* what operators ask is for no page */
        headers_add(h, "Cross-Origin-Resource-Policy", "same-origin");
    } else if (r->allow && r->status == 204) { /* preflight */
        headers_add(h, "Access-Control-Allow-Methods", r->allow);
        headers_add(h, "Access-Control-Allow-Headers",
                    "Range, If-Match, If-None-Match, If-Range, Content-Type, Authorization");
        headers_add(h, "Access-Control-Max-Age", "86400");
    } else {
        headers_add(h, "Access-Control-Expose-Headers",
                    known ? NULL
                          : "ETag, Content-Length, Content-Range, Link, Location, Retry-After, "
                            "Server-Timing, X-Request-Id");
        headers_add(h, "Cross-Origin-Resource-Policy", "cross-origin");
        headers_add(h, "Timing-Allow-Origin", "*");
    }
    if (last)
        headers_add(h, "Connection", "close");
}
