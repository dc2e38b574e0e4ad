/* The server's hot path: tiles that are in memory, over loopback, against libmicrohttpd alone
 * answering the same bytes from a constant buffer. The distance between the two is what routing,
 * the guard, the cache and the headers cost. Client and server share the machine, so the requests a
 * second say less than the ratio.
 *
 * Checked before timing: both answer the tile's bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"

#include <microhttpd.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/pool.h"
#include "core/sort.h"
#include "lod/store.h"
#include "server/server.h"
#include "server/services.h"

enum { SERVE_CLIENTS = 2, SERVE_CONNECTIONS = 16 /* a client */, SERVE_ZOOM = 17 };

/* ---- something to serve ---- */

static enum err_code serve_store(const char *path, size_t n, struct key *key, struct err *e)
{
    struct store_meta meta = {.name = "bench",
                              .origin = {13.4, 52.5, 40},
                              .sh_degree = 1,
                              .zoom_min = SERVE_ZOOM,
                              .zoom_max = SERVE_ZOOM};
    struct store *s = NULL;
    struct gauss g = {0};
    *key = key_at(meta.origin.lon_deg, meta.origin.lat_deg, SERVE_ZOOM);
    struct store_tile tile = {.key = *key, .level = 3, .geometric_error_m = 1};
    enum err_code rc = gauss_alloc(&g, n, 1, 0, e);
    if (rc)
        return rc;
    g.n = n;
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < 3; a++) {
            g.mean_m[3 * i + a] = (float)(60 * rng_unit(1, a, i) - 30);
            g.scale_log[3 * i + a] = (float)(-1 - rng_unit(1, 3 + a, i));
        }
        for (size_t a = 0; a < 4; a++)
            g.quat_wxyz[4 * i + a] = (float)rng_normal(1, 6 + a, i);
        for (size_t a = 0; a < 12; a++)
            g.sh[12 * i + a] = (float)(0.3 * rng_normal(1, 10 + a, i));
        g.opacity_logit[i] = (float)rng_normal(1, 30, i);
    }
    rc = store_create(path, &meta, &s, e);
    if (!rc)
        rc = store_put(s, &tile, &g, e);
    if (!rc)
        rc = store_commit(&s, e);
    if (s)
        store_close(&s);
    gauss_free(&g);
    return rc;
}

static enum err_code serve_config(struct server_config *cfg, struct arena *a, struct err *e)
{
    static const struct options_def defs[] = {
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct server_config, type, key, def, lo, hi, unit, help)
#include "server/options.def"
#undef OPT
    };
    const struct options_spec spec = {
        .command = "serve", .defs = defs, .n_defs = sizeof defs / sizeof *defs};
    enum err_code rc = options_defaults(&spec, cfg, a, e);
    cfg->port = 0;
    cfg->device = "none";
    cfg->access_log = false;
    cfg->requests_per_connection = 1000000000;
    cfg->client_views_s = 0;
    return rc;
}

/* ---- the client ---- */

struct serve_load {
    uint16_t port;
    char request[512];
    size_t answer_bytes; /* head and body: all answers have one size */
    size_t requests;     /* of each client */
};

static int serve_dial(uint16_t port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    if (fd >= 0 && connect(fd, (struct sockaddr *)&a, sizeof a) != 0) {
        close(fd);
        fd = -1;
    }
    return fd;
}

static bool serve_send(int fd, const char *text)
{
    size_t n = strlen(text);
    return send(fd, text, n, MSG_NOSIGNAL) == (ssize_t)n;
}

/* Keep every connection busy until `requests` answers have come. */
static enum err_code serve_client(void *user, size_t index, struct err *e)
{
    const struct serve_load *l = user;
    static const char fail[] = "bench_serve: a connection broke";
    char *bytes = mem_array(1 << 18, 1);
    struct pollfd p[SERVE_CONNECTIONS];
    size_t due[SERVE_CONNECTIONS], sent = 0, done = 0, opened = 0;
    enum err_code rc = bytes ? ERR_OK : err_set(e, ERR_MEM, "bench_serve: out of memory");
    (void)index;
    for (; opened < SERVE_CONNECTIONS && !rc; opened++) {
        p[opened] = (struct pollfd){.fd = serve_dial(l->port), .events = POLLIN};
        due[opened] = l->answer_bytes;
        if (p[opened].fd < 0 || !serve_send(p[opened].fd, l->request))
            rc = err_set(e, ERR_IO, "%s", fail);
        sent++;
    }
    while (!rc && done < sent) {
        if (poll(p, SERVE_CONNECTIONS, 10000) <= 0)
            rc = err_set(e, ERR_IO, "bench_serve: no answer for 10 s");
        for (size_t i = 0; i < SERVE_CONNECTIONS && !rc; i++) {
            if (!(p[i].revents & (POLLIN | POLLHUP | POLLERR)))
                continue;
            ssize_t n = recv(p[i].fd, bytes, 1 << 18, MSG_DONTWAIT);
            if (n <= 0 || (size_t)n > due[i])
                rc = err_set(e, ERR_IO, "%s", fail);
            else
                due[i] -= (size_t)n;
            if (rc || due[i])
                continue;
            done++;
            due[i] = l->answer_bytes;
            if (sent < l->requests && !serve_send(p[i].fd, l->request))
                rc = err_set(e, ERR_IO, "%s", fail);
            else if (sent < l->requests)
                sent++;
        }
    }
    for (size_t i = 0; i < opened; i++)
        if (p[i].fd >= 0)
            close(p[i].fd);
    mem_free(bytes);
    return rc;
}

