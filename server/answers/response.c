/* Puts bytes into an answer. Conditions are decided before bodies are read: the entity tag of a
 * result is its name (result_id.c), so a 304 needs no reading and no encoding. RFC 9110, 9111,
 * 9457.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/response.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/store/key.h"
#include "server/base/condition.h"
#include "server/base/text.h"
#include "server/drawing/picture_id.h"

const char RESPONSE_IMMUTABLE[] = "public, max-age=31536000, immutable";
const char RESPONSE_MOVING[] =
    "public, max-age=60, stale-while-revalidate=600, stale-if-error=86400";
const char RESPONSE_NO_STORE[] = "no-store";
const char RESPONSE_JSON[] = "application/json";
const char RESPONSE_SHORT[] = "public, max-age=60";

void response_edition(struct services *s, const struct dataset *d, enum edition of, char out[9])
{
    char device[160];
    out[0] = '\0';
    if (of == EDITION_TILES) {
        memcpy(out, d->edition, sizeof d->edition);
    } else if (s->picture && picture_state(s->picture) == PICTURE_READY) {
        picture_about(s->picture, device, sizeof device);
        picture_id_edition(d, device, (int)s->cfg->quality, (int)s->cfg->supersample,
                           (double)s->cfg->view_gaussians, out);
    }
}

const char *response_cache_control(struct services *s, const struct dataset *d,
                                   const struct target *t)
{
    const enum route_cache cache = t->route->cache;
    char edition[9];
    if (cache == CACHE_NONE || cache == CACHE_MOVING)
        return cache == CACHE_NONE ? RESPONSE_NO_STORE : RESPONSE_MOVING;
    if (cache == CACHE_STORE)
        return RESPONSE_IMMUTABLE;
    response_edition(s, d, cache == CACHE_TILES ? EDITION_TILES : EDITION_PICTURES, edition);
    /* A name may stand for something else tomorrow. */
    return edition[0] && !t->names.kept[0] && !strcmp(edition, t->names.edition)
               ? RESPONSE_IMMUTABLE
               : RESPONSE_MOVING;
}

const char *response_status_text(int status)
{
    static const struct {
        int status;
        const char *text;
    } texts[] = {
        {200, "OK"},
        {201, "Created"},
        {204, "No Content"},
        {206, "Partial Content"},
        {303, "See Other"},
        {304, "Not Modified"},
        {307, "Temporary Redirect"},
        {308, "Permanent Redirect"},
        {400, "Bad Request"},
        {401, "Unauthorized"},
        {403, "Forbidden"},
        {404, "Not Found"},
        {405, "Method Not Allowed"},
        {409, "Conflict"},
        {412, "Precondition Failed"},
        {413, "Content Too Large"},
        {414, "URI Too Long"},
        {416, "Range Not Satisfiable"},
        {422, "Unprocessable Content"},
        {429, "Too Many Requests"},
        {431, "Request Header Fields Too Large"},
        {500, "Internal Server Error"},
        {501, "Not Implemented"},
        {503, "Service Unavailable"},
        {504, "Gateway Timeout"},
        {507, "Insufficient Storage"},
    };
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        if (texts[i].status == status)
            return texts[i].text;
    return "Error";
}

void response_free(struct response *r)
{
    body_drop(&r->body);
    mem_free(r->location);
    mem_free(r->set_cookie);
    r->location = r->set_cookie = NULL;
    if (r->work)
        work_drop(NULL, r->work);
    r->work = NULL;
}

/* ---- problems ---- */

/* members: JSON that goes before the end, beginning with a comma. */
static void response_send_problem(struct response *out, int status, const char *detail,
                                  const char *members)
{
    const bool kept = status == 404 && !out->unauthorized;
    struct buf b = {0};
    response_free(out);
    buf_printf(&b, "{\"type\":\"about:blank\",\"title\":\"%s\",\"status\":%d,\"detail\":\"",
               response_status_text(status), status);
    bool utf8 = text_is_utf8(detail); /* a message may be cut within a letter */
    for (const char *p = detail; *p; p++)
        if ((unsigned char)*p >= 0x20)
            buf_printf(&b, *p == '"' || *p == '\\' ? "\\%c" : "%c",
                       utf8 || (unsigned char)*p < 0x80 ? *p : '?');
    buf_printf(&b, "\"%s", members);
    if (out->instance) /* it holds no byte that JSON would have to escape */
        buf_printf(&b, ",\"instance\":\"%.*s\"", (int)out->n_instance, out->instance);
    if (out->id && !(kept && out->id_sent)) /* others would get the id of this client */
        buf_printf(&b, ",\"request_id\":\"%s\"", out->id);
    buf_printf(&b, "}\n");
    out->status = status;
    out->type = "application/problem+json";
    out->cache_control = !kept                ? RESPONSE_NO_STORE
                         : out->cache_missing ? out->cache_missing
                                              : RESPONSE_SHORT;
    out->vary = "Accept"; /* to who opens it in a browser it is a page (dispatch.c) */
    out->encoding = NULL;
    out->etag[0] = out->surrogate[0] = out->hints[0] = 0;
    out->modified_s = 0;
    out->accept_ranges = false;
    out->retry_after_s = 0;
    out->body = body_take(&b, NULL);
    out->data = out->body ? out->body->data : NULL;
    out->size = out->body ? out->body->size : 0;
}

void response_problem(struct response *out, int status, const char *detail)
{
    response_send_problem(out, status, detail, "");
}

/* A tile that cannot be made. The client learns which and what to do; where the file is and what
 * its hashes are is in the log. */
