/* Cuts requests into lines and bodies as RFC 9112 defines, and checks each line before
 * libmicrohttpd gets it. Version 0.9.75 has no hook for that, so this file defines recv(). The
 * program's own definition takes precedence over the C library's when the shared library is bound.
 * Descriptors without a screen go directly to recvfrom(). mhd_callbacks.c refuses requests that no
 * screen has seen, so a build in which this fails answers nothing.
 *
 * Reads are as libmicrohttpd's edge-triggered loop needs them: a short count or EAGAIN only if the
 * socket is empty; else the room is filled.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/request_screen.h"

#include <errno.h>
#include <stdatomic.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>

#include "server/base/text.h"

enum {
    REQUEST_SCREEN_FDS = 1 << 20,
    REQUEST_SCREEN_READ = 2048,
    REQUEST_SCREEN_KEEP = 8192,
    REQUEST_SCREEN_KEYS = 64,
    REQUEST_SCREEN_DIGITS = 18
};

static struct request_screen
    *_Atomic request_screen_of[REQUEST_SCREEN_FDS]; /* by descriptor; pages appear when touched */

/* ---- lines ---- */

static void request_screen_refuse(struct request_screen *s, int status)
{
    static const char *const ends[] = {
        [REQUEST_SCREEN_REQUEST] = "GET / HTTP/1.1\r\n\r\n",
        [REQUEST_SCREEN_FIELD] = "\r\n",
        [REQUEST_SCREEN_BODY] = "",
        [REQUEST_SCREEN_CHUNK_SIZE] = "0\r\n\r\n",
        [REQUEST_SCREEN_CHUNK_DATA] = "",
        [REQUEST_SCREEN_CHUNK_END] = "\r\n0\r\n\r\n",
        [REQUEST_SCREEN_TRAILER] = "\r\n",
        [REQUEST_SCREEN_CLOSED] = "",
    };
    s->requests += s->state == REQUEST_SCREEN_REQUEST;
    s->refused_at = s->requests;
    s->status = status;
    const bool head = s->state == REQUEST_SCREEN_REQUEST && s->n_in - s->n_ok >= 5 &&
                      !memcmp(s->in + s->n_ok, "HEAD ", 5);
    s->feed = head ? "HEAD / HTTP/1.1\r\n\r\n" : ends[s->state]; /* which has no body */
    s->state = REQUEST_SCREEN_CLOSED;
    s->n_in = s->n_ok; /* the rest is not read by anybody */
}

/* Bytes of RFC 9110's token. */
static bool request_screen_token(const char *p, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        char c = p[i];
        if (!((c >= '^' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
              c == '-' || (c && memchr("!#$%&'*+.|~", c, 11))))
            return false;
    }
    return n > 0;
}

static bool request_screen_is(const char *p, size_t n, const char *word)
{
    return n == strlen(word) && !strncasecmp(p, word, n);
}

/* 0, or the status to refuse a length with. */
static int request_screen_length(struct request_screen *s, const char *p, size_t n)
{
    s->length = 0;
    if (!n || ++s->n_length > 1)
        return 400;
    for (size_t i = 0; i < n; i++)
        if (p[i] < '0' || p[i] > '9')
            return 400;
    if (n > REQUEST_SCREEN_DIGITS)
        return 413;
    for (size_t i = 0; i < n; i++)
        s->length = s->length * 10 + (uint64_t)(p[i] - '0');
    return 0;
}

/* One field line of a head; 0, or the status to refuse it with. */
static int request_screen_field(struct request_screen *s, const char *p, size_t n)
{
    const char *colon = memchr(p, ':', n);
    size_t n_name = colon ? (size_t)(colon - p) : 0;
    if (!colon || !request_screen_token(p, n_name) || !text_is_clean(p, n))
        return 400;
    const char *v = colon + 1;
    size_t n_value = n - n_name - 1;
    while (n_value && (*v == ' ' || *v == '\t'))
        v++, n_value--;
    if (request_screen_is(p, n_name, "Content-Length"))
        return request_screen_length(s, v, n_value);
    if (request_screen_is(p, n_name, "Transfer-Encoding"))
        return ++s->n_coding > 1 ? 400 : request_screen_is(v, n_value, "chunked") ? 0 : 501;
    return 0;
}

static void request_screen_head_end(struct request_screen *s)
{
    s->left = s->length;
    s->state = s->n_coding ? REQUEST_SCREEN_CHUNK_SIZE
               : s->left   ? REQUEST_SCREEN_BODY
                           : REQUEST_SCREEN_REQUEST;
}

