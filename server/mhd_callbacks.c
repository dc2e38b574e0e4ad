/* A request's life: on_target (the raw target is kept: the one that libmicrohttpd hands out later
 * is decoded and cut at NUL) -> first handler call (guard) -> body calls -> last call
 * (dispatch_answer; sent at once, or suspended behind a job) -> after resume one more call
 * (dispatch_finish, sent) -> on_completed (log, metrics).
 *
 * Requests of a connection come one after the other, so each lies in its connection's peer: an
 * allocation a request would be a tenth of what a tile in memory costs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/mhd_callbacks.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>

#include "core/trace.h"
#include "server/answers/dispatch.h"
#include "server/answers/view_stream.h"
#include "server/documents/link.h"
#include "server/http/request_guard.h"
#include "server/http/request_screen.h"
#include "server/route/router.h"

/* Of a stream: what libmicrohttpd asks for at once, and what may wait in the socket, so that a
 * picture that is drawn next is of the camera of now and not of that many bytes ago. */
enum {
    MHD_CALLBACKS_STREAM_BLOCK = 16 << 10,
    MHD_CALLBACKS_STREAM_WAITING = 16 << 10,
    MHD_CALLBACKS_VIDEO_WAITING = 4 << 10
};
enum { MHD_CALLBACKS_AUTHORITY = 256 }; /* of a target in absolute form */
enum { MHD_CALLBACKS_ID_MAX = 65, MHD_CALLBACKS_TARGET = 192 /* longer ones are allocated */ };
static const double MHD_CALLBACKS_OVER_S = 1; /* for the request of a connection too many */

enum stage { STAGE_HEAD, STAGE_BODY, STAGE_WAIT, STAGE_SENT };

struct exchange { /* one request and its answer */
    struct front *f;
    struct MHD_Connection *connection;
    struct peer *peer;              /* NULL: out of memory, and this was allocated */
    struct client_watch_slot *slot; /* of the peer */
    uint64_t number;                /* of the connection's requests, from 1 */
    char *target;                   /* NULL: too long, or out of memory */
    char target_text[MHD_CALLBACKS_TARGET];
    char id[MHD_CALLBACKS_ID_MAX], authority[MHD_CALLBACKS_AUTHORITY];
    double start_s;
    enum stage stage;
    struct request req;
    struct response res;
    struct job_waiter waiter;
    struct view_stream *stream; /* NULL: none */
    struct buf body;
    bool too_large, close, gone;
    uint64_t sent;
};

struct peer { /* one connection; made and freed by on_connection */
    struct client_watch_slot *slot;
    struct address address;
    bool over; /* one too many: its request is answered 503 */
    int fd;
    uint64_t requests; /* that libmicrohttpd has begun */
    struct request_screen screen;
    struct exchange now; /* the request under way */
};

/* ---- the answer ---- */

/* The reader of a stream; suspended while there is nothing to send. */
static ssize_t mhd_callbacks_read_stream(void *cls, uint64_t at, char *out, size_t room)
{
    struct exchange *x = cls;
    (void)at;
    ssize_t n = view_stream_read(x->stream, out, room);
    if (n < 0)
        return MHD_CONTENT_READER_END_OF_STREAM;
    x->sent += (uint64_t)n;
    client_watch_phase(x->slot, CLIENT_WATCH_STREAM, n ? x->f->s->cfg->write_timeout_s : 0);
    if (!n) { /* suspended first, so that the end of a picture cannot come before it */
        MHD_suspend_connection(x->connection);
        if (!view_stream_await(x->stream))
            MHD_resume_connection(x->connection);
    }
    return n;
}

static void mhd_callbacks_on_stream(void *user)
{
    MHD_resume_connection(((struct exchange *)user)->connection);
}

