/* libmicrohttpd and nothing else: its requests become struct request, our responses become its own.
 * The only file that includes microhttpd.h.
 *
 * A request's life: URI_LOG (exchange made, raw target copied: the one libmicrohttpd hands out
 * later is decoded and cut at NUL) -> first handler call (guard) -> body calls -> last call
 * (route_answer; sent at once, or suspended behind a job) -> after resume one more call
 * (route_finish, sent) -> COMPLETED (log, metrics, exchange freed).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http.h"

#include <microhttpd.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/pool.h"
#include "server/address.h"
#include "server/guard.h"
#include "server/headers.h"
#include "server/listen.h"
#include "server/motion.h"
#include "server/route.h"
#include "server/screen.h"
#include "server/supervisor.h"
#include "server/watch.h"

enum { HTTP_ID_MAX = 65, HTTP_ADMIN_CONNECTIONS = 32 };
enum { HTTP_THREADS_MAX = 4, HTTP_SPARE = 64 /* connections: to answer those over the limit */ };
/* Of a stream: what libmicrohttpd asks for at once, and what may wait in the socket, so that a
 * picture that is drawn next is of the camera of now and not of that many bytes ago. */
enum { HTTP_STREAM_BLOCK = 16 << 10, HTTP_STREAM_WAITING = 16 << 10 };
static const double HTTP_OVER_S = 1; /* for the request of a connection too many */

struct http {
    struct services *s;
    enum http_side side;
    _Atomic uint64_t open, asked; /* connections now; requests so far, for their ids */
    size_t n_base;                /* length of --base-path */
    struct MHD_Daemon *daemon;
    struct watch *watch;
    struct address_nets proxies; /* trusted ones */
    struct hash128 secret;       /* of numbers of clients */
    atomic_flag proxy_told;      /* that requests come through a proxy that is not trusted */
    int fd;                      /* listens; libmicrohttpd's once the daemon runs */
    bool held;                   /* by a supervisor as well, for the next server */
    uint16_t port;
};

struct peer { /* one connection; made and freed by on_connection */
    struct watch_slot *slot;
    struct address address;
    bool over; /* one too many: its request is answered 503 */
    int fd;
    uint64_t requests; /* that libmicrohttpd has begun */
    struct screen screen;
};

enum stage { STAGE_HEAD, STAGE_BODY, STAGE_WAIT, STAGE_SENT };

struct exchange { /* one request and its answer; made by on_target, freed by on_completed */
    struct http *h;
    struct MHD_Connection *connection;
    struct peer *peer;       /* NULL: out of memory */
    struct watch_slot *slot; /* of the peer */
    uint64_t number;         /* of the connection's requests, from 1 */
    char *target;
    char id[HTTP_ID_MAX];
    double start_s;
    enum stage stage;
    struct request req;
    struct response res;
    struct job_waiter waiter;
    struct motion_stream *stream; /* NULL: none */
    struct buf body;
    bool too_large, close, waited, gone;
    uint64_t sent;
};

/* ---- the answer ---- */

static void http_drop_body(void *cls)
{
    struct body *b = cls;
    body_drop(&b);
}

/* The reader of a stream; suspended while there is nothing to send. */
static ssize_t http_read_stream(void *cls, uint64_t at, char *out, size_t room)
{
    struct exchange *x = cls;
    (void)at;
    ssize_t n = motion_read(x->stream, out, room);
    if (n < 0)
        return MHD_CONTENT_READER_END_OF_STREAM;
    x->sent += (uint64_t)n;
    watch_phase(x->slot, WATCH_STREAM, n ? x->h->s->cfg->write_timeout_s : 0);
    if (!n) { /* suspended first, so that the end of a picture cannot come before it */
        MHD_suspend_connection(x->connection);
        if (!motion_await(x->stream))
            MHD_resume_connection(x->connection);
    }
    return n;
}

static void http_on_stream(void *user)
{
    MHD_resume_connection(((struct exchange *)user)->connection);
}

static ssize_t http_no_bytes(void *cls, uint64_t at, char *out, size_t room)
{
    (void)cls, (void)at, (void)out, (void)room;
    return MHD_CONTENT_READER_END_OF_STREAM;
}