static bool request_screen_chunk(struct request_screen *s, const char *p, size_t n)
{
    enum { HEX_MAX = 8 };
    size_t digits = 0;
    s->left = 0;
    for (; digits < n; digits++) {
        char c = p[digits];
        int v = c >= '0' && c <= '9'   ? c - '0'
                : c >= 'a' && c <= 'f' ? c - 'a' + 10
                : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                       : -1;
        if (v < 0)
            break;
        s->left = s->left * 16 + (uint64_t)v;
    }
    s->state = s->left ? REQUEST_SCREEN_CHUNK_DATA : REQUEST_SCREEN_TRAILER;
    return digits && digits <= HEX_MAX && (digits == n || p[digits] == ';') && text_is_clean(p, n);
}

/* Parameters of the query: libmicrohttpd takes memory for each, and hangs up when it has none
 * left. */
static size_t request_screen_keys(const char *p, size_t n)
{
    size_t keys = 0;
    for (const char *end = p + n; (p = memchr(p, '&', (size_t)(end - p))); p++)
        keys++;
    return keys;
}

/* Two spaces one behind the other: one stands between the parts of a request line. */
static bool request_screen_has_gap(const char *p, size_t n)
{
    const char *end = p + n;
    for (; (p = memchr(p, ' ', (size_t)(end - p))) && p + 1 < end; p++)
        if (p[1] == ' ')
            return true;
    return false;
}

/* A whole line, without its end. 0, or the status to refuse it with (then the state is as
 * before). */
static int request_screen_line(struct request_screen *s, const char *p, size_t n)
{
    enum request_screen_state was = s->state;
    int status = 0;
    switch (s->state) {
    case REQUEST_SCREEN_REQUEST:
        if (!n)
            return 0;
        if (!text_is_clean(p, n) || memchr(p, '\t', n) ||
            request_screen_keys(p, n) > REQUEST_SCREEN_KEYS || request_screen_has_gap(p, n))
            return 400;
        s->requests++;
        s->length = s->n_length = s->n_coding = 0;
        s->state = REQUEST_SCREEN_FIELD;
        return 0;
    case REQUEST_SCREEN_FIELD:
        if (n)
            return request_screen_field(s, p, n);
        if (s->n_length && s->n_coding)
            return 400;
        request_screen_head_end(s);
        return 0;
    case REQUEST_SCREEN_CHUNK_SIZE:
        status = request_screen_chunk(s, p, n) ? 0 : 400;
        break;
    case REQUEST_SCREEN_CHUNK_END:
        s->state = REQUEST_SCREEN_CHUNK_SIZE;
        status = n ? 400 : 0;
        break;
    default: /* REQUEST_SCREEN_TRAILER */
        if (!n)
            s->state = REQUEST_SCREEN_REQUEST;
        else
            status = request_screen_token(p, strcspn(p, ":\n")) && text_is_clean(p, n) ? 0 : 400;
    }
    if (status)
        s->state = was;
    return status;
}

/* Look at the next line, if there is a whole one. */
static bool request_screen_next_line(struct request_screen *s)
{
    char *p = s->in + s->n_ok;
    size_t n = s->n_in - s->n_ok;
    char *end = memchr(p, '\n', n);
    if (!end) {
        if (n > s->line_max)
            request_screen_refuse(s, s->state == REQUEST_SCREEN_REQUEST ? 414 : 431);
        return false;
    }
    size_t size = (size_t)(end - p), bare = size;
    bool cr = bare && p[bare - 1] == '\r';
    bare -= cr;
    if (s->state == REQUEST_SCREEN_FIELD && bare && (p[bare - 1] == ' ' || p[bare - 1] == '\t')) {
        /* Space after a value is no part of it; libmicrohttpd takes it for one. */
        size_t keep = bare;
        while (keep && (p[keep - 1] == ' ' || p[keep - 1] == '\t'))
            keep--;
        memmove(p + keep, p + bare, n - bare);
        s->n_in -= bare - keep;
        size -= bare - keep;
        bare = keep;
        if (!keep) /* a line of spaces is no end of a head */
            return request_screen_refuse(s, 400), false;
    }
    const bool of_chunk =
        s->state == REQUEST_SCREEN_CHUNK_SIZE || s->state == REQUEST_SCREEN_CHUNK_END;
    /* A lone LF may end a line of the head (RFC 9112, section 2.2), and none of a chunk. */
    int status = of_chunk && !cr ? 400 : request_screen_line(s, p, bare);
    if (status)
        return request_screen_refuse(s, status), false;
    s->n_ok += size + 1;
    return true;
}

static void request_screen_look(struct request_screen *s)
{
    while (s->n_ok < s->n_in) {
        if (s->state == REQUEST_SCREEN_CLOSED) {
            s->n_in = s->n_ok;
        } else if (s->state == REQUEST_SCREEN_BODY || s->state == REQUEST_SCREEN_CHUNK_DATA) {
            size_t n = s->n_in - s->n_ok;
            n = n < s->left ? n : (size_t)s->left;
            s->n_ok += n;
            s->left -= n;
            if (!s->left)
                s->state = s->state == REQUEST_SCREEN_BODY ? REQUEST_SCREEN_REQUEST
                                                           : REQUEST_SCREEN_CHUNK_END;
        } else if (!request_screen_next_line(s)) {
            break;
        }
    }
}

