/* The HTTP layer over loopback: malformed requests, slow and vanishing clients, headers of every kind of
 * answer, single flight, limits, draining. Every wait has an end, far above what a busy machine needs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/served.h"

#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <strings.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/pool.h"

static const double PATIENCE_S = 20; /* an answer that takes longer than this never comes */

static struct {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], rev[13];
    struct arena arena;
    struct server_config cfg;
    const char *paths[1];
    struct server *server;
    uint16_t port;
} t;

/* ---- a client ---------------------------------------------------------------------------------------------- */

static int dial(uint16_t port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_true(fd >= 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof(a)), 0);
    return fd;
}

static void say_bytes(int fd, const char *p, size_t n)
{
    while (n) {
        ssize_t k = send(fd, p, n, MSG_NOSIGNAL);
        if (k <= 0)
            return; /* the server has closed: what it said is still read */
        p += k;
        n -= (size_t)k;
    }
}

static void say(int fd, const char *text)
{
    say_bytes(fd, text, strlen(text));
}

struct reply { /* one answer; buf_free(&raw) */
    int status;
    struct buf raw;
    const char *head;
    const uint8_t *body;
    size_t body_size;
    char value[512];
};

/* The value of a header, "" when absent. */
static const char *header(struct reply *r, const char *name)
{
    size_t n = strlen(name);
    r->value[0] = 0;
    for (const char *p = strstr(r->head, "\r\n"); p && p[2] != '\r'; p = strstr(p + 2, "\r\n"))
        if (!strncasecmp(p + 2, name, n) && p[2 + n] == ':') {
            const char *v = p + 3 + n + strspn(p + 3 + n, " ");
            snprintf(r->value, sizeof(r->value), "%.*s", (int)strcspn(v, "\r"), v);
        }
    return r->value;
}

/* Add what comes within `wait_s`; false at end of stream. */
static bool hear_some(int fd, struct buf *b, double wait_s)
{
    struct pollfd p = {.fd = fd, .events = POLLIN};
    char bytes[65536];
    if (poll(&p, 1, (int)(wait_s * 1000)) != 1)
        return true;
    ssize_t n = recv(fd, bytes, sizeof(bytes), 0);
    if (n > 0)
        buf_add(b, bytes, (size_t)n);
    return n > 0;
}

/* One whole answer. `rest` (may be NULL) carries bytes between the answers of a connection. */
static void hear(int fd, bool has_body, struct buf *rest, struct reply *r)
{
    double end_s = clock_s() + PATIENCE_S;
    memset(r, 0, sizeof(*r));
    if (rest) {
        r->raw = *rest;
        memset(rest, 0, sizeof(*rest));
    }
    for (bool open = true;;) {
        buf_add(&r->raw, "", 1); /* so that text functions stop */
        r->raw.size--;
        char *end = r->raw.size ? strstr((char *)r->raw.data, "\r\n\r\n") : NULL;
        if (end) {
            r->head = (char *)r->raw.data;
            r->body = (uint8_t *)end + 4;
            size_t got = r->raw.size - (size_t)(r->body - r->raw.data);
            r->body_size = has_body ? (size_t)atoll(header(r, "Content-Length")) : 0;
            r->status = atoi(r->head + 9);
            if (r->status == 304 || r->status == 204)
                r->body_size = 0;
            if (got >= r->body_size) {
                if (rest && got > r->body_size)
                    buf_add(rest, r->body + r->body_size, got - r->body_size);
                return;
            }
        }
        if (!open || clock_s() > end_s)
            fail_msg("%s after %zu bytes: %.80s", open ? "no whole answer" : "closed", r->raw.size,
                     r->raw.size ? (char *)r->raw.data : "");
        open = hear_some(fd, &r->raw, 1);
    }
}

/* Request with extra header lines, on a connection of its own. */
static void ask_port(uint16_t port, const char *method, const char *target, const char *extra,
                     struct reply *r)
{
    struct buf q = {0};
    int fd = dial(port);
    buf_printf(&q, "%s %s HTTP/1.1\r\nHost: test\r\n%sConnection: close\r\n\r\n", method, target, extra);
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, strcmp(method, "HEAD") != 0, NULL, r);
    buf_free(&q);
    close(fd);
}

static void ask(const char *method, const char *target, const char *extra, struct reply *r)
{
    ask_port(t.port, method, target, extra, r);
}