/* A 304 without the body at hand must not claim Content-Length: 0 (RFC 9110, section 8.6), which an
 * empty buffer would; a stream of unknown length claims nothing wrong. */
static struct MHD_Response *http_make_response(struct exchange *x)
{
    struct response *r = &x->res;
    if (x->stream)
        return MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, HTTP_STREAM_BLOCK,
                                                 http_read_stream, x, NULL);
    if (r->body && r->data)
        return MHD_create_response_from_buffer_with_free_callback_cls(
            r->size, (void *)(uintptr_t)r->data, http_drop_body, body_ref(r->body));
    if (r->status == 304)
        return MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, 1024, http_no_bytes, NULL, NULL);
    return MHD_create_response_from_buffer(0, (void *)(uintptr_t) "", MHD_RESPMEM_PERSISTENT);
}

static enum MHD_Result http_send_answer(struct exchange *x)
{
    struct services *s = x->h->s;
    if (x->gone || atomic_load_explicit(&s->draining, memory_order_relaxed) ||
        watch_requests(x->slot) >= (uint64_t)s->cfg->requests_per_connection)
        x->close = true;
    struct MHD_Response *m = http_make_response(x);
    if (!m)
        return MHD_NO;
    struct headers h;
    headers_make(&x->res, x->close, &h);
    for (size_t i = 0; i < h.n; i++)
        (void)MHD_add_response_header(m, h.field[i].name, h.field[i].value);
    bool bytes = x->req.method != METHOD_HEAD && x->res.status != 304;
    x->sent = bytes ? x->res.size : 0;
    x->stage = STAGE_SENT;
    watch_phase(x->slot, x->stream ? WATCH_STREAM : WATCH_SEND, s->cfg->write_timeout_s);
    enum MHD_Result ok = MHD_queue_response(x->connection, (unsigned)x->res.status, m);
    MHD_destroy_response(m);
    return ok;
}

static enum MHD_Result http_refuse(struct exchange *x, int status, const char *why)
{
    response_problem(&x->res, status, why);
    x->close = true;
    atomic_fetch_add(&x->h->s->metrics.rejected, status != 503);
    if (status == 503)
        x->res.retry_after_s = 1;
    return http_send_answer(x);
}

/* ---- who asks, and what ---- */

/* The id that a proxy gave, if it is a word of letters, digits and ._-, else one of our own: a
 * number that is never twice the same, scrambled, so that it does not tell how much is asked for
 * (splitmix64). */
