/* A request's life: on_target (the raw target is kept: the one that libmicrohttpd hands out later
 * is decoded and cut at NUL) -> first handler call (guard) -> body calls -> last call
 * (dispatch_answer; sent at once, or suspended behind a job) -> after resume one more call
 * (dispatch_finish, sent) -> on_completed (log, metrics). A request for a name that another server
 * may keep is suspended until the names were read, and then answered once more.
 *
 * Requests of a connection come one after the other, so each lies in its connection's peer: an
 * allocation a request would be a tenth of what a tile in memory costs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/exchange.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>

#include "core/trace.h"
#include "server/dispatch.h"
#include "server/guard.h"
#include "server/link.h"
#include "server/motion.h"
#include "server/router.h"
#include "server/screen.h"

/* Of a stream: what libmicrohttpd asks for at once, and what may wait in the socket, so that a
 * picture that is drawn next is of the camera of now and not of that many bytes ago. */
enum {
    EXCHANGE_STREAM_BLOCK = 16 << 10,
    EXCHANGE_STREAM_WAITING = 16 << 10,
    EXCHANGE_VIDEO_WAITING = 4 << 10
};
enum { EXCHANGE_AUTHORITY = 256 }; /* of a target in absolute form */
enum { EXCHANGE_ID_MAX = 65, EXCHANGE_TARGET = 192 /* longer ones are allocated */ };
static const double EXCHANGE_OVER_S = 1; /* for the request of a connection too many */

enum stage { STAGE_HEAD, STAGE_BODY, STAGE_NAMES, STAGE_WAIT, STAGE_SENT };

struct exchange { /* one request and its answer */
    struct front *f;
    struct MHD_Connection *connection;
    struct peer *peer;       /* NULL: out of memory, and this was allocated */
    struct watch_slot *slot; /* of the peer */
    uint64_t number;         /* of the connection's requests, from 1 */
    char *target;            /* NULL: too long, or out of memory */
    char target_text[EXCHANGE_TARGET];
    char id[EXCHANGE_ID_MAX], authority[EXCHANGE_AUTHORITY];
    double start_s;
    enum stage stage;
    struct request req;
    struct response res;
    struct job_waiter waiter;
    struct kept_waiter names;
    struct motion_stream *stream; /* NULL: none */
    struct buf body;
    bool too_large, close, gone;
    uint64_t sent;
};

struct peer { /* one connection; made and freed by on_connection */
    struct watch_slot *slot;
    struct address address;
    bool over; /* one too many: its request is answered 503 */
    int fd;
    uint64_t requests; /* that libmicrohttpd has begun */
    struct screen screen;
    struct exchange now; /* the request under way */
};

/* ---- the answer ---- */

/* The reader of a stream; suspended while there is nothing to send. */
static ssize_t exchange_read_stream(void *cls, uint64_t at, char *out, size_t room)
{
    struct exchange *x = cls;
    (void)at;
    ssize_t n = motion_read(x->stream, out, room);
    if (n < 0)
        return MHD_CONTENT_READER_END_OF_STREAM;
    x->sent += (uint64_t)n;
    watch_phase(x->slot, WATCH_STREAM, n ? x->f->s->cfg->write_timeout_s : 0);
    if (!n) { /* suspended first, so that the end of a picture cannot come before it */
        MHD_suspend_connection(x->connection);
        if (!motion_await(x->stream))
            MHD_resume_connection(x->connection);
    }
    return n;
}

static void exchange_on_stream(void *user)
{
    MHD_resume_connection(((struct exchange *)user)->connection);
}

