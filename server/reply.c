/* libmicrohttpd's responses. Making one takes forty allocations for a dozen header fields, as much
 * work as all else for a tile from memory. But a response may be sent many times, by any thread.
 * Frequent ones are therefore kept (docs/decisions/034-caches.md), in a table with one place for
 * each address of bytes. A response takes a place if it comes twice while the present one does
 * not.
 *
 * A kept response only points to the bytes. It is sent for an answer with the same bytes, size and
 * header fields. That answer's own reference keeps the body alive. The table keeps nothing alive,
 * and never reads the bytes of a body that was freed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/reply.h"

#include <assert.h>
#include <pthread.h>
#include <string.h>
#include <unistd.h>

#include "server/base/body_file.h"
#include "server/headers.h"

enum { REPLY_PLACES = 1024, REPLY_TEXT = 4096 /* bytes of values; more are not kept */ };

struct reply { /* one place; everything by `lock` */
    pthread_mutex_t lock;
    struct MHD_Response *made; /* NULL: none is kept */
    int status;
    const uint8_t *data;
    size_t size, n;
    uint64_t seen; /* name of the last answer that was not the one kept; 0: none since that was */
    const char *name[HEADERS_MAX]; /* [n], constants */
    char *values;                  /* each with its NUL */
    uint16_t value[HEADERS_MAX];   /* [n], where it begins in `values` */
};
struct replies {
    struct reply place[REPLY_PLACES];
};

/* ---- making ---- */

// NOLINTNEXTLINE(readability-non-const-parameter): libmicrohttpd's type
static ssize_t reply_no_bytes(void *cls, uint64_t at, char *out, size_t room)
{
    (void)cls, (void)at, (void)out, (void)room;
    return MHD_CONTENT_READER_END_OF_STREAM;
}

/* A 304 without the body at hand must not claim Content-Length: 0 (RFC 9110, section 8.6), which an
 * empty buffer would. A stream of unknown length claims nothing wrong. But libmicrohttpd 0.9.75
 * ends it with a last chunk, five bytes that no client expects behind a 304: so the connection ends
 * instead. */
static struct MHD_Response *reply_create(const struct response *r)
{
    if (r->body && r->data)
        return MHD_create_response_from_buffer(r->size, (void *)(uintptr_t)r->data,
                                               MHD_RESPMEM_PERSISTENT);
    if (r->status != 304)
        return MHD_create_response_from_buffer(0, (void *)(uintptr_t) "", MHD_RESPMEM_PERSISTENT);
    struct MHD_Response *m =
        MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, 1024, reply_no_bytes, NULL, NULL);
    if (m)
        (void)MHD_set_response_options(m, MHD_RF_HTTP_1_0_COMPATIBLE_STRICT, MHD_RO_END);
    return m;
}

/* Of a body in a file, which the kernel sends without a copy; with TLS there is none to spare. Such
 * answers are not kept: their file would outlive the body. NULL: it is in no file. */
static struct MHD_Response *reply_from_file(struct MHD_Connection *c, const struct response *r)
{
    uint64_t at = 0;
    if (!r->body || !r->data || !r->size || !r->body->unmap ||
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_GNUTLS_SESSION))
        return NULL;
    const int fd = body_file_of(r->body, r->data, &at);
    struct MHD_Response *m =
        fd < 0 ? NULL : MHD_create_response_from_fd_at_offset64(r->size, fd, at);
    if (fd >= 0 && !m)
        close(fd);
    return m;
}

static void reply_add_headers(struct MHD_Response *m, const struct headers *h)
{
    for (size_t i = 0; i < h->n; i++)
        (void)MHD_add_response_header(m, h->field[i].name, h->field[i].value);
}

static bool reply_queue(struct MHD_Connection *c, const struct response *r, struct MHD_Response *m)
{
    return MHD_queue_response(c, (unsigned)r->status, m) == MHD_YES;
}

/* ---- keeping ---- */

/* Whole answers that somebody may ask for again, as they are. */
static bool reply_may_return(const struct response *r, bool last)
{
    return !last && (r->status == 200 || r->status == 304) && r->etag[0] && !headers_repeat_id(r) &&
           r->queue_s < 0;
}