static void http_identify(struct exchange *x)
{
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-";
    const char *given = x->req.id;
    size_t n = given ? strlen(given) : 0;
    x->req.id_sent = n && n < sizeof x->id && strspn(given, plain) == n;
    if (x->req.id_sent) {
        memcpy(x->id, given, n + 1);
    } else {
        uint64_t z = x->h->secret.lo +
                     0x9e3779b97f4a7c15u *
                         (atomic_fetch_add_explicit(&x->h->asked, 1, memory_order_relaxed) + 1);
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
static bool http_unbase(struct exchange *x)
{
    const char *base = x->h->s->cfg->base_path, *target = x->target;
    size_t n = x->h->n_base;
    if (!n || !target || strncmp(target, base, n) != 0)
        return false;
    if (target[n] == '/') {
        x->req.target = target + n;
        x->req.target_size -= n;
    }
    return target[n] == '\0' || target[n] == '?';
}

/* ---- the guard ---- */

static enum MHD_Result http_on_field(void *cls, enum MHD_ValueKind kind, const char *name,
                                     size_t n_name, const char *value, size_t n_value)
{
    (void)kind;
    guard_field(cls, name, n_name, value, n_value);
    return MHD_YES;
}

/* Who asks, behind a trusted proxy the one it asks for. */
static uint64_t http_client(const struct exchange *x)
{
    struct http *h = x->h;
    struct address peer = x->peer->address;
    if (x->req.n_forwarded && !address_in(&h->proxies, peer) &&
        !atomic_flag_test_and_set(&h->proxy_told))
        log_warn("http", "requests come through a proxy, and all its clients share one client's "
                         "part; --trusted-proxy ADDRESS tells them apart");
    return address_number(address_client(&h->proxies, peer, x->req.forwarded, x->req.n_forwarded),
                          h->secret);
}

/* What the screen has against this request: 0 or a status. A request that it has not seen is
 * refused as well: then libmicrohttpd reads past it. */
static int http_screened(const struct exchange *x, const char **why)
{
    if (!x->peer)
        return *why = "out of memory", 503;
    if (x->peer->screen.requests < x->number)
        return *why = "this program was linked wrongly: requests come unchecked", 500;
    int status = screen_refused(&x->peer->screen, x->number);
    *why = screen_reason(status);
    return status;
}

/* First handler call: headers are complete. 0 when the request may go on, else the status to refuse
 * with. */
static int http_guard(struct exchange *x, const char *method, const char *version, const char **why)
{
    struct guard g = {.req = &x->req};
    x->req.method = guard_method(method);
    MHD_get_connection_values_n(x->connection, MHD_HEADER_KIND, http_on_field, &g);
    x->req.admin = x->h->side == HTTP_ADMIN;
    http_identify(x);
    x->req.local = guard_local(&g, version) && address_is_loopback(x->peer->address);
    return guard_check(&g, x->h->s->cfg, version, why);
}

/* ---- jobs ---- */

static struct exchange *http_exchange_of(struct job_waiter *w)
{
    return (struct exchange *)(void *)((char *)w - offsetof(struct exchange, waiter));
}

/* The job has ended, on a worker's thread: let the connection's own thread go on. After the resume
 * the exchange may be gone. */
static void http_on_wake(struct job_waiter *w)
{
    struct exchange *x = http_exchange_of(w);
    watch_disarm(x->h->watch, x->slot);
    MHD_resume_connection(x->connection);
}

static void http_on_gone(struct job_waiter *w)
{
    http_exchange_of(w)->gone = true;
    http_on_wake(w);
}

/* Suspended before the job is asked for, so that its end cannot come first. */
static enum MHD_Result http_wait_for_job(struct exchange *x)
{
    struct http *h = x->h;
    struct watch_slot *slot = x->slot; /* outlives the exchange */
    struct work *work = x->res.work;
    x->res.work = NULL;
    x->stage = STAGE_WAIT;
    x->waited = true;
    x->waiter.wake = http_on_wake;
    watch_phase(slot, WATCH_WORK, 0);
    watch_expect(h->watch, slot);
    MHD_suspend_connection(x->connection);
    if (job_submit(h->s->jobs, x->res.cls, work->id, work, http_client(x), x->res.timeout_s,
                   &x->waiter) == ERR_OK)
        watch_arm(h->watch, slot, &x->waiter); /* does nothing when the job has ended already */
    else
        http_on_wake(&x->waiter);
    return MHD_YES;
}

/* ---- streams ---- */

static enum MHD_Result http_begin_stream(struct exchange *x)
{
    struct err e = {0};
    const int waiting = HTTP_STREAM_WAITING;
    enum err_code rc = motion_begin(x->h->s->motion, x->res.stream_of, x->res.stream,
                                    http_client(x), http_on_stream, x, &x->stream, &e);
    if (rc) {
        response_problem(&x->res, rc == ERR_ARG ? 409 : rc == ERR_LIMIT ? 429 : 503, e.msg);
        x->res.retry_after_s = rc == ERR_ARG ? 0 : 10;
        return http_send_answer(x);
    }
    (void)setsockopt(x->peer->fd, IPPROTO_TCP, TCP_NOTSENT_LOWAT, &waiting, sizeof waiting);
    watch_arm_stream(x->h->watch, x->slot, x->stream);
    x->close = true; /* nobody waits for its end to ask for more */
    return http_send_answer(x);
}

/* ---- callbacks ---- */

static void *http_on_target(void *cls, const char *target, struct MHD_Connection *c)
{
    struct http *h = cls;
    struct exchange *x = mem_array(1, sizeof *x);
    if (!x)
        return NULL;
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    size_t n = strlen(target);
    x->h = h;
    x->connection = c;
    x->peer = info ? info->socket_context : NULL;
    x->slot = x->peer ? x->peer->slot : NULL;
    x->number = x->peer ? ++x->peer->requests : 0;
    x->start_s = clock_s();
    x->res.route = ROUTE_NONE;
    x->res.queue_s = -1;
    x->req.target_size = n;
    x->target = n <= (size_t)h->s->cfg->max_target_bytes ? mem_text(target) : NULL;
    x->req.target = x->target;
    watch_phase(x->slot, WATCH_HEADER,
                x->peer && x->peer->over ? HTTP_OVER_S : h->s->cfg->header_timeout_s);
    atomic_fetch_add_explicit(&h->s->metrics.inflight, 1, memory_order_relaxed);
    return x;
}

static enum MHD_Result http_on_head(struct exchange *x, const char *method, const char *version)
{
    struct services *s = x->h->s;
    const char *why;
    x->stage = STAGE_BODY;
    int status = http_screened(x, &why);
    if (!status)
        status = http_guard(x, method, version, &why);
    if (status)
        return http_refuse(x, status, why);
    if (x->peer->over)
        return http_refuse(x, 503, "too many connections are open");
    if (http_unbase(x)) {
        x->res.status = 308;
        x->res.location = mem_array(x->h->n_base + 2, 1);
        x->res.cache_control = "public, max-age=60";
        if (x->res.location)
            sprintf(x->res.location, "%s/", x->h->s->cfg->base_path);
        return http_send_answer(x);
    }
    if (x->req.method != METHOD_GET && x->req.method != METHOD_HEAD)
        watch_phase(x->slot, WATCH_BODY, s->cfg->body_timeout_s);
    return MHD_YES;
}

static enum MHD_Result http_on_request(void *cls, struct MHD_Connection *c, const char *url,
                                       const char *method, const char *version, const char *upload,
                                       size_t *n_upload, void **con_cls)
{
    struct http *h = cls;
    struct exchange *x = *con_cls;
    size_t limit = (size_t)h->s->cfg->max_body_kb << 10;
    (void)c, (void)url;
    if (!x)
        return MHD_NO; /* out of memory */
    if (x->stage == STAGE_HEAD)
        return http_on_head(x, method, version);
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
        route_finish(h->s, &x->req, &x->waiter.result, &x->res);
        return http_send_answer(x);
    }
    const char *why;
    int status = http_screened(x, &why); /* the body may have been malformed */
    if (status)
        return http_refuse(x, status, why);
    if (x->too_large)
        return http_refuse(x, 413, "the body is too large");
    if (x->body.failed)
        return http_refuse(x, 503, "out of memory");
    x->req.body = x->body.data;
    x->req.body_size = x->body.size;
    route_answer(h->s, &x->req, &x->res);
    if (x->res.stream[0])
        return http_begin_stream(x);
    return x->res.work ? http_wait_for_job(x) : http_send_answer(x);
}

/* The client's address, as --log-clients has it: what names a person need not be kept. */
static void http_client_text(const struct exchange *x, char *out, size_t room)
{
    const struct server_config *cfg = x->h->s->cfg;
    enum { FULL, NETWORK };
    snprintf(out, room, "-");
    if (!x->peer || cfg->log_clients > NETWORK)
        return;
    struct address a =
        address_client(&x->h->proxies, x->peer->address, x->req.forwarded, x->req.n_forwarded);
    address_write(cfg->log_clients == FULL ? a : address_network(a), out, room);
}

static void http_log_access(const struct exchange *x, int status, double seconds)
{
    char client[ADDRESS_TEXT];
    http_client_text(x, client, sizeof client);
    const struct access_line line = {
        .method = guard_method_name(x->req.method),
        .route = target_path(x->res.route),
        /* a target that names no route may hold anything: it is not repeated */
        .target = x->res.route == ROUTE_NONE ? "-" : x->target,
        .client = client,
        .id = x->id[0] ? x->id : "-",
        .cache = x->res.cache,
        .referer = x->req.referer,
        .agent = x->req.agent,
        .status = status,
        .bytes = x->sent,
        .seconds = seconds,
        .job_s = x->res.run_s,
    };
    access_add(x->h->s->access, &line);
}

/* Cameras of a stream come many times a second: those that were taken are counted, not logged. */
static bool http_is_logged(const struct exchange *x, int status)
{
    return x->h->s->access && !(x->res.route == ROUTE_MOTION && status == 204);
}

static void http_on_completed(void *cls, struct MHD_Connection *c, void **con_cls,
                              enum MHD_RequestTerminationCode how)
{
    struct http *h = cls;
    struct exchange *x = *con_cls;
    (void)c;
    *con_cls = NULL;
    if (!x)
        return;
    bool whole = how == MHD_REQUEST_TERMINATED_COMPLETED_OK && !x->gone;
    int status = whole ? x->res.status : 499; /* by custom: the client left */
    double seconds = clock_s() - x->start_s;
    if (!whole)
        atomic_fetch_add(&h->s->metrics.client_aborts, 1);
    metrics_request(&h->s->metrics, x->res.route, status, seconds, whole ? x->sent : 0);
    if (http_is_logged(x, status))
        http_log_access(x, status, seconds);
    if (x->stream) {
        watch_disarm(h->watch, x->slot);
        motion_leave(&x->stream);
    }
    watch_phase(x->slot, WATCH_IDLE, h->s->cfg->idle_timeout_s);
    atomic_fetch_sub_explicit(&h->s->metrics.inflight, 1, memory_order_relaxed);
    body_drop(&x->waiter.result.body);
    response_free(&x->res);
    buf_free(&x->body);
    mem_free(x->target);
    mem_free(x);
}

static struct peer *http_peer(struct http *h, int fd, const struct sockaddr *address)
{
    const struct server_config *cfg = h->s->cfg;
    struct peer *p = mem_array(1, sizeof *p);
    if (!p)
        return NULL;
    p->fd = fd;
    p->address = address_of_socket(address);
    bool unlimited = h->side == HTTP_ADMIN || address_in(&h->proxies, p->address);
    size_t limit = unlimited ? 0 : (size_t)cfg->per_ip_connections;
    p->slot = watch_add(h->watch, fd, address_number(p->address, h->secret), limit, &p->over);
    struct tls *tls = h->side == HTTP_PUBLIC ? h->s->tls : NULL;
    if (screen_attach(&p->screen, fd, tls, (size_t)cfg->max_header_kb << 10, NULL)) {
        watch_remove(h->watch, p->slot);
        mem_free(p);
        return NULL;
    }
    watch_phase(p->slot, WATCH_HEADER, p->over ? HTTP_OVER_S : cfg->header_timeout_s);
    return p;
}

static void http_on_connection(void *cls, struct MHD_Connection *c, void **context,
                               enum MHD_ConnectionNotificationCode what)
{
    struct http *h = cls;
    if (what == MHD_CONNECTION_NOTIFY_CLOSED) {
        struct peer *p = *context;
        *context = NULL;
        if (p) {
            watch_remove(h->watch, p->slot);
            screen_detach(&p->screen, p->fd);
            mem_free(p);
        }
        atomic_fetch_sub_explicit(&h->s->metrics.connections, 1, memory_order_relaxed);
        atomic_fetch_sub_explicit(&h->open, 1, memory_order_release);
        return;
    }
    const union MHD_ConnectionInfo *fd =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CONNECTION_FD);
    const union MHD_ConnectionInfo *address =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
    *context = fd && address ? http_peer(h, fd->connect_fd, address->client_addr) : NULL;
    atomic_fetch_add_explicit(&h->s->metrics.connections, 1, memory_order_relaxed);
    atomic_fetch_add_explicit(&h->open, 1, memory_order_relaxed);
}

