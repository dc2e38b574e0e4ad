/* libmicrohttpd and nothing else: its requests become struct request, our responses become its own.
 * The only file that includes microhttpd.h.
 *
 * A request's life: URI_LOG (exchange made, raw target copied: the one libmicrohttpd hands out
 * later is decoded and cut at NUL) -> first handler call (guard) -> body calls -> last call
 * (route_answer; sent at once, or suspended behind a job) -> after resume one more call
 * (route_finish, sent) -> COMPLETED (log, metrics, exchange freed).
 *
 * The guard refuses what version 0.9.75 lets through and a proxy in front might read in another
 * way: both Content-Length and Transfer-Encoding, or two of one, a transfer coding other than
 * chunked, two Hosts, control bytes, targets that are not a path, methods nobody defined. Such a
 * request gets a 4xx or 501 and the connection is closed (RFC 9112, sections 3.2, 6.1, 6.3, 11.2).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <arpa/inet.h>
#include <errno.h>
#include <microhttpd.h>
#include <netdb.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <time.h>
#include <unistd.h>

#include "core/pool.h"

enum { FIELDS_MAX = 64, HTTP_THREADS_MAX = 4 };
static const double SEND_BYTES_PER_S = 16384; /* a client slower than this is not waited for */

struct http {
    struct services *s;
    struct MHD_Daemon *daemon;
    struct watch *watch;
    int fd; /* listens; libmicrohttpd's once the daemon runs */
    uint16_t port;
};

enum stage { STAGE_HEAD, STAGE_BODY, STAGE_WAIT, STAGE_SENT };

struct exchange { /* one request and its answer; made by on_target, freed by on_completed */
    struct http *h;
    struct MHD_Connection *connection;
    struct watch_slot *slot;
    char *target;
    double start_s;
    enum stage stage;
    struct request req;
    struct response res;
    struct job_waiter waiter;
    struct buf body;
    bool too_large, close, waited, gone;
    uint64_t sent;
};

/* ---- the answer ---- */

static void add(struct MHD_Response *m, const char *name, const char *value)
{
    if (value && *value)
        (void)MHD_add_response_header(m, name, value);
}

static void add_headers(const struct exchange *x, struct MHD_Response *m)
{
    const struct response *r = &x->res;
    char text[160];
    add(m, "Content-Type", r->type);
    add(m, "Cache-Control", r->cache_control);
    add(m, "ETag", r->etag);
    add(m, "Vary", r->vary);
    add(m, "Content-Encoding", r->encoding);
    add(m, "Allow", r->allow);
    add(m, "Location", r->location);
    add(m, "Surrogate-Key", r->surrogate);
    if (r->accept_ranges)
        add(m, "Accept-Ranges", "bytes");
    if (r->status == 206) {
        snprintf(text, sizeof(text), "bytes %llu-%llu/%llu", (unsigned long long)r->range_first,
                 (unsigned long long)(r->range_first + r->size - 1),
                 (unsigned long long)r->range_total);
        add(m, "Content-Range", text);
    } else if (r->status == 416) {
        snprintf(text, sizeof(text), "bytes */%llu", (unsigned long long)r->range_total);
        add(m, "Content-Range", text);
    }
    if (r->retry_after_s) {
        snprintf(text, sizeof(text), "%d", r->retry_after_s);
        add(m, "Retry-After", text);
    }
    if (r->queue_s >= 0) {
        snprintf(text, sizeof(text), "queue;dur=%.1f, job;dur=%.1f", r->queue_s * 1e3,
                 r->run_s * 1e3);
        add(m, "Server-Timing", text);
    }
    add(m, "Access-Control-Allow-Origin", "*");
    add(m, "X-Content-Type-Options", "nosniff");
    if (r->allow && r->status == 204) { /* preflight */
        add(m, "Access-Control-Allow-Methods", r->allow);
        add(m, "Access-Control-Allow-Headers",
            "Range, If-None-Match, If-Range, Content-Type, Authorization");
        add(m, "Access-Control-Max-Age", "86400");
    } else {
        add(m, "Access-Control-Expose-Headers",
            "ETag, Content-Length, Content-Range, Retry-After, Server-Timing");
        add(m, "Cross-Origin-Resource-Policy", "cross-origin");
        add(m, "Timing-Allow-Origin", "*");
    }
    if (x->close)
        add(m, "Connection", "close");
}