static enum MHD_Result exchange_send_answer(struct exchange *x)
{
    struct services *s = x->f->s;
    if (x->gone || atomic_load_explicit(&s->draining, memory_order_relaxed) ||
        watch_requests(x->slot) >= (uint64_t)s->cfg->requests_per_connection)
        x->close = true;
    bool bytes = x->req.method != METHOD_HEAD && x->res.status != 304;
    x->sent = bytes ? x->res.size : 0;
    x->stage = STAGE_SENT;
    watch_phase(x->slot, x->stream ? WATCH_STREAM : WATCH_SEND, s->cfg->write_timeout_s);
    bool ok = x->stream ? reply_stream(x->connection, &x->res, EXCHANGE_STREAM_BLOCK,
                                       exchange_read_stream, x)
                        : reply_send(x->f->replies, x->connection, &x->res, x->close);
    return ok ? MHD_YES : MHD_NO;
}

static enum MHD_Result exchange_refuse(struct exchange *x, int status, const char *why)
{
    response_problem(&x->res, status, why);
    x->close = true;
    atomic_fetch_add(&x->f->s->metrics.rejected, status != 503);
    if (status == 503)
        x->res.retry_after_s = 1;
    return exchange_send_answer(x);
}

/* ---- who asks, and what ---- */

/* The id that a proxy gave, if it is a word of letters, digits and ._-, else one of our own: a
 * number that is never twice the same, scrambled, so that it does not tell how much is asked for
 * (splitmix64). */
static void exchange_identify(struct exchange *x)
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
static bool exchange_unbase(struct exchange *x)
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

static enum MHD_Result exchange_on_field(void *cls, enum MHD_ValueKind kind, const char *name,
                                         size_t n_name, const char *value, size_t n_value)
{
    (void)kind;
    guard_field(cls, name, n_name, value, n_value);
    return MHD_YES;
}

/* Who asks for work, behind a trusted proxy the one it asks for. */
static uint64_t exchange_client(const struct exchange *x)
{
    struct front *f = x->f;
    struct address peer = x->peer->address;
    if (x->req.n_forwarded && !address_in(&f->proxies, peer) &&
        !atomic_flag_test_and_set(&f->proxy_told))
        log_warn("http", "requests come through a proxy, and all its clients share one client's "
                         "part; --trusted-proxy ADDRESS tells them apart");
    peer = address_client(&f->proxies, peer, x->req.forwarded, x->req.n_forwarded);
    return address_number(crowd_client(f->crowd, peer, clock_s()), f->secret);
}

/* What the screen has against this request: 0 or a status. A request that it has not seen is
 * refused as well: then libmicrohttpd reads past it. */
static int exchange_screened(const struct exchange *x, const char **why)
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
static int exchange_guard(struct exchange *x, const char *method, const char *version,
                          const char **why)
{
    struct guard g = {.req = &x->req};
    x->req.method = guard_method(method);
    MHD_get_connection_values_n(x->connection, MHD_HEADER_KIND, exchange_on_field, &g);
    if (x->authority[0])
        guard_authority(&g, x->authority);
    x->req.admin = x->f->admin;
    x->req.trusted = address_in(&x->f->proxies, x->peer->address);
    x->req.proxied |= !strcmp(version, "HTTP/1.0"); /* nginx speaks it to what is behind it */
    exchange_identify(x);
    x->req.local = guard_local(&g, version) && address_is_loopback(x->peer->address);
    return guard_check(&g, x->f->s->cfg, version, why);
}

/* ---- jobs ---- */

static struct exchange *exchange_of_waiter(struct job_waiter *w)
{
    return (struct exchange *)(void *)((char *)w - offsetof(struct exchange, waiter));
}

/* The job has ended, on a worker's thread: let the connection's own thread go on. After the resume
 * the exchange may be gone. */
static void exchange_on_wake(struct job_waiter *w)
{
    struct exchange *x = exchange_of_waiter(w);
    watch_disarm(x->f->watch, x->slot);
    MHD_resume_connection(x->connection);
}

void exchange_on_gone(struct job_waiter *w)
{
    exchange_of_waiter(w)->gone = true;
    exchange_on_wake(w);
}