static size_t http_keep_escapes(void *cls, struct MHD_Connection *c, char *text)
{
    (void)cls, (void)c;
    return strlen(text);
}

static void http_on_log(void *cls, const char *fmt, va_list args) ERR_PRINTF(2, 0);
static void http_on_log(void *cls, const char *fmt, va_list args)
{
    char text[256];
    (void)cls;
    vsnprintf(text, sizeof text, fmt, args);
    text[strcspn(text, "\r\n")] = 0;
    log_debug("http", "%s", text);
}

/* ---- listening ---- */

static size_t http_connections(const struct http *h)
{
    return h->side == HTTP_ADMIN ? HTTP_ADMIN_CONNECTIONS : (size_t)h->s->cfg->max_connections;
}

/* libmicrohttpd stops accepting at its own limit and answers nothing, so ours is half of it. */
size_t http_descriptors(size_t max_connections)
{
    return 2 * max_connections + HTTP_SPARE;
}

static enum err_code http_start_daemon(struct http *h, int fd, struct err *e)
{
    const struct server_config *cfg = h->s->cfg;
    unsigned threads = (unsigned)cfg->http_threads;
    unsigned most = (unsigned)http_connections(h);
    if (h->side == HTTP_ADMIN)
        threads = 1;
    else if (!threads)
        threads = pool_cores() < HTTP_THREADS_MAX ? (unsigned)pool_cores() : HTTP_THREADS_MAX;
    struct MHD_OptionItem options[] = {
        {MHD_OPTION_LISTEN_SOCKET, fd, NULL},
        {MHD_OPTION_CONNECTION_LIMIT, (intptr_t)http_descriptors(most), NULL},
        {MHD_OPTION_CONNECTION_TIMEOUT, (intptr_t)(cfg->idle_timeout_s + cfg->write_timeout_s) + 1,
         NULL},
        {MHD_OPTION_CONNECTION_MEMORY_LIMIT, cfg->max_header_kb << 10, NULL},
        {MHD_OPTION_CONNECTION_MEMORY_INCREMENT, 1024, NULL},
        {MHD_OPTION_STRICT_FOR_CLIENT, 0, NULL},
        {MHD_OPTION_NOTIFY_COMPLETED, (intptr_t)http_on_completed, h},
        {MHD_OPTION_NOTIFY_CONNECTION, (intptr_t)http_on_connection, h},
        {MHD_OPTION_URI_LOG_CALLBACK, (intptr_t)http_on_target, h},
        {MHD_OPTION_UNESCAPE_CALLBACK, (intptr_t)http_keep_escapes, h},
        {MHD_OPTION_END, 0, NULL},
        {MHD_OPTION_END, 0, NULL},
        {MHD_OPTION_END, 0, NULL},
        {MHD_OPTION_END, 0, NULL},
    };
    size_t n = sizeof options / sizeof *options - 4;
    const bool tls = h->s->tls && h->side == HTTP_PUBLIC;
    static char priorities[] = TLS_PRIORITIES;
    if (threads > 1)
        options[n++] = (struct MHD_OptionItem){MHD_OPTION_THREAD_POOL_SIZE, threads, NULL};
    if (tls) {
        options[n++] = (struct MHD_OptionItem){MHD_OPTION_HTTPS_CERT_CALLBACK, 0,
                                               (void *)(intptr_t)tls_certificate};
        options[n++] = (struct MHD_OptionItem){MHD_OPTION_HTTPS_PRIORITIES, 0, priorities};
    }
    h->daemon = MHD_start_daemon(MHD_USE_EPOLL_INTERNAL_THREAD | MHD_ALLOW_SUSPEND_RESUME |
                                     MHD_USE_ERROR_LOG | (tls ? MHD_USE_TLS : 0),
                                 0, NULL, NULL, http_on_request, h, MHD_OPTION_EXTERNAL_LOGGER,
                                 http_on_log, NULL, MHD_OPTION_ARRAY, options, MHD_OPTION_END);
    if (!h->daemon)
        return err_set(e, ERR_IO,
                       "the HTTP threads did not start; --http-threads 1 needs fewest resources");
    return ERR_OK;
}