static enum MHD_Result mhd_callbacks_send_answer(struct exchange *x)
{
    struct services *s = x->f->s;
    if (x->gone || atomic_load_explicit(&s->draining, memory_order_relaxed) ||
        client_watch_requests(x->slot) >= (uint64_t)s->cfg->requests_per_connection)
        x->close = true;
    bool bytes = x->req.method != METHOD_HEAD && x->res.status != 304;
    x->sent = bytes ? x->res.size : 0;
    x->stage = STAGE_SENT;
    client_watch_phase(x->slot, x->stream ? CLIENT_WATCH_STREAM : CLIENT_WATCH_SEND,
                       s->cfg->write_timeout_s);
    bool ok = x->stream ? reply_stream(x->connection, &x->res, MHD_CALLBACKS_STREAM_BLOCK,
                                       mhd_callbacks_read_stream, x)
                        : reply_send(x->f->replies, x->connection, &x->res, x->close);
    return ok ? MHD_YES : MHD_NO;
}

static enum MHD_Result mhd_callbacks_refuse(struct exchange *x, int status, const char *why)
{
    const struct server_config *cfg = x->f->s->cfg;
    const int64_t limit = status == 413   ? cfg->max_body_kb << 10
                          : status == 414 ? cfg->max_target_bytes
                          : status == 431 ? cfg->max_header_kb << 10
                                          : 0;
    char text[160];
    const int n =
        snprintf(text, sizeof text, limit ? "%s: at most %lld bytes" : "%s", why, (long long)limit);
    if (status == 431)
        snprintf(text + n, sizeof text - (size_t)n, " in all, and %d fields", REQUEST_FIELDS_MAX);
    response_problem(&x->res, status, text);
    x->close = true;
    atomic_fetch_add(&x->f->s->metrics.rejected, status != 503 && !x->f->self);
    if (status == 503)
        x->res.retry_after_s = 1;
    return mhd_callbacks_send_answer(x);
}

/* ---- who asks, and what ---- */

/* The id that a proxy gave, if it is a word of letters, digits and ._-, else one of our own: a
 * number that is never twice the same, scrambled, so that it does not tell how much is asked for
 * (splitmix64). */
static void mhd_callbacks_identify(struct exchange *x)
{
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-";
    const char *given = x->req.id;
    size_t n = given ? strlen(given) : 0;
    x->req.id_sent = n && n < sizeof x->id && strspn(given, plain) == n;
    if (x->req.id_sent) {
        memcpy(x->id, given, n + 1);
    } else {
        uint64_t z = x->f->secret.lo +
                     0x9e3779b97f4a7c15u *
                         (atomic_fetch_add_explicit(&x->f->asked, 1, memory_order_relaxed) + 1);
        z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
        z = (z ^ z >> 27) * 0x94d049bb133111ebu;
        z ^= z >> 31;
        for (int i = 0; i < 16; i++)
            x->id[i] = "0123456789abcdef"[z >> (60 - 4 * i) & 15];
        x->id[16] = '\0';
    }
    x->req.id = x->res.id = x->id;
    x->res.id_sent = x->req.id_sent;
}

/* --base-path off the target. True: it is that path without its slash, below which links lead
 * astray. */
static bool mhd_callbacks_unbase(struct exchange *x)
{
    const char *base = x->f->s->cfg->base_path, *target = x->req.target;
    size_t n = x->f->n_base;
    if (!n || !target || strncmp(target, base, n) != 0)
        return false;
    if (target[n] == '/') {
        x->req.target = target + n;
        x->req.target_size -= n;
    }
    return target[n] == '\0' || target[n] == '?';
}

/* ---- the guard ---- */

static enum MHD_Result mhd_callbacks_on_field(void *cls, enum MHD_ValueKind kind, const char *name,
                                              size_t n_name, const char *value, size_t n_value)
{
    (void)kind;
    request_guard_field(cls, name, n_name, value, n_value);
    return MHD_YES;
}

/* Who asks for work, behind a trusted proxy the one it asks for. */
static uint64_t mhd_callbacks_client(const struct exchange *x)
{
    struct front *f = x->f;
    struct address peer = x->peer->address;
    if (x->req.n_forwarded && !address_in(&f->proxies, peer) &&
        !atomic_flag_test_and_set(&f->proxy_told))
        log_warn("http", "requests come through a proxy, and all its clients share one client's "
                         "part; --trusted-proxy ADDRESS tells them apart");
    peer = address_client(&f->proxies, peer, x->req.forwarded, x->req.n_forwarded);
    return address_number(ipv6_groups_client(f->ipv6_groups, peer, clock_s()), f->secret);
}

