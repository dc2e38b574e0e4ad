/* libmicrohttpd's daemon: listening, its options, draining. mhd_callbacks.c has its callbacks for
 * requests, reply.c makes what it sends. No other file includes microhttpd.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http.h"

#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/pool.h"
#include "server/answers/view_stream.h"
#include "server/http/listen.h"
#include "server/http/request_screen.h"
#include "server/http/supervisor.h"
#include "server/mhd_callbacks.h"

enum { HTTP_ADMIN_CONNECTIONS = 32 };
enum { HTTP_PUBLIC_URL_MAX = 256 };
enum { HTTP_THREADS_MAX = 4, HTTP_SPARE = 64 /* connections: to answer those over the limit */ };

struct http {
    struct front front; /* what its connections share */
    struct MHD_Daemon *daemon;
    int fd;    /* listens; libmicrohttpd's once the daemon runs */
    bool held; /* by a supervisor as well, for the next server */
    uint16_t port;
};

/* ---- libmicrohttpd ---- */

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

/* Version 1.0 refuses by itself what request_screen.c refuses for older ones (malformed.def). */
bool http_is_strict(void)
{
    return atoi(MHD_get_version()) >= 1;
}

const char *http_library(void)
{
    return MHD_get_version();
}

static size_t http_connections(const struct http *h)
{
    return h->front.admin ? HTTP_ADMIN_CONNECTIONS : (size_t)h->front.s->cfg->max_connections;
}

/* libmicrohttpd stops accepting at its own limit and answers nothing, so ours is half of it. */
size_t http_descriptors(size_t max_connections)
{
    return 2 * max_connections + HTTP_SPARE;
}

static enum err_code http_start_daemon(struct http *h, int fd, struct err *e)
{
    const struct server_config *cfg = h->front.s->cfg;
    unsigned threads = (unsigned)cfg->http_threads;
    unsigned most = (unsigned)http_connections(h);
    if (h->front.admin || h->front.self)
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
        {MHD_OPTION_STRICT_FOR_CLIENT, !h->front.screened, NULL},
        {MHD_OPTION_NOTIFY_COMPLETED, (intptr_t)mhd_callbacks_on_completed, &h->front},
        {MHD_OPTION_NOTIFY_CONNECTION, (intptr_t)mhd_callbacks_on_connection, &h->front},
        {MHD_OPTION_URI_LOG_CALLBACK, (intptr_t)mhd_callbacks_on_target, &h->front},
        {MHD_OPTION_UNESCAPE_CALLBACK, (intptr_t)http_keep_escapes, h},
        {MHD_OPTION_END, 0, NULL},
        {MHD_OPTION_END, 0, NULL},
        {MHD_OPTION_END, 0, NULL},
        {MHD_OPTION_END, 0, NULL},
    };
    size_t n = sizeof options / sizeof *options - 4;
    const bool tls = h->front.tls != NULL;
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
                                 0, NULL, NULL, mhd_callbacks_on_request, &h->front,
                                 MHD_OPTION_EXTERNAL_LOGGER, http_on_log, NULL, MHD_OPTION_ARRAY,
                                 options, MHD_OPTION_END);
    if (!h->daemon)
        return err_set(e, ERR_IO, "the HTTP threads did not start");
    return ERR_OK;
}

/* ---- listening ---- */

static enum err_code http_check_admin(const struct server_config *cfg, struct err *e)
{
    enum err_code rc = listen_check_at(cfg->admin, "--admin", e);
    if (!rc && supervisor_socket(NULL) < 0 && listen_meet(cfg->admin, cfg->address, (int)cfg->port))
        rc = err_set(e, ERR_ARG,
                     "--admin %s: there the first listener is (--address, --port): choose another "
                     "port",
                     cfg->admin);
    return rc;
}

static enum err_code http_listen(struct http *h, struct err *e)
{
    const struct server_config *cfg = h->front.s->cfg;
    bool admin = h->front.admin;
    if (h->front.self)
        return listen_open("127.0.0.1", 0, LISTEN_PORT, &h->fd, &h->port, e);
    int held = supervisor_socket(admin ? "admin" : NULL);
    if (held >= 0) {
        h->held = true;
        h->fd = held;
        return listen_take(held, &h->port, e);
    }
    if (admin) {
        enum err_code rc = http_check_admin(cfg, e);
        return rc ? rc : listen_open_at(cfg->admin, "--admin", &h->fd, &h->port, e);
    }
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
                        "--base-path %.60s: a path of letters, digits, _, . and -, that begins "
                        "with / and does not end with it",
                        base);
}