static enum err_code http_listen(struct http *h, struct err *e)
{
    const struct server_config *cfg = h->s->cfg;
    bool admin = h->side == HTTP_ADMIN;
    int held = supervisor_socket(admin ? "admin" : NULL);
    if (held >= 0) {
        h->held = true;
        h->fd = held;
        return listen_take(held, &h->port, e);
    }
    if (admin)
        return listen_open_at(cfg->admin, "--admin", &h->fd, &h->port, e);
    return listen_open(cfg->address, (int)cfg->port, LISTEN_PORT, &h->fd, &h->port, e);
}

/* "/splats" or nothing. */
static enum err_code http_check_base(const char *base, size_t *n, struct err *e)
{
    *n = base ? strlen(base) : 0;
    bool ok = !*n || (base[0] == '/' && *n > 1 && *n < 128 && base[*n - 1] != '/' &&
                      !strstr(base, "//") && !strstr(base, "/.") &&
                      !base[strspn(base, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                                         "0123456789/_.-")]);
    return ok ? ERR_OK
              : err_set(e, ERR_ARG,
                        "--base-path %.60s: a path that begins with / and does not end with it",
                        base);
}

enum err_code http_check(const struct server_config *cfg, struct err *e)
{
    struct address_nets nets;
    size_t n;
    enum err_code rc = address_read_nets(cfg->trusted_proxy, &nets, e);
    return !rc ? http_check_base(cfg->base_path, &n, e) : rc;
}