static void drop_body(void *cls)
{
    struct body *b = cls;
    body_drop(&b);
}

static ssize_t no_bytes(void *cls, uint64_t at, char *out, size_t room)
{
    (void)cls, (void)at, (void)out, (void)room;
    return MHD_CONTENT_READER_END_OF_STREAM;
}

/* A 304 without the body at hand must not claim Content-Length: 0 (RFC 9110, section 8.6), which an
 * empty buffer would; a stream of unknown length claims nothing wrong. */
static struct MHD_Response *make_response(struct exchange *x)
{
    struct response *r = &x->res;
    if (r->body && r->data)
        return MHD_create_response_from_buffer_with_free_callback_cls(
            r->size, (void *)(uintptr_t)r->data, drop_body, body_ref(r->body));
    if (r->status == 304)
        return MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, 1024, no_bytes, NULL, NULL);
    return MHD_create_response_from_buffer(0, (void *)(uintptr_t) "", MHD_RESPMEM_PERSISTENT);
}

static enum MHD_Result send_answer(struct exchange *x)
{
    struct services *s = x->h->s;
    if (x->gone || atomic_load_explicit(&s->draining, memory_order_relaxed) ||
        watch_requests(x->slot) >= (uint64_t)s->cfg->requests_per_connection)
        x->close = true;
    struct MHD_Response *m = make_response(x);
    if (!m)
        return MHD_NO;
    add_headers(x, m);
    bool bytes = x->req.method != METHOD_HEAD && x->res.status != 304;
    x->sent = bytes ? x->res.size : 0;
    x->stage = STAGE_SENT;
    watch_phase(x->slot, WATCH_SEND, s->cfg->write_timeout_s + (double)x->sent / SEND_BYTES_PER_S);
    enum MHD_Result ok = MHD_queue_response(x->connection, (unsigned)x->res.status, m);
    MHD_destroy_response(m);
    return ok;
}

static enum MHD_Result refuse(struct exchange *x, int status, const char *why)
{
    route_problem(&x->res, status, why);
    x->close = true;
    atomic_fetch_add(&x->h->s->metrics.rejected, status != 503);
    if (status == 503)
        x->res.retry_after_s = 1;
    return send_answer(x);
}

/* ---- the guard ---- */

struct fields { /* what the guard counts */
    struct exchange *x;
    size_t n, n_length, n_coding, n_host;
    bool bad, coding_bad, proxied;
    uint64_t length;
};

static bool name_is(const char *name, size_t n, const char *want)
{
    return n == strlen(want) && !strncasecmp(name, want, n);
}

static bool clean_name(const char *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)p[i] <= 0x20 || (unsigned char)p[i] >= 0x7f || p[i] == ':')
            return false;
    return n > 0;
}

static bool clean_value(const char *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (((unsigned char)p[i] < 0x20 && p[i] != '\t') || p[i] == 0x7f)
            return false;
    return true;
}

/* Digits only; false for anything else or beyond 2^53. */
static bool read_length(const char *p, size_t n, uint64_t *out)
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
static void keep_field(struct exchange *x, const char *name, size_t n, const char *value)
{
    const struct {
        const char *name;
        const char **to;
    } kept[] = {
        {"Accept", &x->req.accept},
        {"Accept-Encoding", &x->req.accept_encoding},
        {"If-None-Match", &x->req.if_none_match},
        {"If-Range", &x->req.if_range},
        {"Range", &x->req.range},
    };
    for (size_t i = 0; i < sizeof(kept) / sizeof(*kept); i++)
        if (name_is(name, n, kept[i].name) && !*kept[i].to)
            *kept[i].to = value;
    if ((name_is(name, n, "Sec-Purpose") && strstr(value, "prefetch")) ||
        (name_is(name, n, "Priority") && (strstr(value, "u=6") || strstr(value, "u=7"))))
        x->req.prefetch = true;
}