/* Suspended before the job is asked for, so that its end cannot come first. */
static enum MHD_Result exchange_wait_for_job(struct exchange *x)
{
    struct front *f = x->f;
    struct watch_slot *slot = x->slot; /* outlives the exchange */
    struct work *work = x->res.work;
    x->res.work = NULL;
    x->stage = STAGE_WAIT;
    x->waiter.wake = exchange_on_wake;
    watch_phase(slot, WATCH_WORK, 0);
    watch_expect(f->watch, slot);
    MHD_suspend_connection(x->connection);
    if (job_submit(f->s->jobs, x->res.cls, work->id, work, exchange_client(x), x->res.timeout_s,
                   &x->waiter) == ERR_OK)
        watch_arm(f->watch, slot, &x->waiter); /* does nothing when the job has ended already */
    else
        exchange_on_wake(&x->waiter);
    return MHD_YES;
}

/* ---- names that another server keeps ---- */

static void exchange_on_names(struct kept_waiter *w)
{
    struct exchange *x = (struct exchange *)(void *)((char *)w - offsetof(struct exchange, names));
    MHD_resume_connection(x->connection);
}

/* Suspended first, as for a job. A client that leaves is noticed when the names have come, which
 * takes two seconds at most. */
static enum MHD_Result exchange_wait_for_names(struct exchange *x)
{
    x->stage = STAGE_NAMES;
    x->names = (struct kept_waiter){.wake = exchange_on_names, .failed = true};
    watch_phase(x->slot, WATCH_WORK, 0);
    MHD_suspend_connection(x->connection);
    if (!kept_await(x->f->s->kept, &x->names))
        MHD_resume_connection(x->connection);
    return MHD_YES;
}

/* ---- streams ---- */

static enum MHD_Result exchange_begin_stream(struct exchange *x)
{
    struct err e = {0};
    const int waiting = x->res.video ? EXCHANGE_VIDEO_WAITING : EXCHANGE_STREAM_WAITING;
    const struct motion_reader reader = {.ds = x->res.stream_of,
                                         .name = x->res.stream,
                                         .client = exchange_client(x),
                                         .video = x->res.video,
                                         .ready = exchange_on_stream,
                                         .user = x};
    enum err_code rc = motion_begin(x->f->s->motion, &reader, &x->stream, &e);
    if (rc) {
        response_problem(&x->res, rc == ERR_ARG ? 409 : rc == ERR_LIMIT ? 429 : 503, e.msg);
        x->res.retry_after_s = rc == ERR_ARG ? 0 : 10;
        return exchange_send_answer(x);
    }
    (void)setsockopt(x->peer->fd, IPPROTO_TCP, TCP_NOTSENT_LOWAT, &waiting, sizeof waiting);
    watch_arm_stream(x->f->watch, x->slot, x->stream);
    x->close = true; /* nobody waits for its end to ask for more */
    return exchange_send_answer(x);
}

/* ---- the answer, or what it waits for ---- */

static enum MHD_Result exchange_answer(struct exchange *x)
{
    struct services *s = x->f->s;
    dispatch_answer(s, &x->req, &x->res);
    if (x->res.unknown_name && !x->req.renewed && kept_is_shared(s->kept))
        return exchange_wait_for_names(x);
    if (x->res.stream[0])
        return exchange_begin_stream(x);
    return x->res.work ? exchange_wait_for_job(x) : exchange_send_answer(x);
}

/* The names were read, or could not be: then it is not known whether there is this one. */
static enum MHD_Result exchange_answer_again(struct exchange *x)
{
    x->req.renewed = true;
    if (!x->names.failed) {
        response_free(&x->res);
        return exchange_answer(x);
    }
    response_problem(&x->res, 503,
                     "it is not known whether there is an appearance of this name: the server "
                     "that keeps the names does not answer now");
    x->res.cache_control = RESPONSE_NO_STORE;
    x->res.retry_after_s = 1;
    return exchange_send_answer(x);
}

/* ---- callbacks ---- */