enum err_code http_open(struct services *s, enum http_side side, struct http **out, struct err *e)
{
    struct http *h = mem_array(1, sizeof *h);
    *out = h;
    if (!h)
        return err_set(e, ERR_MEM, "http: out of memory");
    h->s = s;
    h->side = side;
    atomic_flag_clear(&h->proxy_told);
    enum err_code rc = address_read_nets(s->cfg->trusted_proxy, &h->proxies, e);
    if (!rc && getrandom(&h->secret, sizeof h->secret, 0) != sizeof h->secret)
        rc = err_errno(e, ERR_IO, "the system has no random numbers");
    if (!rc)
        rc = http_check_base(s->cfg->base_path, &h->n_base, e);
    if (!rc)
        rc = http_listen(h, e);
    if (rc) {
        mem_free(h);
        *out = NULL;
    }
    return rc;
}

enum err_code http_start(struct http *h, struct err *e)
{
    enum err_code rc = watch_open(http_connections(h), h->s, http_on_gone, &h->watch, e);
    return !rc ? http_start_daemon(h, h->fd, e) : rc;
}

uint16_t http_port(const struct http *h)
{
    return h->port;
}

/* ---- draining ---- */

static void http_pause_ms(long ms)
{
    const struct timespec t = {.tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000};
    nanosleep(&t, NULL);
}