static enum MHD_Result on_field(void *cls, enum MHD_ValueKind kind, const char *name, size_t n_name,
                                const char *value, size_t n_value)
{
    struct fields *f = cls;
    (void)kind;
    value = value ? value : "";
    f->n++;
    if (!clean_name(name, n_name) || !clean_value(value, n_value))
        f->bad = true;
    if (name_is(name, n_name, "Content-Length")) {
        f->n_length++;
        f->bad |= !read_length(value, n_value, &f->length);
    } else if (name_is(name, n_name, "Transfer-Encoding")) {
        f->n_coding++;
        f->coding_bad |= strcasecmp(value, "chunked") != 0;
    } else if (name_is(name, n_name, "Host")) {
        f->n_host++;
    } else if (name_is(name, n_name, "X-Forwarded-For") || name_is(name, n_name, "Forwarded") ||
               name_is(name, n_name, "Via") || name_is(name, n_name, "X-Real-IP")) {
        f->proxied = true;
    } else {
        keep_field(f->x, name, n_name, value);
    }
    return MHD_YES;
}

static enum method read_method(const char *name)
{
    static const struct {
        const char *name;
        enum method method;
    } methods[] = {
        {"GET", METHOD_GET},         {"HEAD", METHOD_HEAD},   {"POST", METHOD_POST},
        {"OPTIONS", METHOD_OPTIONS}, {"PUT", METHOD_OTHER},   {"DELETE", METHOD_OTHER},
        {"PATCH", METHOD_OTHER},     {"TRACE", METHOD_OTHER}, {"CONNECT", METHOD_OTHER},
    };
    for (size_t i = 0; i < sizeof(methods) / sizeof(*methods); i++)
        if (!strcmp(name, methods[i].name))
            return methods[i].method;
    return METHOD_UNKNOWN;
}

static bool is_loopback(struct MHD_Connection *c)
{
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
    const struct sockaddr *a = info ? info->client_addr : NULL;
    if (a && a->sa_family == AF_INET)
        return ntohl(((const struct sockaddr_in *)(const void *)a)->sin_addr.s_addr) >> 24 == 127;
    if (a && a->sa_family == AF_INET6) {
        const struct in6_addr *v6 = &((const struct sockaddr_in6 *)(const void *)a)->sin6_addr;
        return IN6_IS_ADDR_LOOPBACK(v6) || (IN6_IS_ADDR_V4MAPPED(v6) && v6->s6_addr[12] == 127);
    }
    return false;
}

/* First handler call: headers are complete. 0 when the request may go on, else the status to refuse
 * with. */
static int guard(struct exchange *x, const char *method, const char *version, const char **why)
{
    const struct server_config *cfg = x->h->s->cfg;
    struct fields f = {.x = x};
    x->req.method = read_method(method);
    MHD_get_connection_values_n(x->connection, MHD_HEADER_KIND, on_field, &f);
    bool old = !strcmp(version, "HTTP/1.0");
    bool bodyless = x->req.method == METHOD_GET || x->req.method == METHOD_HEAD;
    *why = "the request is malformed";
    if (f.n > FIELDS_MAX)
        return *why = "the request has too many header fields", 431;
    if (!x->target || x->req.target_size > (size_t)cfg->max_target_bytes)
        return *why = "the request target is too long", 414;
    if (f.bad || f.n_length + f.n_coding > 1 || f.n_host > 1 || (!old && f.n_host != 1) ||
        (old && f.n_coding) || x->target[0] != '/')
        return 400;
    if (x->req.method == METHOD_UNKNOWN)
        return *why = "this server does not know the method", 501;
    if (f.coding_bad)
        return *why = "the only transfer coding is chunked", 501;
    if (bodyless && (f.n_coding || (f.n_length && f.length)))
        return *why = "a GET or HEAD has no body", 400;
    if (f.length > (uint64_t)cfg->max_body_kb << 10)
        return *why = "the body is too large", 413;
    x->req.local = !f.proxied && is_loopback(x->connection);
    return 0;
}

/* ---- jobs ---- */