/* A number that tells answers apart well enough to find a place; an entity tag is a hash. */
static uint64_t reply_number(const struct response *r)
{
    uint64_t z;
    static_assert(BODY_ETAG_SIZE > 1 + sizeof z, "a tag has so many bytes behind its quote");
    memcpy(&z, r->etag + 1, sizeof z);
    return (z + 2 * r->size + (r->status == 304)) * 0x9e3779b97f4a7c15u;
}

static bool reply_is(const struct reply *p, const struct response *r, const struct headers *h)
{
    if (!p->made || p->data != r->data || p->status != r->status || p->size != r->size ||
        p->n != h->n)
        return false;
    for (size_t i = 0; i < h->n; i++)
        if (p->name[i] != h->field[i].name ||
            strcmp(p->values + p->value[i], h->field[i].value) != 0)
            return false;
    return true;
}

static void reply_forget(struct reply *p)
{
    if (p->made)
        MHD_destroy_response(p->made);
    p->made = NULL;
    mem_free(p->values);
    p->values = NULL;
}

/* Put m in its place; without memory the place stays empty. */
static void reply_keep(struct reply *p, const struct response *r, const struct headers *h,
                       struct MHD_Response *m)
{
    size_t total = 0;
    reply_forget(p);
    for (size_t i = 0; i < h->n; i++)
        total += strlen(h->field[i].value) + 1;
    p->values = total <= REPLY_TEXT ? mem_array(total, 1) : NULL;
    if (!p->values)
        return;
    char *at = p->values;
    for (size_t i = 0; i < h->n; i++) {
        size_t n = strlen(h->field[i].value) + 1;
        p->name[i] = h->field[i].name;
        p->value[i] = (uint16_t)(at - p->values);
        memcpy(at, h->field[i].value, n);
        at += n;
    }
    p->made = m;
    p->data = r->data;
    p->size = r->size;
    p->status = r->status;
    p->n = h->n;
}

/* ---- the interface ---- */

enum err_code reply_open(struct replies **out, struct err *e)
{
    *out = mem_array(1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "answers that are kept: out of memory");
    for (size_t i = 0; i < REPLY_PLACES; i++)
        pthread_mutex_init(&(*out)->place[i].lock, NULL);
    return ERR_OK;
}

void reply_close(struct replies **out)
{
    struct replies *rs = *out;
    *out = NULL;
    for (size_t i = 0; rs && i < REPLY_PLACES; i++) {
        reply_forget(&rs->place[i]);
        pthread_mutex_destroy(&rs->place[i].lock);
    }
    mem_free(rs);
}

static bool reply_send_made(struct MHD_Connection *c, const struct response *r,
                            const struct headers *h, struct reply *keep)
{
    struct MHD_Response *file = reply_from_file(c, r), *m = file ? file : reply_create(r);
    if (!m)
        return false;
    reply_add_headers(m, h);
    bool ok = reply_queue(c, r, m);
    if (keep && !file)
        reply_keep(keep, r, h, m);
    if (!keep || keep->made != m)
        MHD_destroy_response(m); /* the connection has a reference of its own */
    return ok;
}

bool reply_send(struct replies *rs, struct MHD_Connection *c, const struct response *r, bool last)
{
    struct headers h;
    bool ok;
    headers_make(r, last, &h);
    if (!reply_may_return(r, last))
        return reply_send_made(c, r, &h, NULL);
    const uint64_t number = reply_number(r);
    struct reply *p = &rs->place[number >> 32 & (REPLY_PLACES - 1)];
    pthread_mutex_lock(&p->lock); /* queueing writes a few pointers, and calls nobody */
    if (reply_is(p, r, &h)) {
        p->seen = 0;
        ok = reply_queue(c, r, p->made);
    } else {
        ok = reply_send_made(c, r, &h, p->seen == number ? p : NULL);
        p->seen = number;
    }
    pthread_mutex_unlock(&p->lock);
    return ok;
}

bool reply_stream(struct MHD_Connection *c, const struct response *r, size_t block,
                  MHD_ContentReaderCallback read, void *cls)
{
    struct headers h;
    headers_make(r, true, &h);
    struct MHD_Response *m =
        MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, block, read, cls, NULL);
    if (!m)
        return false;
    reply_add_headers(m, &h);
    bool ok = reply_queue(c, r, m);
    MHD_destroy_response(m);
    return ok;
}