static enum err_code serve_run(void *user, struct err *e)
{
    return pool_for(SERVE_CLIENTS, SERVE_CLIENTS, serve_client, user, e);
}

/* One request: learn the size of an answer, and keep its body and entity tag. */
static enum err_code serve_ask(struct serve_load *l, struct buf *body, char etag[64], struct err *e)
{
    char bytes[65536];
    struct buf all = {0};
    enum err_code rc = ERR_OK;
    int fd = serve_dial(l->port);
    size_t want = 0;
    if (fd < 0 || !serve_send(fd, l->request))
        rc = err_set(e, ERR_IO, "bench_serve: cannot connect");
    while (!rc && (!want || all.size < want)) {
        ssize_t n = recv(fd, bytes, sizeof bytes, 0);
        if (n <= 0)
            rc = err_set(e, ERR_IO, "bench_serve: the answer breaks off");
        else
            buf_add(&all, bytes, (size_t)n);
        if (!rc)
            rc = buf_check(&all, e);
        if (rc || want)
            continue;
        buf_add(&all, "", 1);
        all.size--;
        const char *head = (const char *)all.data, *end = strstr(head, "\r\n\r\n");
        const char *length = strstr(head, "Content-Length: "), *tag = strstr(head, "ETag: ");
        bool bodyless = !strncmp(head + 9, "304", 3);
        if (!end)
            continue;
        size_t n_head = (size_t)(end + 4 - head);
        want = n_head + (bodyless || !length ? 0 : strtoul(length + 16, NULL, 10));
        if (etag && tag)
            snprintf(etag, 64, "%.*s", (int)strcspn(tag + 6, "\r"), tag + 6);
        l->answer_bytes = want;
        body->size = n_head; /* where the body begins, until all is here */
    }
    if (fd >= 0)
        close(fd);
    size_t at = body->size;
    body->size = 0;
    if (!rc)
        buf_add(body, all.data + at, all.size - at);
    buf_free(&all);
    return !rc ? buf_check(body, e) : rc;
}

/* ---- libmicrohttpd alone ---- */

struct serve_bare {
    struct MHD_Daemon *daemon;
    struct MHD_Response *response;
    unsigned status;
};

static enum MHD_Result serve_bare_answer(void *cls, struct MHD_Connection *c, const char *url,
                                         const char *method, const char *version,
                                         const char *upload, size_t *n_upload, void **context)
{
    struct serve_bare *s = cls;
    (void)url, (void)method, (void)version, (void)upload, (void)n_upload;
    if (!*context) { /* the first call has the headers; an answer then would close the connection */
        *context = s;
        return MHD_YES;
    }
    return MHD_queue_response(c, s->status, s->response);
}

static enum err_code serve_bare_start(struct serve_bare *s, const struct buf *body, unsigned status,
                                      uint16_t *port, struct err *e)
{
    unsigned threads = pool_cores() < 4 ? (unsigned)pool_cores() : 4;
    s->status = status;
    s->response = MHD_create_response_from_buffer(body->size, body->data, MHD_RESPMEM_PERSISTENT);
    s->daemon = MHD_start_daemon(MHD_USE_EPOLL_INTERNAL_THREAD, 0, NULL, NULL, serve_bare_answer, s,
                                 threads > 1 ? MHD_OPTION_THREAD_POOL_SIZE : MHD_OPTION_END,
                                 threads, MHD_OPTION_END);
    const union MHD_DaemonInfo *info =
        s->daemon ? MHD_get_daemon_info(s->daemon, MHD_DAEMON_INFO_BIND_PORT) : NULL;
    if (!s->response || !info)
        return err_set(e, ERR_IO, "bench_serve: libmicrohttpd does not start");
    *port = info->port;
    return ERR_OK;
}

static void serve_bare_stop(struct serve_bare *s)
{
    if (s->daemon)
        MHD_stop_daemon(s->daemon);
    if (s->response)
        MHD_destroy_response(s->response);
}

/* ---- the cases ---- */