static struct exchange *exchange_of(struct job_waiter *w)
{
    return (struct exchange *)(void *)((char *)w - offsetof(struct exchange, waiter));
}

/* The job has ended, on a worker's thread: let the connection's own thread go on. After the resume
 * the exchange may be gone. */
static void on_wake(struct job_waiter *w)
{
    struct exchange *x = exchange_of(w);
    watch_disarm(x->h->watch, x->slot);
    MHD_resume_connection(x->connection);
}

static void on_gone(struct job_waiter *w)
{
    exchange_of(w)->gone = true;
    on_wake(w);
}

/* Suspended before the job is asked for, so that its end cannot come first. */
static enum MHD_Result wait_for_job(struct exchange *x)
{
    struct http *h = x->h;
    struct watch_slot *slot = x->slot; /* outlives the exchange */
    struct work *work = x->res.work;
    x->res.work = NULL;
    x->stage = STAGE_WAIT;
    x->waited = true;
    x->waiter.wake = on_wake;
    watch_phase(slot, WATCH_WORK, 0);
    watch_expect(h->watch, slot);
    MHD_suspend_connection(x->connection);
    if (job_submit(h->s->jobs, x->res.cls, work->id, work, x->res.timeout_s, &x->waiter) == ERR_OK)
        watch_arm(h->watch, slot, &x->waiter); /* does nothing when the job has ended already */
    else
        on_wake(&x->waiter);
    return MHD_YES;
}

/* ---- callbacks ---- */

static void *on_target(void *cls, const char *target, struct MHD_Connection *c)
{
    struct http *h = cls;
    struct exchange *x = mem_array(1, sizeof(*x));
    if (!x)
        return NULL;
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    size_t n = strlen(target);
    x->h = h;
    x->connection = c;
    x->slot = info ? info->socket_context : NULL;
    x->start_s = clock_s();
    x->res.route = ROUTE_NONE;
    x->res.queue_s = -1;
    x->req.target_size = n;
    x->target = n <= (size_t)h->s->cfg->max_target_bytes ? mem_text(target) : NULL;
    x->req.target = x->target;
    watch_phase(x->slot, WATCH_HEADER, h->s->cfg->header_timeout_s);
    atomic_fetch_add_explicit(&h->s->metrics.inflight, 1, memory_order_relaxed);
    return x;
}

static enum MHD_Result on_head(struct exchange *x, const char *method, const char *version)
{
    struct services *s = x->h->s;
    const char *why;
    x->stage = STAGE_BODY;
    int status = guard(x, method, version, &why);
    if (status)
        return refuse(x, status, why);
    if (atomic_load_explicit(&s->metrics.connections, memory_order_relaxed) >
        (uint64_t)s->cfg->max_connections)
        return refuse(x, 503, "too many connections");
    if (x->req.method != METHOD_GET && x->req.method != METHOD_HEAD)
        watch_phase(x->slot, WATCH_BODY, s->cfg->body_timeout_s);
    return MHD_YES;
}

static enum MHD_Result on_request(void *cls, struct MHD_Connection *c, const char *url,
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
        return on_head(x, method, version);
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
        return send_answer(x);
    }
    if (x->too_large)
        return refuse(x, 413, "the body is too large");
    if (x->body.failed)
        return refuse(x, 503, "out of memory");
    x->req.body = x->body.data;
    x->req.body_size = x->body.size;
    route_answer(h->s, &x->req, &x->res);
    return x->res.work ? wait_for_job(x) : send_answer(x);
}

static void log_access(const struct exchange *x, int status, double seconds)
{
    static const char *const methods[] = {"GET", "HEAD", "POST", "OPTIONS", "OTHER", "UNKNOWN"};
    const struct access_line line = {
        .method = methods[x->req.method],
        /* a target that names no route may hold anything: it is not repeated */
        .target = x->res.route == ROUTE_NONE ? "-" : x->target,
        .cache = x->res.cache,
        .status = status,
        .bytes = x->sent,
        .seconds = seconds,
    };
    access_add(x->h->s->access, &line);
}