/* Zeroed; NULL when out of memory. */
static struct exchange *exchange_begin(struct peer *p)
{
    if (!p)
        return mem_array(1, sizeof(struct exchange));
    memset(&p->now, 0, sizeof p->now);
    return &p->now;
}

/* A target in absolute form, as proxies get it (RFC 9112, section 3.2.2): its authority counts, and
 * not Host. Another form is left for the guard to refuse. */
static void exchange_take_authority(struct exchange *x)
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

static void exchange_take_target(struct exchange *x, const char *target)
{
    size_t n = strlen(target);
    if (n < sizeof x->target_text)
        x->target = memcpy(x->target_text, target, n + 1);
    else if (n <= (size_t)x->f->s->cfg->max_target_bytes)
        x->target = mem_text(target);
    x->req.target = x->target;
    x->req.target_size = n;
    if (x->target && n && x->target[0] != '/')
        exchange_take_authority(x);
    if (x->target && n)
        x->req.target_size = router_unescape(x->target + (x->req.target - x->target));
}

void *exchange_on_target(void *cls, const char *target, struct MHD_Connection *c)
{
    struct front *f = cls;
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    struct peer *p = info ? info->socket_context : NULL;
    struct exchange *x = exchange_begin(p);
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
    exchange_take_target(x, target);
    watch_phase_at(x->slot, WATCH_HEADER,
                   p && p->over ? EXCHANGE_OVER_S : f->s->cfg->header_timeout_s, x->start_s);
    atomic_fetch_add_explicit(&f->s->metrics.inflight, 1, memory_order_relaxed);
    return x;
}

static enum MHD_Result exchange_on_head(struct exchange *x, const char *method, const char *version)
{
    struct services *s = x->f->s;
    const char *why;
    x->stage = STAGE_BODY;
    int status = exchange_screened(x, &why);
    if (!status)
        status = exchange_guard(x, method, version, &why);
    if (status)
        return exchange_refuse(x, status, why);
    if (x->peer->over)
        return exchange_refuse(x, 503, "too many connections are open");
    if (exchange_unbase(x)) {
        x->res.status = 308;
        x->res.location = mem_array(x->f->n_base + 2, 1);
        x->res.cache_control = "public, max-age=60";
        if (x->res.location)
            sprintf(x->res.location, "%s/", x->f->s->cfg->base_path);
        return exchange_send_answer(x);
    }
    if (x->req.method != METHOD_GET && x->req.method != METHOD_HEAD)
        watch_phase(x->slot, WATCH_BODY, s->cfg->body_timeout_s);
    return MHD_YES;
}

enum MHD_Result exchange_on_request(void *cls, struct MHD_Connection *c, const char *url,
                                    const char *method, const char *version, const char *upload,
                                    size_t *n_upload, void **con_cls)
{
    struct front *f = cls;
    struct exchange *x = *con_cls;
    size_t limit = (size_t)f->s->cfg->max_body_kb << 10;
    (void)c, (void)url;
    if (!x)
        return MHD_NO; /* out of memory */
    if (x->stage == STAGE_HEAD)
        return exchange_on_head(x, method, version);
    if (x->stage == STAGE_BODY && *n_upload) {
        x->too_large |= x->body.size + *n_upload > limit;
        if (!x->too_large)
            buf_add(&x->body, upload, *n_upload);
        *n_upload = 0;
        return MHD_YES;
    }
    if (x->stage == STAGE_SENT)
        return MHD_YES;
    if (x->stage == STAGE_NAMES)
        return exchange_answer_again(x);
    if (x->stage == STAGE_WAIT) {
        dispatch_finish(f->s, &x->req, &x->waiter.result, &x->res);
        return exchange_send_answer(x);
    }
    const char *why;
    int status = exchange_screened(x, &why); /* the body may have been malformed */
    if (status)
        return exchange_refuse(x, status, why);
    if (x->too_large)
        return exchange_refuse(x, 413, "the body is too large");
    if (x->body.failed)
        return exchange_refuse(x, 503, "out of memory");
    x->req.body = x->body.data;
    x->req.body_size = x->body.size;
    return exchange_answer(x);
}