/* What the screen has against this request: 0 or a status. A request that it has not seen is
 * refused as well: then libmicrohttpd reads past it. Where libmicrohttpd is strict by itself, it
 * refuses such requests with pages of its own. */
static int mhd_callbacks_screened(const struct exchange *x, const char **why)
{
    if (!x->peer)
        return *why = "out of memory", 503;
    if (!x->f->screened)
        return 0;
    if (x->peer->screen.requests < x->number)
        return *why = "this program was linked wrongly: requests come unchecked", 500;
    int status = request_screen_refused(&x->peer->screen, x->number);
    *why = request_screen_reason(status);
    return status;
}

/* First handler call: headers are complete. 0 when the request may go on, else the status to refuse
 * with. */
static int mhd_callbacks_guard(struct exchange *x, const char *method, const char *version,
                               const char **why)
{
    struct request_guard g = {.req = &x->req};
    x->req.method = request_guard_method(method);
    MHD_get_connection_values_n(x->connection, MHD_HEADER_KIND, mhd_callbacks_on_field, &g);
    if (x->authority[0])
        request_guard_authority(&g, x->authority);
    x->req.admin = x->f->admin;
    x->req.trusted = address_in(&x->f->proxies, x->peer->address);
    x->req.proxied |= !strcmp(version, "HTTP/1.0"); /* nginx speaks it to what is behind it */
    mhd_callbacks_identify(x);
    if (x->req.method == METHOD_POST)
        x->req.client = mhd_callbacks_client(x);
    if (request_guard_alone(&g, version) && address_is_loopback(x->peer->address))
        x->req.own_host = x->req.host;
    return request_guard_check(&g, x->f->s->cfg, version, why);
}

/* ---- jobs ---- */

static struct exchange *mhd_callbacks_of_waiter(struct job_waiter *w)
{
    return (struct exchange *)(void *)((char *)w - offsetof(struct exchange, waiter));
}

/* The job has ended, on a worker's thread: let the connection's own thread go on. After the resume
 * the exchange may be gone. */
static void mhd_callbacks_on_wake(struct job_waiter *w)
{
    struct exchange *x = mhd_callbacks_of_waiter(w);
    client_watch_disarm(x->f->watch, x->slot);
    MHD_resume_connection(x->connection);
}

void mhd_callbacks_on_gone(struct job_waiter *w)
{
    mhd_callbacks_of_waiter(w)->gone = true;
    mhd_callbacks_on_wake(w);
}

/* Suspended before the job is asked for, so that its end cannot come first. */
static enum MHD_Result mhd_callbacks_wait_for_job(struct exchange *x)
{
    struct front *f = x->f;
    struct client_watch_slot *slot = x->slot; /* outlives the exchange */
    struct work *work = x->res.work;
    x->res.work = NULL;
    x->stage = STAGE_WAIT;
    x->waiter.wake = mhd_callbacks_on_wake;
    client_watch_phase(slot, CLIENT_WATCH_WORK, 0);
    client_watch_expect(f->watch, slot);
    MHD_suspend_connection(x->connection);
    if (job_submit(f->s->jobs, x->res.cls, work->id, work, mhd_callbacks_client(x),
                   x->res.timeout_s, &x->waiter) == ERR_OK)
        client_watch_arm(f->watch, slot,
                         &x->waiter); /* does nothing when the job has ended already */
    else
        mhd_callbacks_on_wake(&x->waiter);
    return MHD_YES;
}

/* ---- streams ---- */