void response_tile_problem(struct response *out, bool damaged)
{
    char members[160], text[400];
    const struct key k = out->tile;
    snprintf(members, sizeof members, ",\"dataset\":\"%s\",\"tile\":{\"z\":%u,\"x\":%u,\"y\":%u}",
             out->tile_of, k.z, k.x, k.y);
    snprintf(
        text, sizeof text,
        damaged ? "tile %u/%u/%u of dataset %s is damaged: its bytes do not have the hash that the "
                  "index says, so none of them are sent; all other tiles are served. Whoever runs "
                  "this server finds the file in its log, checks it with citysplat verify, and "
                  "restores it or tiles the scene again"
                : "tile %u/%u/%u of dataset %s could not be made; the server's log says why",
        k.z, k.x, k.y, out->tile_of);
    response_send_problem(out, 500, text, members);
}

void response_no_memory(struct response *out)
{
    response_problem(out, 503, "out of memory");
    out->retry_after_s = 5;
}

void response_refused(struct response *out, enum err_code rc, const char *detail)
{
    response_problem(out,
                     rc == ERR_MEM     ? 503
                     : rc == ERR_NOENT ? 404
                     : rc == ERR_DATA  ? 422
                                       : 400,
                     detail);
}

/* ---- bytes ---- */

/* "tag" -> "tag-gz": another coding of a resource is another representation. */
static void response_etag_coding(char *etag, const char suffix[static 5])
{
    size_t n = strlen(etag);
    if (n >= 2 && n + 3 < BODY_ETAG_SIZE)
        memcpy(etag + n - 1, suffix, 5);
}

/* The coding of b that the client likes best. */
static void response_encode(const struct request *r, const struct body *b, struct response *out)
{
    if (!b->coded)
        return;
    out->vary = out->vary ? "Accept, Accept-Encoding" : "Accept-Encoding";
    if (b->brotli && condition_brotli(r->accept_encoding)) {
        out->encoding = "br";
        out->data = b->brotli;
        out->size = b->brotli_size;
        response_etag_coding(out->etag, "-br\"");
    } else if (b->gzip && condition_gzip(r->accept_encoding)) {
        out->encoding = "gzip";
        out->data = b->gzip;
        out->size = b->gzip_size;
        response_etag_coding(out->etag, "-gz\"");
    }
}

static bool response_wants_range(const struct request *r, const struct response *out)
{
    return r->method == METHOD_GET && r->range && out->accept_ranges &&
           (!r->if_range || !strcmp(r->if_range, out->etag));
}

/* 200, 206, 304 or 416 with `b`, whose reference is taken. type and cache_control are set already.
 */
void response_body(const struct request *r, struct body *b, struct response *out)
{
    if (!b) {
        response_no_memory(out);
        return;
    }
    body_drop(&out->body);
    out->body = b;
    out->status = 200;
    out->data = b->data;
    out->size = b->size;
    memcpy(out->etag, b->etag, BODY_ETAG_SIZE);
    out->accept_ranges = !b->coded;
    response_encode(r, b, out);
    out->modified_s = b->modified_s;
    bool read = r->method == METHOD_GET || r->method == METHOD_HEAD;
    if (read && !condition_may_write(r->if_match, NULL, out->etag)) {
        response_problem(out, 412, "the resource has another entity tag than If-Match says");
        return;
    }
    if (read && !r->if_match && condition_modified(r->if_unmodified_since, b->modified_s)) {
        response_problem(out, 412, "the resource is newer than If-Unmodified-Since says");
        return;
    }
    if (read &&
        (condition_none_match(r->if_none_match, out->etag) ||
         (!r->if_none_match && condition_not_modified(r->if_modified_since, b->modified_s)))) {
        out->status = 304;
        return;
    }
    uint64_t first, length;
    if (!response_wants_range(r, out))
        return;
    out->range_total = out->size;
    switch (condition_range(r->range, out->size, &first, &length)) {
    case RANGE_ALL:
        break;
    case RANGE_PART:
        out->status = 206;
        out->range_first = first;
        out->data += first;
        out->size = (size_t)length;
        break;
    case RANGE_BAD:
        response_problem(out, 416, "the range lies outside the resource");
        out->accept_ranges = true;
        break;
    }
}

void response_document(const struct request *r, const char *type, struct body *b,
                       struct response *out)
{
    out->type = type;
    response_body(r, b, out);
}

/* The result of work with a known name: 304 and hits are answered now, else *out asks for a job,
 * and the caller says which. True when the caller must. */
bool response_made(struct services *s, const struct request *r, struct hash128 id,
                   struct response *out)
{
    if (out->unnamed) {
        out->cache_control = RESPONSE_NO_STORE;
        out->cache = "none";
        out->status = 200;
        return true;
    }
    body_etag(id, out->etag);
    out->accept_ranges = true;
    out->status = 200;
    bool again = false;
    struct body *b = cache_get(s->cache, id, &again);
    if (again) /* those in memory are not read from the disk, which would forget them */
        disk_note(s->disk, id);
    if (!b)
        b = live_bodies_get(s->live_bodies,
                            id); /* too large to be kept, but others are reading it */
    out->cache = b ? "hit" : "miss";
    if (b) {
        response_body(r, b, out);
        return false;
    }
    if (condition_none_match(r->if_none_match, out->etag)) {
        out->status = 304;
        return false;
    }
    return true;
}

void *response_work(struct dataset *d, const struct work_kind *kind, struct hash128 id,
                    struct response *out)
{
    struct work *w = work_make(kind, d);
    if (!w) {
        response_no_memory(out);
        return NULL;
    }
    w->id = id;
    w->keep = !out->unnamed;
    out->kind = kind;
    out->work = w;
    return work_own(w);
}