/* The client's address, as --log-clients has it: what names a person need not be kept. */
static void exchange_client_text(const struct exchange *x, char *out, size_t room)
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

static void exchange_log_access(const struct exchange *x, int status, double seconds)
{
    char client[ADDRESS_TEXT], target[ACCESS_TARGET], referer[ACCESS_TARGET];
    exchange_client_text(x, client, sizeof client);
    const struct access_line line = {
        .method = guard_method_name(x->req.method),
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
    access_add(x->f->s->access, &line);
}

void exchange_on_completed(void *cls, struct MHD_Connection *c, void **con_cls,
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
    if (!whole)
        atomic_fetch_add(&f->s->metrics.client_aborts, 1);
    metrics_request(&f->s->metrics, router_index(f->s->routes, x->res.route), status, seconds,
                    whole ? x->sent : 0);
    trace_overlap("requests", route_path(x->res.route), x->start_s, now_s);
    if (f->s->access && !(whole && x->res.unlogged))
        exchange_log_access(x, status, seconds);
    if (x->stream) {
        watch_disarm(f->watch, x->slot);
        motion_leave(&x->stream);
    }
    watch_phase_at(x->slot, WATCH_IDLE, f->s->cfg->idle_timeout_s, now_s);
    atomic_fetch_sub_explicit(&f->s->metrics.inflight, 1, memory_order_relaxed);
    body_drop(&x->waiter.result.body);
    response_free(&x->res);
    buf_free(&x->body);
    if (x->target != x->target_text)
        mem_free(x->target);
    if (!x->peer)
        mem_free(x);
}

static struct peer *exchange_peer(struct front *f, int fd, const struct sockaddr *address)
{
    const struct server_config *cfg = f->s->cfg;
    struct peer *p = mem_array(1, sizeof *p);
    if (!p)
        return NULL;
    p->fd = fd;
    p->address = address_of_socket(address);
    bool unlimited = f->admin || address_in(&f->proxies, p->address);
    size_t limit = unlimited ? 0 : (size_t)cfg->per_ip_connections;
    p->slot = watch_add(f->watch, fd, address_number(p->address, f->secret), limit, &p->over);
    struct tls *tls = !f->admin ? f->s->tls : NULL;
    if (screen_attach(&p->screen, fd, tls, (size_t)cfg->max_header_kb << 10, NULL)) {
        watch_remove(f->watch, p->slot);
        mem_free(p);
        return NULL;
    }
    watch_phase(p->slot, WATCH_HEADER, p->over ? EXCHANGE_OVER_S : cfg->header_timeout_s);
    return p;
}

void exchange_on_connection(void *cls, struct MHD_Connection *c, void **context,
                            enum MHD_ConnectionNotificationCode what)
{
    struct front *f = cls;
    if (what == MHD_CONNECTION_NOTIFY_CLOSED) {
        struct peer *p = *context;
        *context = NULL;
        if (p) {
            watch_remove(f->watch, p->slot);
            screen_detach(&p->screen, p->fd);
            mem_free(p);
        }
        atomic_fetch_sub_explicit(&f->s->metrics.connections, 1, memory_order_relaxed);
        atomic_fetch_sub_explicit(&f->open, 1, memory_order_release);
        return;
    }
    const union MHD_ConnectionInfo *fd =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CONNECTION_FD);
    const union MHD_ConnectionInfo *address =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
    *context = fd && address ? exchange_peer(f, fd->connect_fd, address->client_addr) : NULL;
    atomic_fetch_add_explicit(&f->s->metrics.connections, 1, memory_order_relaxed);
    atomic_fetch_add_explicit(&f->open, 1, memory_order_relaxed);
}