/* "https://maps.example.org/splats": links begin with it. */
static enum err_code http_check_public_url(const char *url, struct err *e)
{
    static const char plain[] =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-._~";
    if (!url || !*url)
        return ERR_OK;
    const size_t scheme = !strncasecmp(url, "http://", 7)    ? 7
                          : !strncasecmp(url, "https://", 8) ? 8
                                                             : 0;
    const char *host = url + scheme, *rest = host + strcspn(host, "/");
    bool ok = scheme && rest > host && strlen(url) < HTTP_PUBLIC_URL_MAX;
    for (const char *p = host; ok && p < rest; p++)
        ok = strchr(plain, *p) || strchr("[:]", *p);
    for (const char *p = rest; ok && *p; p++)
        ok = strchr(plain, *p) || strchr("/%!$&'()*+,;=:@", *p);
    return ok ? ERR_OK
              : err_set(e, ERR_ARG,
                        "--public-url %.80s: the address that clients see, as "
                        "https://maps.example.org or http://10.0.0.5:8080/splats",
                        url);
}

enum err_code http_check(const struct server_config *cfg, struct err *e)
{
    struct address_nets nets;
    size_t n;
    enum err_code rc = address_read_nets(cfg->trusted_proxy, &nets, e);
    if (!rc)
        rc = http_check_base(cfg->base_path, &n, e);
    if (!rc)
        rc = http_check_public_url(cfg->public_url, e);
    if (!rc)
        rc = listen_check(cfg->address, e);
    if (!rc && cfg->admin)
        rc = http_check_admin(cfg, e);
    return rc;
}

enum err_code http_open(struct services *s, enum http_side side, struct http **out, struct err *e)
{
    struct http *h = mem_array(1, sizeof *h);
    *out = h;
    if (!h)
        return err_set(e, ERR_MEM, "http: out of memory");
    h->front.s = s;
    h->front.admin = side == HTTP_ADMIN;
    h->front.self = side == HTTP_SELF || side == HTTP_SELF_TLS;
    h->front.tls = side == HTTP_PUBLIC || side == HTTP_SELF_TLS ? s->tls : NULL;
    h->front.screened = !http_is_strict();
    atomic_flag_clear(&h->front.proxy_told);
    enum err_code rc = address_read_nets(s->cfg->trusted_proxy, &h->front.proxies, e);
    if (!rc && getrandom(&h->front.secret, sizeof h->front.secret, 0) != sizeof h->front.secret)
        rc = err_errno(e, ERR_IO, "the system has no random numbers");
    if (!rc)
        rc = http_check_base(h->front.self ? NULL : s->cfg->base_path, &h->front.n_base, e);
    if (!rc)
        rc = http_check_public_url(s->cfg->public_url, e);
    if (!rc)
        rc = ipv6_groups_open(h->front.secret, &h->front.ipv6_groups, e);
    if (!rc)
        rc = http_listen(h, e);
    if (rc) {
        ipv6_groups_close(&h->front.ipv6_groups);
        mem_free(h);
        *out = NULL;
    }
    return rc;
}

enum err_code http_start(struct http *h, struct err *e)
{
    enum err_code rc = client_watch_open(http_connections(h), h->front.s, mhd_callbacks_on_gone,
                                         &h->front.watch, e);
    if (!rc)
        rc = reply_open(&h->front.replies, e);
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
    while (atomic_load(&h->front.open) > 0 && clock_s() < end_s) {
        client_watch_stop_idle(h->front.watch);
        http_pause_ms(10);
    }
}

static void http_free(struct http *h)
{
    client_watch_close(&h->front.watch);
    reply_close(&h->front.replies);
    ipv6_groups_close(&h->front.ipv6_groups);
    mem_free(h);
}

void http_close(struct http **out)
{
    struct http *h = *out;
    *out = NULL;
    if (!h)
        return;
    struct services *s = h->front.s;
    if (!h->daemon) { /* never started */
        close(h->fd);
        http_free(h);
        return;
    }
    if (h->front.self) { /* nobody else asks it, and nothing of the server ends with it */
        MHD_stop_daemon(h->daemon);
        http_free(h);
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
    view_stream_stop(s->view_streams);
    http_await_end(h, s->cfg->drain_timeout_s);
    /* Wakes whoever still waits: libmicrohttpd aborts on suspended connections. */
    job_stop(s->jobs);
    http_await_end(h, 2);
    MHD_stop_daemon(h->daemon);
    if (fd >= 0)
        close(fd);
    http_free(h);
}