static enum MHD_Result mhd_callbacks_begin_stream(struct exchange *x)
{
    struct err e = {0};
    const int waiting = x->res.video ? MHD_CALLBACKS_VIDEO_WAITING : MHD_CALLBACKS_STREAM_WAITING;
    const struct view_stream_reader reader = {.ds = x->res.stream_of,
                                              .name = x->res.stream,
                                              .client = mhd_callbacks_client(x),
                                              .video = x->res.video,
                                              .ready = mhd_callbacks_on_stream,
                                              .user = x};
    enum err_code rc = view_stream_begin(x->f->s->view_streams, &reader, &x->stream, &e);
    if (rc) {
        response_problem(&x->res, rc == ERR_ARG ? 409 : rc == ERR_LIMIT ? 429 : 503, e.msg);
        x->res.retry_after_s = rc == ERR_ARG ? 0 : 10;
        return mhd_callbacks_send_answer(x);
    }
    (void)setsockopt(x->peer->fd, IPPROTO_TCP, TCP_NOTSENT_LOWAT, &waiting, sizeof waiting);
    client_watch_arm_stream(x->f->watch, x->slot, x->stream);
    x->close = true; /* nobody waits for its end to ask for more */
    return mhd_callbacks_send_answer(x);
}

/* ---- the answer, or what it waits for ---- */

static enum MHD_Result mhd_callbacks_answer(struct exchange *x)
{
    dispatch_answer(x->f->s, &x->req, &x->res);
    if (x->res.stream[0])
        return mhd_callbacks_begin_stream(x);
    return x->res.work ? mhd_callbacks_wait_for_job(x) : mhd_callbacks_send_answer(x);
}

/* ---- callbacks ---- */

/* Zeroed; NULL when out of memory. */
static struct exchange *mhd_callbacks_begin(struct peer *p)
{
    if (!p)
        return mem_array(1, sizeof(struct exchange));
    memset(&p->now, 0, sizeof p->now);
    return &p->now;
}

/* A target in absolute form, as proxies get it (RFC 9112, section 3.2.2): its authority counts, and
 * not Host. Another form is left for the guard to refuse. */
static void mhd_callbacks_take_authority(struct exchange *x)
{
    const size_t skip = !strncasecmp(x->target, "http://", 7)    ? 7
                        : !strncasecmp(x->target, "https://", 8) ? 8
                                                                 : 0;
    char *host = x->target + skip, *path = host + strcspn(host, "/?");
    const size_t n = (size_t)(path - host);
    if (!skip || !n || n >= sizeof x->authority || memchr(host, '@', n))
        return;
    memcpy(x->authority, host, n);
    x->authority[n] = '\0';
    if (*path != '/') /* the path is empty, which means the same as a slash */
        *--path = '/';
    x->req.target = path;
    x->req.target_size = strlen(path);
}

static void mhd_callbacks_take_target(struct exchange *x, const char *target)
{
    size_t n = strlen(target);
    if (n < sizeof x->target_text)
        x->target = memcpy(x->target_text, target, n + 1);
    else if (n <= (size_t)x->f->s->cfg->max_target_bytes)
        x->target = mem_text(target);
    x->req.target = x->target;
    x->req.target_size = n;
    if (x->target && n && x->target[0] != '/')
        mhd_callbacks_take_authority(x);
    if (x->target && n)
        x->req.target_size = router_unescape(x->target + (x->req.target - x->target));
}

void *mhd_callbacks_on_target(void *cls, const char *target, struct MHD_Connection *c)
{
    struct front *f = cls;
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    struct peer *p = info ? info->socket_context : NULL;
    struct exchange *x = mhd_callbacks_begin(p);
    if (!x)
        return NULL;
    x->f = f;
    x->connection = c;
    x->peer = p;
    x->slot = p ? p->slot : NULL;
    x->number = p ? ++p->requests : 0;
    x->start_s = clock_s();
    x->res.queue_s = -1;
    x->res.same_origin = f->admin;
    mhd_callbacks_take_target(x, target);
    client_watch_phase_at(x->slot, CLIENT_WATCH_HEADER,
                          p && p->over ? MHD_CALLBACKS_OVER_S : f->s->cfg->header_timeout_s,
                          x->start_s);
    atomic_fetch_add_explicit(&f->s->metrics.inflight, 1, memory_order_relaxed);
    return x;
}