static int status_of(const char *method, const char *target, const char *extra)
{
    struct reply r;
    ask(method, target, extra, &r);
    buf_free(&r.raw);
    return r.status;
}

static const char *tile_target(uint8_t z, const char *ext, char out[128])
{
    struct key k = served_key(z);
    snprintf(out, 128, "/d/toy/r/%s/t/%u/%u/%u.%s", t.rev, k.z, k.x, k.y, ext);
    return out;
}

/* ---- the server --------------------------------------------------------------------------------------------------- */

static void start(void)
{
    struct err e = {0};
    kit_ok(server_start(&t.cfg, t.paths, 1, &t.server, &e), e);
    const char *colon = strrchr(server_url(t.server), ':');
    t.port = (uint16_t)atoi(colon + 1);
    struct catalog *c = services_catalog(server_services(t.server));
    memcpy(t.rev, c->ds[0]->meta.revision, sizeof(t.rev));
    catalog_drop(&c);
}

static int setup_all(void **state)
{
    struct err e = {0};
    (void)state;
    log_set_level(LOG_ERROR);
    kit_tmpdir(t.dir);
    kit_ok(file_join(t.path, t.dir, "toy.tiles", &e), e);
    served_city(t.path, "toy", 2000);
    t.paths[0] = t.path;
    return 0;
}

static int teardown_all(void **state)
{
    (void)state;
    kit_rmdir(t.dir);
    return 0;
}

static int setup(void **state)
{
    struct err e = {0};
    (void)state;
    arena_free(&t.arena);
    served_config(&t.cfg, &t.arena);
    kit_ok(file_mkdir(t.dir, &e), e);
    t.cfg.web_dir = NULL;
    t.cfg.workers = 2;
    t.cfg.http_threads = 2;
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    server_stop(&t.server);
    arena_free(&t.arena);
    return 0;
}

static uint64_t connections(void)
{
    return atomic_load(&server_services(t.server)->metrics.connections);
}

static void nap_ms(long ms)
{
    const struct timespec ts = {.tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000};
    nanosleep(&ts, NULL);
}

static void await_no_connections(void)
{
    for (double end_s = clock_s() + PATIENCE_S; connections() && clock_s() < end_s;)
        nap_ms(5);
    assert_int_equal(connections(), 0);
}

/* ---- malformed requests --------------------------------------------------------------------------------------------- */

#define H "Host: a\r\n"
#define POST "POST /d/toy/render HTTP/1.1\r\n" H

/* Every status in the bytes must be `status` (0: no answer at all), and if `close`, the stream ends. A
 * request hidden in a body must not be answered: that would be a 200. */
static void probe(const char *what, const char *bytes, size_t n, int status, bool must_close)
{
    struct buf b = {0};
    int fd = dial(t.port);
    bool open = true;
    say_bytes(fd, bytes, n);
    if (!must_close)
        shutdown(fd, SHUT_WR); /* or a keep-alive connection would be waited for */
    for (double end_s = clock_s() + PATIENCE_S; open && clock_s() < end_s;)
        open = hear_some(fd, &b, 0.2);
    buf_add(&b, "", 1);
    if (open)
        fail_msg("%s: the connection stays open", what);
    int count = 0;
    for (const char *p = strstr((char *)b.data, "HTTP/1."); p; p = strstr(p + 1, "HTTP/1."), count++)
        if (atoi(p + 9) != status)
            fail_msg("%s: got %d, want %d", what, atoi(p + 9), status);
    if ((count > 0) != (status > 0))
        fail_msg("%s: %d answers", what, count);
    buf_free(&b);
    close(fd);
}