/* Both servers under the same load. `tile`: the bytes that the bare one sends, and that ours must.
 */
static enum err_code serve_compare(struct bench *b, const char *name, struct serve_load *ours,
                                   const struct buf *tile, unsigned status, struct err *e)
{
    struct serve_bare bare = {0};
    struct serve_load other = *ours;
    struct buf got = {0};
    double ours_ms, bare_ms;
    snprintf(other.request, sizeof other.request, "GET / HTTP/1.1\r\nHost: bench\r\n\r\n");
    enum err_code rc = serve_bare_start(&bare, tile, status, &other.port, e);
    if (!rc)
        rc = serve_ask(&other, &got, NULL, e);
    if (!rc && status == 200 &&
        (got.size != tile->size || memcmp(got.data, tile->data, got.size) != 0))
        rc = err_set(e, ERR_INTERNAL, "bench_serve: check: the two servers send other bytes");
    if (!rc)
        rc = bench_time(b, serve_run, ours, &ours_ms, NULL, e);
    if (!rc)
        rc = bench_time(b, serve_run, &other, &bare_ms, NULL, e);
    if (!rc) {
        double n = SERVE_CLIENTS * (double)ours->requests;
        bench_report(b, name, n / ours_ms * 1e3, "requests/s", bare_ms / ours_ms,
                     "libmicrohttpd alone");
    }
    serve_bare_stop(&bare);
    buf_free(&got);
    return rc;
}

static enum err_code serve_size(struct bench *b, size_t n_gaussians, const char *name,
                                struct err *e)
{
    char path[FILE_PATH_MAX], etag[64] = "", text[96];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    struct buf tile = {0}, none = {0};
    struct key key;
    struct serve_load load = {.requests = b->quick ? 200 : 10000};
    const char *const paths[] = {path};
    enum err_code rc = file_join(path, bench_tmpdir(b), "bench.tiles", e);
    if (!rc)
        rc = serve_store(path, n_gaussians, &key, e);
    if (!rc)
        rc = serve_config(&cfg, &arena, e);
    if (!rc)
        rc = server_start(&cfg, paths, 1, &server, e);
    if (rc)
        goto out;
    struct catalog *c = services_catalog(server_services(server));
    load.port = (uint16_t)atoi(strrchr(server_url(server), ':') + 1);
    int n = snprintf(load.request, sizeof load.request,
                     "GET /d/bench/r/%s/t/%u/%u/%u.spz HTTP/1.1\r\n"
                     "Host: bench\r\n\r\n",
                     c->ds[0]->meta.revision, key.z, key.x, key.y);
    catalog_drop(&c);
    rc = serve_ask(&load, &tile, etag, e); /* makes the tile */
    tile.size = 0;
    if (!rc)
        rc = serve_ask(&load, &tile, etag, e); /* a hit: no Server-Timing, the size that counts */
    if (!rc) {
        snprintf(text, sizeof text, "hot tile, %s (%zu B)", name, tile.size);
        rc = serve_compare(b, text, &load, &tile, MHD_HTTP_OK, e);
    }
    if (!rc) {
        snprintf(load.request + n - 2, sizeof load.request - (size_t)n + 2,
                 "If-None-Match: %s\r\n\r\n", etag);
        rc = serve_ask(&load, &none, NULL, e);
        snprintf(text, sizeof text, "304 of it");
    }
    if (!rc)
        rc = serve_compare(b, text, &load, &tile, MHD_HTTP_NOT_MODIFIED, e);
out:
    server_stop(&server);
    arena_free(&arena);
    buf_free(&tile);
    buf_free(&none);
    return rc;
}

/* ---- tiles while views are drawn ---- */

enum { BUSY_GAUSSIANS = 200000, BUSY_REQUESTS = 1500, BUSY_PAUSE_US = 1000 };

struct busy {
    struct serve_load tile;
    char view_prefix[256];
    double ms[BUSY_REQUESTS]; /* of each request of the paced client */
    atomic_bool draw, stop;
    atomic_int views;
};

/* One request on an open connection; reads until answer_bytes have come, or to the end of the
 * connection when that is 0. */
static bool serve_busy_ask(int fd, const char *request, size_t answer_bytes)
{
    static _Thread_local char bytes[1 << 18];
    if (!serve_send(fd, request))
        return false;
    for (size_t got = 0; !answer_bytes || got < answer_bytes;) {
        ssize_t n = recv(fd, bytes, sizeof bytes, 0);
        if (n <= 0)
            return n == 0 && !answer_bytes && got > 0;
        got += (size_t)n;
    }
    return true;
}

/* Worker 0 asks for a tile every millisecond; worker 1 keeps the renderer drawing, every view
 * another one. */