static enum MHD_Result mhd_callbacks_on_head(struct exchange *x, const char *method,
                                             const char *version)
{
    struct services *s = x->f->s;
    const char *why;
    x->stage = STAGE_BODY;
    int status = mhd_callbacks_screened(x, &why);
    if (!status)
        status = mhd_callbacks_guard(x, method, version, &why);
    if (status)
        return mhd_callbacks_refuse(x, status, why);
    if (x->peer->over)
        return mhd_callbacks_refuse(x, 503, "too many connections are open");
    if (mhd_callbacks_unbase(x)) {
        x->res.status = 308;
        x->res.location = mem_array(x->f->n_base + 2, 1);
        x->res.cache_control = "public, max-age=60";
        if (x->res.location)
            sprintf(x->res.location, "%s/", x->f->s->cfg->base_path);
        return mhd_callbacks_send_answer(x);
    }
    if (x->req.method != METHOD_GET && x->req.method != METHOD_HEAD)
        client_watch_phase(x->slot, CLIENT_WATCH_BODY, s->cfg->body_timeout_s);
    return MHD_YES;
}

enum MHD_Result mhd_callbacks_on_request(void *cls, struct MHD_Connection *c, const char *url,
                                         const char *method, const char *version,
                                         const char *upload, size_t *n_upload, void **con_cls)
{
    struct front *f = cls;
    struct exchange *x = *con_cls;
    size_t limit = (size_t)f->s->cfg->max_body_kb << 10;
    (void)c, (void)url;
    if (!x)
        return MHD_NO; /* out of memory */
    if (x->stage == STAGE_HEAD)
        return mhd_callbacks_on_head(x, method, version);
    if (x->stage == STAGE_BODY && *n_upload) {
        x->too_large |= x->body.size + *n_upload > limit;
        if (!x->too_large)
            buf_add(&x->body, upload, *n_upload);
        *n_upload = 0;
        return MHD_YES;
    }
    if (x->stage == STAGE_SENT)
        return MHD_YES;
    if (x->stage == STAGE_WAIT) {
        dispatch_finish(f->s, &x->req, &x->waiter.result, &x->res);
        return mhd_callbacks_send_answer(x);
    }
    const char *why;
    int status = mhd_callbacks_screened(x, &why); /* the body may have been malformed */
    if (status)
        return mhd_callbacks_refuse(x, status, why);
    if (x->too_large)
        return mhd_callbacks_refuse(x, 413, "the body is too large");
    if (x->body.failed)
        return mhd_callbacks_refuse(x, 503, "out of memory");
    x->req.body = x->body.data;
    x->req.body_size = x->body.size;
    return mhd_callbacks_answer(x);
}

/* The client's address, as --log-clients has it: what names a person need not be kept. */
static void mhd_callbacks_client_text(const struct exchange *x, char *out, size_t room)
{
    const struct server_config *cfg = x->f->s->cfg;
    enum { FULL, NETWORK };
    snprintf(out, room, "-");
    if (!x->peer || cfg->log_clients > NETWORK)
        return;
    struct address a =
        address_client(&x->f->proxies, x->peer->address, x->req.forwarded, x->req.n_forwarded);
    address_write(cfg->log_clients == FULL ? a : address_network(a), out, room);
}

static void mhd_callbacks_log_access(const struct exchange *x, int status, double seconds)
{
    char client[ADDRESS_TEXT], target[ACCESS_LOG_TARGET], referer[ACCESS_LOG_TARGET];
    mhd_callbacks_client_text(x, client, sizeof client);
    const struct access_log_line line = {
        .method = request_guard_method_name(x->req.method),
        .route = route_path(x->res.route),
        /* a target that names no route may hold anything: it is not repeated */
        .target = x->res.route ? link_mask(x->target, target, sizeof target) : "-",
        .client = client,
        .id = x->id[0] ? x->id : "-",
        .cache = x->res.cache,
        .referer = x->req.referer ? link_mask(x->req.referer, referer, sizeof referer) : NULL,
        .agent = x->req.agent,
        .status = status,
        .bytes = x->sent,
        .seconds = seconds,
        .job_s = x->res.run_s,
    };
    access_log_add(x->f->s->access, &line);
}