static void on_completed(void *cls, struct MHD_Connection *c, void **con_cls,
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
    if (h->s->access)
        log_access(x, status, seconds);
    watch_phase(x->slot, WATCH_IDLE, h->s->cfg->idle_timeout_s);
    atomic_fetch_sub_explicit(&h->s->metrics.inflight, 1, memory_order_relaxed);
    body_drop(&x->waiter.result.body);
    route_free(&x->res);
    buf_free(&x->body);
    mem_free(x->target);
    mem_free(x);
}

static void on_connection(void *cls, struct MHD_Connection *c, void **context,
                          enum MHD_ConnectionNotificationCode what)
{
    struct http *h = cls;
    if (what == MHD_CONNECTION_NOTIFY_CLOSED) {
        watch_remove(h->watch, *context);
        *context = NULL;
        atomic_fetch_sub_explicit(&h->s->metrics.connections, 1, memory_order_relaxed);
        return;
    }
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CONNECTION_FD);
    *context = info ? watch_add(h->watch, info->connect_fd) : NULL;
    watch_phase(*context, WATCH_HEADER, h->s->cfg->header_timeout_s);
    atomic_fetch_add_explicit(&h->s->metrics.connections, 1, memory_order_relaxed);
}

static size_t keep_escapes(void *cls, struct MHD_Connection *c, char *text)
{
    (void)cls, (void)c;
    return strlen(text);
}

static void on_log(void *cls, const char *fmt, va_list args) ERR_PRINTF(2, 0);
static void on_log(void *cls, const char *fmt, va_list args)
{
    char text[256];
    (void)cls;
    vsnprintf(text, sizeof(text), fmt, args);
    text[strcspn(text, "\r\n")] = 0;
    log_debug("http", "%s", text);
}

/* ---- listening ---- */

static enum err_code bind_failed(const struct server_config *cfg, struct err *e)
{
    int port = (int)cfg->port;
    if (errno == EADDRINUSE)
        return err_set(
            e, ERR_BUSY,
            "port %d of %s is in use by another program : choose one with --port N, or --port 0 "
            "for any free one",
            port, cfg->address);
    if (errno == EACCES)
        return err_set(e, ERR_IO,
                       "port %d : only root may listen below 1024 : choose another with --port N",
                       port);
    return err_errno(e, ERR_IO, "cannot listen on %s port %d", cfg->address, port);
}

static enum err_code listen_on(const struct server_config *cfg, int *fd, uint16_t *port,
                               struct err *e)
{
    char service[8];
    struct addrinfo hints = {.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV | AI_PASSIVE,
                             .ai_socktype = SOCK_STREAM};
    struct addrinfo *a = NULL;
    struct sockaddr_storage bound;
    socklen_t n = sizeof(bound);
    const int yes = 1;
    *fd = -1;
    snprintf(service, sizeof(service), "%d", (int)cfg->port);
    if (!cfg->address || getaddrinfo(cfg->address, service, &hints, &a) != 0)
        return err_set(e, ERR_ARG, "--address %s : not an IP address (127.0.0.1, 0.0.0.0, ::1, ::)",
                       cfg->address ? cfg->address : "\"\"");
    enum err_code rc = ERR_OK;
    *fd = socket(a->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (*fd < 0 || setsockopt(*fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes)) != 0 ||
        bind(*fd, a->ai_addr, a->ai_addrlen) != 0 || listen(*fd, 1024) != 0 ||
        getsockname(*fd, (struct sockaddr *)&bound, &n) != 0)
        rc = bind_failed(cfg, e);
    else if (bound.ss_family == AF_INET6)
        *port = ntohs(((struct sockaddr_in6 *)(void *)&bound)->sin6_port);
    else
        *port = ntohs(((struct sockaddr_in *)(void *)&bound)->sin_port);
    freeaddrinfo(a);
    if (rc != ERR_OK && *fd >= 0)
        close(*fd);
    return rc;
}