static enum err_code serve_busy_work(void *user, size_t index, struct err *e)
{
    struct busy *w = user;
    char request[512];
    bool ok = true;
    int fd = index == 0 ? serve_dial(w->tile.port) : -1;
    for (int i = 0; index == 0 && ok && i < BUSY_REQUESTS; i++) {
        double start_s = clock_s();
        ok = fd >= 0 && serve_busy_ask(fd, w->tile.request, w->tile.answer_bytes);
        w->ms[i] = (clock_s() - start_s) * 1e3;
        nanosleep(&(struct timespec){.tv_nsec = BUSY_PAUSE_US * 1000}, NULL);
    }
    if (index == 0)
        atomic_store(&w->stop, true);
    while (index == 1 && ok && atomic_load(&w->draw) && !atomic_load(&w->stop)) {
        snprintf(
            request, sizeof request,
            "GET %s,150@%d,-60/1280x720.jpg HTTP/1.1\r\nHost: bench\r\nConnection: close\r\n\r\n",
            w->view_prefix, atomic_fetch_add(&w->views, 1) % 360);
        int view = serve_dial(w->tile.port);
        ok = view >= 0 && serve_busy_ask(view, request, 0);
        if (view >= 0)
            close(view);
    }
    if (fd >= 0)
        close(fd);
    return ok ? ERR_OK : err_set(e, ERR_IO, "bench_serve: a connection broke");
}

static enum err_code serve_busy_measure(struct bench *b, struct busy *w, const char *name,
                                        double idle_ms[2], struct err *e)
{
    static const struct {
        const char *name;
        double share;
    } at[2] = {{"median", 0.5}, {"99th percentile", 0.99}};
    char text[96];
    bool idle = !atomic_load(&w->draw);
    atomic_store(&w->stop, false);
    enum err_code rc = pool_for(2, 2, serve_busy_work, w, e);
    sort_doubles(w->ms, BUSY_REQUESTS);
    for (int i = 0; !rc && i < 2; i++) {
        double ms = w->ms[(size_t)(at[i].share * BUSY_REQUESTS)];
        idle_ms[i] = idle ? ms : idle_ms[i];
        snprintf(text, sizeof text, "hot tile, %s, %s", name, at[i].name);
        bench_report(b, text, ms, "ms", idle ? 0 : ms / idle_ms[i], idle ? NULL : "no drawing");
    }
    return rc;
}

/* How long a hot tile takes while the server draws one view after the other. */
static enum err_code serve_busy(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    struct buf tile = {0};
    struct key key;
    const char *const paths[] = {path};
    double idle_ms[2] = {1, 1};
    struct busy *w = mem_array(1, sizeof *w);
    enum err_code rc = w ? file_join(path, bench_tmpdir(b), "bench.tiles", e)
                         : err_set(e, ERR_MEM, "bench_serve: out of memory");
    if (!rc)
        rc = serve_store(path, b->quick ? 2000 : BUSY_GAUSSIANS, &key, e);
    if (!rc)
        rc = serve_config(&cfg, &arena, e);
    cfg.device = "auto";
    if (!rc)
        rc = server_start(&cfg, paths, 1, &server, e);
    if (rc)
        goto out;
    struct catalog *c = services_catalog(server_services(server));
    w->tile.port = (uint16_t)atoi(strrchr(server_url(server), ':') + 1);
    snprintf(w->tile.request, sizeof w->tile.request,
             "GET /d/bench/r/%s/t/%u/%u/%u.spz HTTP/1.1\r\nHost: bench\r\n\r\n",
             c->ds[0]->meta.revision, key.z, key.x, key.y);
    snprintf(w->view_prefix, sizeof w->view_prefix, "/d/bench/r/%s/static/%.6f,%.6f",
             c->ds[0]->meta.revision, c->ds[0]->meta.origin.lon_deg, c->ds[0]->meta.origin.lat_deg);
    catalog_drop(&c);
    for (int i = 0; !rc && i < 2; i++) { /* make the tile; then the size of a hit */
        tile.size = 0;
        rc = serve_ask(&w->tile, &tile, NULL, e);
    }
    if (!rc)
        rc = serve_busy_measure(b, w, "idle", idle_ms, e);
    atomic_store(&w->draw, true);
    if (!rc)
        rc = serve_busy_measure(b, w, "while drawing", idle_ms, e);
    if (!rc)
        bench_report(b, "views drawn meanwhile", atomic_load(&w->views), "", 0, NULL);
out:
    server_stop(&server);
    arena_free(&arena);
    buf_free(&tile);
    mem_free(w);
    return rc;
}

enum err_code bench_serve(struct bench *b, struct err *e)
{
    enum err_code rc = serve_size(b, 280, "small", e);
    if (!rc)
        rc = serve_size(b, 2600, "usual", e);
    return !rc ? serve_busy(b, e) : rc;
}