size_t request_screen_take(struct request_screen *s, char *out, size_t room)
{
    size_t n = s->n_ok < room ? s->n_ok : room;
    memcpy(out, s->in ? s->in : "", n);
    if (n) {
        memmove(s->in, s->in + n, s->n_in - n);
        s->n_ok -= n;
        s->n_in -= n;
    }
    if (!s->n_in && s->cap > REQUEST_SCREEN_KEEP) { /* a body has gone through */
        mem_free(s->in);
        s->in = NULL;
        s->cap = 0;
    }
    while (!s->n_ok && s->feed && *s->feed && n < room)
        out[n++] = *s->feed++;
    return n;
}

/* Room for `more` bytes behind those that are there; false when out of memory. */
static bool request_screen_room(struct request_screen *s, size_t more)
{
    if (s->n_in + more <= s->cap)
        return true;
    size_t cap = s->n_in + more > 2 * s->cap ? s->n_in + more : 2 * s->cap;
    char *p = mem_resize(s->in, s->cap, cap, 1);
    if (!p)
        return false;
    s->in = p;
    s->cap = cap;
    return true;
}

void request_screen_put(struct request_screen *s, const char *bytes, size_t n)
{
    if (s->state == REQUEST_SCREEN_CLOSED)
        return;
    if (!request_screen_room(s, n)) {
        request_screen_refuse(s, 503);
        return;
    }
    memcpy(s->in + s->n_in, bytes, n);
    s->n_in += n;
    request_screen_look(s);
}

/* ---- sockets ---- */

size_t request_screen_read(struct request_screen *s,
                           ssize_t (*more)(void *from, char *out, size_t room), void *from,
                           enum request_screen_source source, char *out, size_t room, ssize_t *last)
{
    char bytes[REQUEST_SCREEN_READ];
    size_t n = request_screen_take(s, out, room);
    while (n < room) {
        ssize_t got = more(from, bytes, sizeof bytes);
        if (got <= 0) {
            *last = got;
            break;
        }
        request_screen_put(s, bytes, (size_t)got);
        n += request_screen_take(s, out + n, room - n);
        if (source == REQUEST_SCREEN_SOCKET && (size_t)got < sizeof bytes)
            break;
    }
    return n;
}

struct request_screen *request_screen_at(int fd)
{
    return fd >= 0 && fd < REQUEST_SCREEN_FDS
               ? atomic_load_explicit(&request_screen_of[fd], memory_order_acquire)
               : NULL;
}

#ifdef CITYSPLAT_SCREEN /* libmicrohttpd before 1.0 */
static ssize_t request_screen_socket(void *fd, char *out, size_t room)
{
    return recvfrom(*(const int *)fd, out, room, 0, NULL, NULL);
}

ssize_t recv(int fd, void *out, size_t room, int flags)
{
    struct request_screen *s = flags ? NULL : request_screen_at(fd);
    if (!s || s->tls || s->passes)
        return recvfrom(fd, out, room, flags, NULL, NULL);
    ssize_t last = 1; /* nothing ended it */
    size_t n =
        request_screen_read(s, request_screen_socket, &fd, REQUEST_SCREEN_SOCKET, out, room, &last);
    if (n || !room)
        return (ssize_t)n;
    if (last == 1) {
        errno = EAGAIN; /* half a line */
        last = -1;
    }
    return last;
}
#endif

enum err_code request_screen_attach(struct request_screen *s, int fd, struct tls *tls,
                                    size_t line_max, struct err *e)
{
    *s = (struct request_screen){.tls = tls, .passes = s->passes, .line_max = line_max};
    if (fd < 0 || fd >= REQUEST_SCREEN_FDS)
        return err_set(e, ERR_MEM, "screen: descriptor %d is beyond %d", fd, REQUEST_SCREEN_FDS);
    atomic_store_explicit(&request_screen_of[fd], s, memory_order_release);
    return ERR_OK;
}

void request_screen_detach(struct request_screen *s, int fd)
{
    if (fd >= 0 && fd < REQUEST_SCREEN_FDS)
        atomic_store_explicit(&request_screen_of[fd], NULL, memory_order_release);
    mem_free(s->in);
    *s = (struct request_screen){0};
}

int request_screen_refused(const struct request_screen *s, uint64_t n)
{
    return s->refused_at == n ? s->status : 0;
}

const char *request_screen_reason(int status)
{
    return status == 413   ? "the body is too large"
           : status == 414 ? "the request target is too long"
           : status == 431 ? "a header field is too long"
           : status == 501 ? "the only transfer coding is chunked"
           : status == 503 ? "out of memory"
                           : "the request is malformed";
}