/* libmicrohttpd stops accepting at its own limit and answers nothing, so ours is half of it. */
static enum err_code start_daemon(struct http *h, int fd, struct err *e)
{
    const struct server_config *cfg = h->s->cfg;
    unsigned threads = (unsigned)cfg->http_threads;
    if (!threads)
        threads = pool_cores() < HTTP_THREADS_MAX ? (unsigned)pool_cores() : HTTP_THREADS_MAX;
    struct MHD_OptionItem options[] = {
        {MHD_OPTION_LISTEN_SOCKET, fd, NULL},
        {MHD_OPTION_CONNECTION_LIMIT, 2 * cfg->max_connections, NULL},
        {MHD_OPTION_PER_IP_CONNECTION_LIMIT, cfg->per_ip_connections, NULL},
        {MHD_OPTION_CONNECTION_TIMEOUT, (intptr_t)(cfg->idle_timeout_s + cfg->write_timeout_s) + 1,
         NULL},
        {MHD_OPTION_CONNECTION_MEMORY_LIMIT, cfg->max_header_kb << 10, NULL},
        {MHD_OPTION_CONNECTION_MEMORY_INCREMENT, 1024, NULL},
        {MHD_OPTION_STRICT_FOR_CLIENT, 0, NULL},
        {MHD_OPTION_NOTIFY_COMPLETED, (intptr_t)on_completed, h},
        {MHD_OPTION_NOTIFY_CONNECTION, (intptr_t)on_connection, h},
        {MHD_OPTION_URI_LOG_CALLBACK, (intptr_t)on_target, h},
        {MHD_OPTION_UNESCAPE_CALLBACK, (intptr_t)keep_escapes, h},
        {threads > 1 ? MHD_OPTION_THREAD_POOL_SIZE : MHD_OPTION_END, threads, NULL},
        {MHD_OPTION_END, 0, NULL},
    };
    h->daemon = MHD_start_daemon(MHD_USE_EPOLL_INTERNAL_THREAD | MHD_ALLOW_SUSPEND_RESUME |
                                     MHD_USE_ERROR_LOG,
                                 0, NULL, NULL, on_request, h, MHD_OPTION_EXTERNAL_LOGGER, on_log,
                                 NULL, MHD_OPTION_ARRAY, options, MHD_OPTION_END);
    if (!h->daemon)
        return err_set(e, ERR_IO,
                       "the HTTP threads did not start; --http-threads 1 needs fewest resources");
    return ERR_OK;
}

enum err_code http_open(struct services *s, struct http **out, struct err *e)
{
    struct http *h = mem_array(1, sizeof(*h));
    *out = h;
    if (!h)
        return err_set(e, ERR_MEM, "http: out of memory");
    h->s = s;
    enum err_code rc = listen_on(s->cfg, &h->fd, &h->port, e);
    if (rc != ERR_OK) {
        mem_free(h);
        *out = NULL;
    }
    return rc;
}

enum err_code http_start(struct http *h, struct err *e)
{
    size_t limit = (size_t)h->s->cfg->max_connections * 2 + 16;
    enum err_code rc = watch_open(limit, h->s, on_gone, &h->watch, e);
    return rc == ERR_OK ? start_daemon(h, h->fd, e) : rc;
}

uint16_t http_port(const struct http *h)
{
    return h->port;
}

/* ---- draining ---- */

static void pause_ms(long ms)
{
    const struct timespec t = {.tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000};
    nanosleep(&t, NULL);
}

static bool still_busy(struct http *h)
{
    return atomic_load(&h->s->metrics.connections) > 0;
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
    atomic_store(&s->draining, true);
    for (double end_s = clock_s() + s->cfg->drain_delay_s; clock_s() < end_s;)
        pause_ms(20);
    int fd = MHD_quiesce_daemon(h->daemon);
    if (fd >= 0)
        close(fd);
    for (double end_s = clock_s() + s->cfg->drain_timeout_s; still_busy(h) && clock_s() < end_s;) {
        watch_stop_idle(h->watch);
        pause_ms(10);
    }
    job_stop(
        s->jobs); /* wakes whoever still waits: libmicrohttpd aborts on suspended connections */
    for (double end_s = clock_s() + 2; still_busy(h) && clock_s() < end_s;) {
        watch_stop_idle(h->watch);
        pause_ms(10);
    }
    MHD_stop_daemon(h->daemon);
    watch_close(&h->watch);
    mem_free(h);
}