static void test_malformed_requests(void **state)
{
    static const struct {
        const char *what, *bytes;
        int status;
        bool close;
    } rows[] = {
        {"length and coding", POST "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n"
                                   "GET /healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"coding and length", POST "Transfer-Encoding: chunked\r\nContent-Length: 40\r\n\r\n0\r\n\r\n"
                                   "GET /healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"two lengths", POST "Content-Length: 5\r\nContent-Length: 6\r\n\r\nhello1", 400, true},
        {"two equal lengths", POST "Content-Length: 5\r\nContent-Length: 5\r\n\r\nhello", 400, true},
        {"length before space", POST "Content-Length : 5\r\n\r\nhello", 400, true},
        {"length +5", POST "Content-Length: +5\r\n\r\nhello", 400, true},
        {"length -1", POST "Content-Length: -1\r\n\r\nhello", 400, true},
        {"length 0x5", POST "Content-Length: 0x5\r\n\r\nhello", 400, true},
        {"length 5,5", POST "Content-Length: 5,5\r\n\r\nhello", 400, true},
        {"length beyond 64 bits", POST "Content-Length: 99999999999999999999\r\n\r\nhello", 413, true},
        {"length beyond the limit", POST "Content-Length: 1000000\r\n\r\nhello", 413, true},
        {"two codings", POST "Transfer-Encoding: gzip, chunked\r\n\r\n0\r\n\r\n", 501, true},
        {"coding twice", POST "Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400,
         true},
        {"unknown coding", POST "Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n", 501, true},
        {"bad chunk", POST "Transfer-Encoding: chunked\r\n\r\nZZ\r\n{}\r\n0\r\n\r\n", 400, true},
        {"negative chunk", POST "Transfer-Encoding: chunked\r\n\r\n-2\r\n{}\r\n0\r\n\r\n", 400, true},
        {"chunked in 1.0", "POST /d/toy/render HTTP/1.0\r\n" H "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400,
         true},
        {"body of GET", "GET /healthz HTTP/1.1\r\n" H "Content-Length: 3\r\n\r\nabc", 400, true},
        {"chunked GET", "GET /healthz HTTP/1.1\r\n" H "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400, true},
        {"no host", "GET /healthz HTTP/1.1\r\n\r\n", 400, true},
        {"two hosts", "GET /healthz HTTP/1.1\r\n" H "Host: b\r\n\r\n", 400, true},
        {"unknown method", "FOO /healthz HTTP/1.1\r\n" H "\r\n", 501, true},
        {"method with dirt", "helloGET /healthz HTTP/1.1\r\n" H "\r\n", 501, true},
        {"lower case", "get /healthz HTTP/1.1\r\n" H "\r\n", 501, true},
        {"absolute form", "GET http://a/healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"asterisk", "OPTIONS * HTTP/1.1\r\n" H "\r\n", 400, true},
        {"authority form", "CONNECT a:80 HTTP/1.1\r\n" H "\r\n", 400, true},
        {"bare CR", "GET /healthz HTTP/1.1\r\nHost: a\rX: b\r\n\r\n", 400, true},
        {"no colon", "GET /healthz HTTP/1.1\r\n" H "foo\r\n\r\n", 400, true},
        {"name beyond ASCII", "GET /healthz HTTP/1.1\r\n" H "f\xc3\xb6: x\r\n\r\n", 400, true},
        {"HTTP/2 preface", "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", 505, true},
        {"HTTP/3.7", "GET /healthz HTTP/3.7\r\n" H "\r\n", 505, true},
        {"no version", "GET /healthz\r\n\r\n", 400, true},
        {"percent", "GET /%2e%2e/etc/passwd HTTP/1.1\r\n" H "\r\n", 400, false},
        {"percent NUL", "GET /healthz%00x HTTP/1.1\r\n" H "\r\n", 400, false},
        {"dots", "GET /../../etc/passwd HTTP/1.1\r\n" H "\r\n", 400, false},
        {"space in target", "GET /a b HTTP/1.1\r\n" H "\r\n", 400, false},
        {"other method", "DELETE /healthz HTTP/1.1\r\n" H "\r\n", 405, false},
        {"HTTP/1.0", "GET /healthz HTTP/1.0\r\n\r\n", 200, false},
        {"bare LF", "GET /healthz HTTP/1.1\nHost: a\n\n", 200, false},
        {"line before", "\r\nGET /healthz HTTP/1.1\r\n" H "\r\n", 200, false},
        {"chunk extension", POST "Transfer-Encoding: chunked\r\n\r\n2;a=b\r\n{}\r\n0\r\n\r\n", 422, false},
        {"half a request", "GET /healthz HT", 0, false},
        {"nothing", "", 0, false},
    };
    (void)state;
    start();
    for (size_t i = 0; i < sizeof(rows) / sizeof(*rows); i++)
        probe(rows[i].what, rows[i].bytes, strlen(rows[i].bytes), rows[i].status, rows[i].close);
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

static void test_oversized_requests(void **state)
{
    struct buf b = {0};
    (void)state;
    start();
    buf_printf(&b, "GET /%03000d HTTP/1.1\r\n" H "\r\n", 0);
    probe("long target", (char *)b.data, b.size, 414, true);
    b.size = 0;
    buf_printf(&b, "GET /%030000d HTTP/1.1\r\n" H "\r\n", 0);
    probe("longer target", (char *)b.data, b.size, 414, true);
    b.size = 0;
    buf_printf(&b, "GET /healthz HTTP/1.1\r\n" H "X: %030000d\r\n\r\n", 0);
    probe("long field", (char *)b.data, b.size, 431, true);
    b.size = 0;
    buf_printf(&b, "GET /healthz HTTP/1.1\r\n" H);
    for (int i = 0; i < 70; i++)
        buf_printf(&b, "X: %d\r\n", i);
    buf_printf(&b, "\r\n");
    probe("many fields", (char *)b.data, b.size, 431, true);
    b.size = 0;
    buf_printf(&b, POST "Transfer-Encoding: chunked\r\n\r\n");
    for (int i = 0; i < 20; i++)
        buf_printf(&b, "2000\r\n%08192d\r\n", 0);
    buf_printf(&b, "0\r\n\r\n");
    probe("long chunked body", (char *)b.data, b.size, 413, true);
    buf_free(&b);
}

/* Random bytes and damaged requests: any answer, or none, but the next request is served. */
static void test_any_bytes(void **state)
{
    enum { EACH = 40 };
    static const char good[] = POST "Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{}"
                                    "GET /collections HTTP/1.1\r\n" H "Accept-Encoding: gzip\r\n\r\n";
    (void)state;
    t.cfg.header_timeout_s = t.cfg.body_timeout_s = 1;
    start();
    for (uint64_t batch = 0; batch < 10; batch++) {
        int fd[EACH];
        for (uint64_t i = 0; i < EACH; i++) {
            char bytes[sizeof(good)];
            memcpy(bytes, good, sizeof(good));
            for (uint64_t k = 0; k < 1 + i % 5; k++)
                bytes[rng_u64(batch, 2 * k, i) % (sizeof(good) - 1)] = (char)rng_u64(batch, 2 * k + 1, i);
            fd[i] = dial(t.port);
            say_bytes(fd[i], bytes, sizeof(good) - 1);
            shutdown(fd[i], SHUT_WR);
        }
        for (int i = 0; i < EACH; i++) {
            struct buf b = {0};
            bool open = true;
            for (double end_s = clock_s() + PATIENCE_S; open && clock_s() < end_s;)
                open = hear_some(fd[i], &b, 0.2);
            assert_false(open);
            buf_free(&b);
            close(fd[i]);
        }
    }
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* ---- answers ------------------------------------------------------------------------------------------------------------- */

static void test_headers(void **state)
{
    struct reply r;
    char target[128];
    (void)state;
    start();
    ask("GET", tile_target(17, "glb", target), "Origin: http://map\r\n", &r);
    assert_int_equal(r.status, 200);
    assert_memory_equal(r.body, "glTF", 4);
    assert_string_equal(header(&r, "Content-Type"), "model/gltf-binary");
    assert_string_equal(header(&r, "Cache-Control"), "public, max-age=31536000, immutable");
    assert_string_equal(header(&r, "Accept-Ranges"), "bytes");
    assert_string_equal(header(&r, "Access-Control-Allow-Origin"), "*");
    assert_string_equal(header(&r, "X-Content-Type-Options"), "nosniff");
    assert_string_equal(header(&r, "Vary"), "");
    assert_true(strlen(header(&r, "Server-Timing")) > 0); /* it was a job */
    char etag[64], line[128];
    snprintf(etag, sizeof(etag), "%s", header(&r, "ETag"));
    size_t size = r.body_size;
    buf_free(&r.raw);

    ask("HEAD", target, "", &r); /* the same headers, no bytes */
    assert_int_equal(r.status, 200);
    assert_int_equal(atoll(header(&r, "Content-Length")), size);
    assert_string_equal(header(&r, "ETag"), etag);
    assert_int_equal(r.raw.size, (size_t)(r.body - r.raw.data));
    buf_free(&r.raw);

    snprintf(line, sizeof(line), "If-None-Match: \"x\", W/%s\r\n", etag);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 304);
    assert_string_equal(header(&r, "ETag"), etag);
    assert_string_equal(header(&r, "Cache-Control"), "public, max-age=31536000, immutable");
    assert_int_equal(atoll(header(&r, "Content-Length")), size); /* or nothing, but never 0 */
    assert_int_equal(r.raw.size, (size_t)(r.body - r.raw.data));
    buf_free(&r.raw);

    snprintf(line, sizeof(line), "Range: bytes=10-19\r\nIf-Range: %s\r\n", etag);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 206);
    assert_int_equal(r.body_size, 10);
    snprintf(line, sizeof(line), "bytes 10-19/%zu", size);
    assert_string_equal(header(&r, "Content-Range"), line);
    buf_free(&r.raw);

    ask("GET", target, "Range: bytes=99999999-\r\n", &r);
    assert_int_equal(r.status, 416);
    snprintf(line, sizeof(line), "bytes */%zu", size);
    assert_string_equal(header(&r, "Content-Range"), line);
    buf_free(&r.raw);

    ask("OPTIONS", "/d/toy/render", "Access-Control-Request-Method: POST\r\n", &r);
    assert_int_equal(r.status, 204);
    assert_string_equal(header(&r, "Allow"), "POST, OPTIONS");
    assert_string_equal(header(&r, "Access-Control-Allow-Methods"), "POST, OPTIONS");
    assert_string_equal(header(&r, "Access-Control-Max-Age"), "86400");
    assert_string_equal(header(&r, "Content-Length"), "");
    buf_free(&r.raw);

    ask("PUT", target, "Content-Length: 0\r\n", &r);
    assert_int_equal(r.status, 405);
    assert_string_equal(header(&r, "Allow"), "GET, HEAD, OPTIONS");
    assert_string_equal(header(&r, "Content-Type"), "application/problem+json");
    buf_free(&r.raw);

    ask("GET", "/collections", "Accept-Encoding: gzip\r\n", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Content-Encoding"), "gzip");
    assert_string_equal(header(&r, "Vary"), "Accept-Encoding");
    assert_memory_equal(r.body, "\x1f\x8b", 2);
    buf_free(&r.raw);

    snprintf(line, sizeof(line), "/d/toy/t/%s", strstr(target, "/t/") + 3);
    ask("GET", line, "", &r);
    assert_int_equal(r.status, 307);
    assert_non_null(strstr(header(&r, "Location"), t.rev));
    buf_free(&r.raw);

    ask("GET", "/d/toy/static/13.4,52.5,99@0,-90/64x64.jpg", "", &r);
    assert_int_equal(r.status, 307);
    buf_free(&r.raw);
    snprintf(line, sizeof(line), "/d/toy/r/%s/static/13.4,52.5,99@0,-90/64x64.jpg", t.rev);
    ask("GET", line, "", &r);
    assert_int_equal(r.status, 503); /* no device: tiles are served, pictures are not */
    assert_true(atoi(header(&r, "Retry-After")) >= 1);
    buf_free(&r.raw);

    assert_int_equal(status_of("GET", "/metrics", ""), 200);
    assert_int_equal(status_of("GET", "/metrics", "X-Forwarded-For: 9.9.9.9\r\n"), 403);
}

/* A tile that was never made answers 304 from the index, with no claim about its length. */
static void test_304_of_a_cold_tile(void **state)
{
    struct reply r;
    char target[128], line[128];
    struct job_stats before, after;
    (void)state;
    start();
    ask("GET", tile_target(15, "spz", target), "", &r);
    snprintf(line, sizeof(line), "If-None-Match: %s\r\n", header(&r, "ETag"));
    buf_free(&r.raw);
    server_stop(&t.server);
    start(); /* an empty cache */
    job_count(server_services(t.server)->jobs, &before);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 304);
    assert_string_equal(header(&r, "Content-Length"), "");
    buf_free(&r.raw);
    job_count(server_services(t.server)->jobs, &after);
    assert_int_equal(after.ended[JOB_TILE][JOB_OK], before.ended[JOB_TILE][JOB_OK]);
}

static void test_keep_alive_and_pipelining(void **state)
{
    struct buf q = {0}, rest = {0};
    char target[128];
    (void)state;
    t.cfg.requests_per_connection = 5;
    start();
    int fd = dial(t.port);
    for (int i = 0; i < 5; i++) /* hot and cold mixed, in one write */
        buf_printf(&q, "GET %s HTTP/1.1\r\n" H "\r\n",
                   i == 1 ? tile_target(16, "drc", target) : i == 3 ? tile_target(16, "ply", target) : "/healthz");
    say_bytes(fd, (char *)q.data, q.size);
    for (int i = 0; i < 5; i++) {
        struct reply r;
        hear(fd, true, &rest, &r);
        assert_int_equal(r.status, 200);
        assert_string_equal(header(&r, "Content-Type"), i == 1 || i == 3 ? "application/octet-stream"
                                                                          : "application/json");
        assert_string_equal(header(&r, "Connection"), i == 4 ? "close" : ""); /* the limit was reached */
        buf_free(&r.raw);
    }
    struct buf more = {0};
    assert_false(hear_some(fd, &more, PATIENCE_S));
    close(fd);
    buf_free(&q);
    buf_free(&rest);
    buf_free(&more);
}

static void test_damaged_tile(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX], target[128];
    (void)state;
    kit_ok(file_join(path, t.dir, "damaged.tiles", &e), e);
    served_city(path, "toy", 30);
    served_damage(path, served_key(17));
    t.paths[0] = path;
    start();
    t.paths[0] = t.path;
    assert_int_equal(status_of("GET", tile_target(17, "glb", target), ""), 500);
    assert_int_equal(status_of("GET", tile_target(17, "glb", target), ""), 500);
    assert_int_equal(status_of("GET", tile_target(16, "glb", target), ""), 200);
    assert_int_equal(atomic_load(&server_services(t.server)->metrics.store_errors), 1); /* and tried once */
}

/* ---- jobs ------------------------------------------------------------------------------------------------------------------ */

/* Everybody asks for the same tile, which nobody has made, at the same moment. */
static void test_one_job_for_many_clients(void **state)
{
    enum { CLIENTS = 100 };
    int fd[CLIENTS];
    char target[128], request[256];
    struct reply first = {0};
    struct job_stats st;
    (void)state;
    start();
    snprintf(request, sizeof(request), "GET %s HTTP/1.1\r\n" H "\r\n", tile_target(17, "ply", target));
    for (int i = 0; i < CLIENTS; i++)
        fd[i] = dial(t.port);
    for (int i = 0; i < CLIENTS; i++)
        say(fd[i], request);
    for (int i = 0; i < CLIENTS; i++) {
        struct reply r;
        hear(fd[i], true, NULL, &r);
        assert_int_equal(r.status, 200);
        if (!i) {
            first = r;
            continue;
        }
        assert_int_equal(r.body_size, first.body_size);
        assert_memory_equal(r.body, first.body, r.body_size);
        buf_free(&r.raw);
    }
    buf_free(&first.raw);
    for (int i = 0; i < CLIENTS; i++)
        close(fd[i]);
    struct cache_stats cs;
    cache_count(server_services(t.server)->cache, &cs);
    assert_int_equal(cs.entries, 1);
    job_count(server_services(t.server)->jobs, &st);
    assert_in_range(st.ended[JOB_TILE][JOB_OK], 1, 2); /* 2: asked between the end of one and the cache */
    await_no_connections();
}

/* Clients that reset the connection while their tiles wait leave nothing behind. */
static void test_vanishing_clients(void **state)
{
    static const char *const exts[] = {"glb", "spz", "drc", "ply", "plain.glb"};
    const struct linger reset = {.l_onoff = 1, .l_linger = 0};
    (void)state;
    t.cfg.workers = 1;
    start();
    struct services *s = server_services(t.server);
    for (int round = 0; round < 4; round++) {
        int fd[15], n = 0;
        for (int f = 0; f < 5; f++)
            for (uint8_t z = 15; z <= 17; z++) {
                char target[128], request[256];
                snprintf(request, sizeof(request), "GET %s HTTP/1.1\r\n" H "\r\n",
                         tile_target(z, exts[f], target));
                fd[n] = dial(t.port);
                say(fd[n++], request);
            }
        nap_ms(round * 3);
        for (int i = 0; i < n; i++) {
            setsockopt(fd[i], SOL_SOCKET, SO_LINGER, &reset, sizeof(reset));
            close(fd[i]);
        }
        await_no_connections();
    }
    assert_int_equal(atomic_load(&s->metrics.inflight), 0);
    for (double end_s = clock_s() + PATIENCE_S; !job_idle(s->jobs) && clock_s() < end_s;)
        nap_ms(5);
    assert_true(job_idle(s->jobs));
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* ---- slow clients ---------------------------------------------------------------------------------------------------------- */

/* Send one byte every 50 ms until the server cuts the connection; seconds until then. */
static double drip(const char *start_with)
{
    struct buf b = {0};
    int fd = dial(t.port);
    double start_s = clock_s();
    say(fd, start_with);
    bool open = true;
    while (open && clock_s() - start_s < PATIENCE_S) {
        say(fd, "x");
        open = hear_some(fd, &b, 0.05);
    }
    close(fd);
    buf_free(&b);
    assert_false(open);
    return clock_s() - start_s;
}

static void test_slow_clients_are_cut(void **state)
{
    (void)state;
    t.cfg.header_timeout_s = 0.4;
    t.cfg.body_timeout_s = 0.4;
    t.cfg.idle_timeout_s = 0.4;
    start();
    struct metrics *m = &server_services(t.server)->metrics;
    assert_in_range((uint64_t)(drip("GET / HTTP/1.1\r\nHost: a\r\nX: ") * 1000), 350, 10000);
    assert_in_range((uint64_t)(drip("GET /") * 1000), 350, 10000);
    assert_in_range((uint64_t)(drip(POST "Content-Length: 9999\r\n\r\n") * 1000), 350, 10000);
    assert_true(atomic_load(&m->reaped) >= 3);
    int fd = dial(t.port); /* idle after an answer */
    struct reply r;
    struct buf b = {0};
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    hear(fd, true, NULL, &r);
    assert_int_equal(r.status, 200);
    double since_s = clock_s();
    assert_false(hear_some(fd, &b, PATIENCE_S));
    assert_true(clock_s() - since_s > 0.3);
    close(fd);
    buf_free(&r.raw);
    int many[60]; /* and while many drip, others are served */
    for (int i = 0; i < 60; i++) {
        many[i] = dial(t.port);
        say(many[i], "GET / HTTP/1.1\r\nX: ");
    }
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
    await_no_connections();
    for (int i = 0; i < 60; i++)
        close(many[i]);
}

/* Someone who does not read an answer is cut as well. The answer must not fit into socket buffers. */
static void test_a_client_that_does_not_read(void **state)
{
    char target[128], request[256];
    const int small = 4096;
    (void)state;
    t.cfg.write_timeout_s = 0.1;
    start();
    int fd = dial(t.port);
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof(small));
    snprintf(request, sizeof(request), "GET %s HTTP/1.1\r\n" H "\r\n", tile_target(17, "spz", target));
    struct services *s = server_services(t.server);
    for (int i = 0; i < 300; i++)
        say(fd, request);
    for (double end_s = clock_s() + 60; !atomic_load(&s->metrics.reaped) && clock_s() < end_s;)
        nap_ms(20);
    assert_true(atomic_load(&s->metrics.reaped) >= 1);
    await_no_connections();
    close(fd);
}

static void test_connection_limit(void **state)
{
    enum { LIMIT = 8 };
    int fd[LIMIT];
    struct reply r;
    (void)state;
    t.cfg.max_connections = LIMIT;
    t.cfg.http_threads = 1;
    start();
    for (int i = 0; i < LIMIT; i++) {
        fd[i] = dial(t.port);
        say(fd[i], "GET /healthz HTTP/1.1\r\n" H "\r\n");
        hear(fd[i], true, NULL, &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
    }
    ask("GET", "/healthz", "", &r);
    assert_int_equal(r.status, 503);
    assert_string_equal(header(&r, "Connection"), "close");
    assert_true(atoi(header(&r, "Retry-After")) >= 1);
    buf_free(&r.raw);
    for (int i = 0; i < LIMIT; i++)
        close(fd[i]);
    await_no_connections();
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* ---- start and stop -------------------------------------------------------------------------------------------------------- */

static void test_busy_port(void **state)
{
    struct err e = {0};
    struct server *second = NULL;
    (void)state;
    start();
    t.cfg.port = t.port;
    kit_fails(server_start(&t.cfg, t.paths, 1, &second, &e), ERR_BUSY, e, "--port");
    assert_null(second);
    t.cfg.address = "not-an-address";
    kit_fails(server_start(&t.cfg, t.paths, 1, &second, &e), ERR_ARG, e, "--address");
    const char *missing[] = {"/nonexistent/x.tiles"};
    t.cfg.address = "127.0.0.1";
    kit_fails(server_start(&t.cfg, missing, 1, &second, &e), ERR_NOENT, e, "/nonexistent/x.tiles");
}

static enum err_code stop_main(void *user, size_t i, struct err *e)
{
    (void)e;
    if (i == 0) {
        server_stop(&t.server);
        return ERR_OK;
    }
    /* Meanwhile the answers that were asked for arrive whole, and then the connections end. */
    int *fd = user;
    for (int k = 0; k < 20; k++) {
        struct reply r;
        struct buf b = {0};
        hear(fd[k], true, NULL, &r);
        if (r.status != 200)
            return err_set(e, ERR_INTERNAL, "client %d got %d", k, r.status);
        buf_free(&r.raw);
        if (hear_some(fd[k], &b, PATIENCE_S))
            return err_set(e, ERR_INTERNAL, "client %d: connection stays open", k);
        buf_free(&b);
    }
    return ERR_OK;
}

static void test_stopping_finishes_answers(void **state)
{
    static const char *const exts[] = {"glb", "spz", "drc", "ply", "plain.glb"};
    struct err e = {0};
    int fd[20], idle;
    (void)state;
    t.cfg.workers = 1;
    start();
    idle = dial(t.port);
    for (int i = 0; i < 20; i++) {
        char target[128], request[256];
        snprintf(request, sizeof(request), "GET %s HTTP/1.1\r\n" H "\r\n",
                 tile_target((uint8_t)(15 + i % 3), exts[i % 5], target));
        fd[i] = dial(t.port);
        say(fd[i], request);
    }
    for (double end_s = clock_s() + PATIENCE_S; /* all have been read, few are made */
         atomic_load(&server_services(t.server)->metrics.inflight) < 5 && clock_s() < end_s &&
         job_idle(server_services(t.server)->jobs);)
        nap_ms(1);
    nap_ms(20);
    kit_ok(pool_for(2, 2, stop_main, fd, &e), e);
    for (int i = 0; i < 20; i++)
        close(fd[i]);
    close(idle);
}

/* The program itself: prints where it listens, drains on SIGTERM, exits 0. */
static void test_program(void **state)
{
    const char *program = kit_program();
    int out[2], status = -1;
    char line[256] = "", target[128], request[256];
    (void)state;
    start();
    server_stop(&t.server); /* for the revision alone */
    assert_int_equal(pipe(out), 0);
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        dup2(out[1], 1);
        close(out[0]);
        execl(program, program, "serve", t.path, "--port", "0", "--device", "none", "-q", (char *)NULL);
        _exit(127);
    }
    close(out[1]);
    FILE *f = fdopen(out[0], "r");
    assert_non_null(fgets(line, sizeof(line), f));
    const char *colon = strrchr(line, ':');
    assert_non_null(colon);
    uint16_t port = (uint16_t)atoi(colon + 1);
    int fd = dial(port);
    snprintf(request, sizeof(request), "GET %s HTTP/1.1\r\n" H "\r\n", tile_target(17, "ply", target));
    say(fd, request);
    struct buf rest = {0}, end = {0};
    struct reply r;
    while (!rest.size) /* the answer has begun */
        assert_true(hear_some(fd, &rest, PATIENCE_S));
    assert_int_equal(kill(pid, SIGHUP), 0); /* opens the stores again, and goes on */
    assert_int_equal(kill(pid, SIGTERM), 0);
    hear(fd, true, &rest, &r);
    assert_int_equal(r.status, 200);
    assert_memory_equal(r.body, "ply", 3);
    assert_false(hear_some(fd, &end, PATIENCE_S));
    buf_free(&r.raw);
    buf_free(&rest);
    buf_free(&end);
    assert_int_equal(waitpid(pid, &status, 0), pid);
    assert_true(WIFEXITED(status));
    assert_int_equal(WEXITSTATUS(status), 0);
    close(fd);
    fclose(f);
}

int main(void)
{
#define HTTP_TEST(f) cmocka_unit_test_setup_teardown(f, setup, teardown)
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_malformed_requests),
        HTTP_TEST(test_oversized_requests),
        HTTP_TEST(test_any_bytes),
        HTTP_TEST(test_headers),
        HTTP_TEST(test_304_of_a_cold_tile),
        HTTP_TEST(test_keep_alive_and_pipelining),
        HTTP_TEST(test_damaged_tile),
        HTTP_TEST(test_one_job_for_many_clients),
        HTTP_TEST(test_vanishing_clients),
        HTTP_TEST(test_slow_clients_are_cut),
        HTTP_TEST(test_a_client_that_does_not_read),
        HTTP_TEST(test_connection_limit),
        HTTP_TEST(test_busy_port),
        HTTP_TEST(test_stopping_finishes_answers),
        HTTP_TEST(test_program),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