/* Until all connections have ended, or this much time has passed. */
static void http_await_end(struct http *h, double wait_s)
{
    double end_s = clock_s() + wait_s;
    while (atomic_load(&h->open) > 0 && clock_s() < end_s) {
        watch_stop_idle(h->watch);
        http_pause_ms(10);
    }
}

void http_close(struct http **out)
{
    struct http *h = *out;
    *out = NULL;
    if (!h)
        return;
    struct services *s = h->s;
    if (!h->daemon) { /* never started */
        close(h->fd);
        watch_close(&h->watch);
        mem_free(h);
        return;
    }
    bool first = !atomic_exchange(&s->draining, true);
    for (double end_s = clock_s() + s->cfg->drain_delay_s; first && clock_s() < end_s;)
        http_pause_ms(20);
    /* From here on nobody accepts. The descriptor is closed when libmicrohttpd's threads, which may
     * still look at it, have ended; clients are turned away at once, unless the socket is a
     * supervisor's, whose next server takes them. */
    int fd = MHD_quiesce_daemon(h->daemon);
    if (fd >= 0 && !h->held)
        (void)shutdown(fd, SHUT_RDWR);
    motion_stop(s->motion);
    http_await_end(h, s->cfg->drain_timeout_s);
    /* Wakes whoever still waits: libmicrohttpd aborts on suspended connections. */
    job_stop(s->jobs);
    http_await_end(h, 2);
    MHD_stop_daemon(h->daemon);
    if (fd >= 0)
        close(fd);
    watch_close(&h->watch);
    mem_free(h);
}