void mhd_callbacks_on_completed(void *cls, struct MHD_Connection *c, void **con_cls,
                                enum MHD_RequestTerminationCode how)
{
    struct front *f = cls;
    struct exchange *x = *con_cls;
    (void)c;
    *con_cls = NULL;
    if (!x)
        return;
    bool whole = how == MHD_REQUEST_TERMINATED_COMPLETED_OK && !x->gone;
    int status = whole ? x->res.status : 499; /* by custom: the client left */
    const double now_s = clock_s(), seconds = now_s - x->start_s;
    if (!whole && !f->self)
        atomic_fetch_add(&f->s->metrics.client_aborts, 1);
    if (!f->self)
        metrics_request(&f->s->metrics, router_index(f->s->routes, x->res.route), status, seconds,
                        whole ? x->sent : 0);
    if (!f->self)
        trace_overlap("requests", route_path(x->res.route), x->start_s, now_s);
    if (f->s->access && !f->self && !(whole && x->res.unlogged))
        mhd_callbacks_log_access(x, status, seconds);
    if (x->stream) {
        client_watch_disarm(f->watch, x->slot);
        view_stream_leave(&x->stream);
    }
    client_watch_phase_at(x->slot, CLIENT_WATCH_IDLE, f->s->cfg->idle_timeout_s, now_s);
    atomic_fetch_sub_explicit(&f->s->metrics.inflight, 1, memory_order_relaxed);
    body_drop(&x->waiter.result.body);
    response_free(&x->res);
    buf_free(&x->body);
    if (x->target != x->target_text)
        mem_free(x->target);
    if (!x->peer)
        mem_free(x);
}

static struct peer *mhd_callbacks_peer(struct front *f, int fd, const struct sockaddr *address)
{
    const struct server_config *cfg = f->s->cfg;
    struct peer *p = mem_array(1, sizeof *p);
    if (!p)
        return NULL;
    p->fd = fd;
    p->address = address_of_socket(address);
    bool unlimited = f->admin || f->self || address_in(&f->proxies, p->address);
    size_t limit = unlimited ? 0 : (size_t)cfg->per_ip_connections;
    p->slot =
        client_watch_add(f->watch, fd, address_number(p->address, f->secret), limit, &p->over);
    p->screen.passes = !f->screened;
    if (request_screen_attach(&p->screen, fd, f->tls, (size_t)cfg->max_header_kb << 10, NULL)) {
        client_watch_remove(f->watch, p->slot);
        mem_free(p);
        return NULL;
    }
    client_watch_phase(p->slot, CLIENT_WATCH_HEADER,
                       p->over ? MHD_CALLBACKS_OVER_S : cfg->header_timeout_s);
    return p;
}

void mhd_callbacks_on_connection(void *cls, struct MHD_Connection *c, void **context,
                                 enum MHD_ConnectionNotificationCode what)
{
    struct front *f = cls;
    if (what == MHD_CONNECTION_NOTIFY_CLOSED) {
        struct peer *p = *context;
        *context = NULL;
        if (p) {
            client_watch_remove(f->watch, p->slot);
            request_screen_detach(&p->screen, p->fd);
            mem_free(p);
        }
        atomic_fetch_sub_explicit(&f->s->metrics.connections, 1, memory_order_relaxed);
        atomic_fetch_sub_explicit(&f->open, 1, memory_order_release);
        return;
    }
    /* What is returned holds until the next call: libmicrohttpd 1.0 has one union for all. */
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CONNECTION_FD);
    const int fd = info ? info->connect_fd : -1;
    info = MHD_get_connection_info(c, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
    *context = fd >= 0 && info ? mhd_callbacks_peer(f, fd, info->client_addr) : NULL;
    atomic_fetch_add_explicit(&f->s->metrics.connections, 1, memory_order_relaxed);
    atomic_fetch_add_explicit(&f->open, 1, memory_order_relaxed);
}
