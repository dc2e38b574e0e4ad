/* A client for the server's tests, and the server under test. The client blocks and uses loopback;
 * its longest waits are far beyond what a busy machine needs. The server is started for each test
 * with its own options.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_CLIENT_H
#define TESTS_CLIENT_H

#include "core/device/dev.h"
#include "lod/store/key.h"
#include "tests/server/served.h"
#ifdef OVER_TLS
#include "tests/server/tunnel.h"
#endif

#include <dirent.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdlib.h>
#include <strings.h>
#include <sys/socket.h>
#include <unistd.h>

static struct {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], rev[13];
    struct arena arena;
    struct server_config cfg;
    const char *paths[1];
    struct server *server;
    uint16_t port;
#ifdef OVER_TLS
    char cert[FILE_PATH_MAX], key[FILE_PATH_MAX];
    struct tunnels tunnels;
#endif
} t;

/* ---- a client ---- */

static inline int dial(uint16_t port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_true(fd >= 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

static inline void say_bytes(int fd, const char *p, size_t n)
{
    while (n) {
        ssize_t k = send(fd, p, n, MSG_NOSIGNAL);
        if (k <= 0)
            return; /* the server has closed; its answer can still be read */
        p += k;
        n -= (size_t)k;
    }
}

static inline void say(int fd, const char *text)
{
    say_bytes(fd, text, strlen(text));
}

struct reply { /* one answer; free with buf_free(&raw) */
    int status;
    struct buf raw;
    const char *head;
    const uint8_t *body;
    size_t body_size;
    char value[512];
};

/* The value of a header, or "". */
static const char *header(struct reply *r, const char *name)
{
    size_t n = strlen(name);
    r->value[0] = 0;
    for (const char *p = strstr(r->head, "\r\n"); p && p[2] != '\r'; p = strstr(p + 2, "\r\n"))
        if (!strncasecmp(p + 2, name, n) && p[2 + n] == ':') {
            const char *v = p + 3 + n + strspn(p + 3 + n, " ");
            snprintf(r->value, sizeof r->value, "%.*s", (int)strcspn(v, "\r"), v);
        }
    return r->value;
}

/* Appends what arrives within `wait_s`. Returns false at the end of the stream. */
static inline bool hear_some(int fd, struct buf *b, double wait_s)
{
    struct pollfd p = {.fd = fd, .events = POLLIN};
    char bytes[65536];
    if (poll(&p, 1, (int)(wait_s * 1000)) != 1)
        return true;
    ssize_t n = recv(fd, bytes, sizeof bytes, 0);
    if (n > 0)
        buf_add(b, bytes, (size_t)n);
    return n > 0;
}

/* Reads one whole answer. `rest` (may be NULL) keeps bytes of the next answer of the connection. */
static inline void hear(int fd, bool has_body, struct buf *rest, struct reply *r)
{
    double end_s = clock_s() + PATIENCE_S;
    memset(r, 0, sizeof *r);
    if (rest) {
        r->raw = *rest;
        memset(rest, 0, sizeof *rest);
    }
    for (bool open = true;;) {
        buf_add(&r->raw, "", 1); /* ends the text for string functions */
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

/* Sends a request with extra header lines on its own connection. */
static inline void ask_port(uint16_t port, const char *method, const char *target,
                            const char *extra, struct reply *r)
{
    struct buf q = {0};
    int fd = dial(port);
    buf_printf(&q, "%s %s HTTP/1.1\r\nHost: localhost\r\n%sConnection: close\r\n\r\n", method,
               target, extra);
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, strcmp(method, "HEAD") != 0, NULL, r);
    buf_free(&q);
    close(fd);
}

/* One request with a body on a connection of its own; r->raw is the caller's. */
static inline int say_to(uint16_t port, const char *method, const char *target, const char *extra,
                         const char *body, struct reply *r)
{
    struct buf q = {0};
    int fd = dial(port);
    buf_printf(&q, "%s %s HTTP/1.1\r\nHost: localhost\r\n%sConnection: close\r\n", method, target,
               extra);
    if (body)
        buf_printf(&q, "Content-Length: %zu\r\n", strlen(body));
    buf_printf(&q, "\r\n%s", body ? body : "");
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, true, NULL, r);
    buf_free(&q);
    close(fd);
    return r->status;
}

/* Posts a text. Returns the status. */
static inline int post_text(const char *target, const char *text, struct reply *r)
{
    struct buf q = {0};
    int fd = dial(t.port);
    buf_printf(&q,
               "POST %s HTTP/1.1\r\nHost: test\r\nConnection: close\r\n"
               "Content-Length: %zu\r\n\r\n%s",
               target, strlen(text), text);
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, true, NULL, r);
    buf_free(&q);
    close(fd);
    return r->status;
}

static inline void ask(const char *method, const char *target, const char *extra, struct reply *r)
{
    ask_port(t.port, method, target, extra, r);
}

static inline int status_of(const char *method, const char *target, const char *extra)
{
    struct reply r;
    ask(method, target, extra, &r);
    buf_free(&r.raw);
    return r.status;
}

/* The revision in addresses with this edition: "REV-EDITION", or "REV" while there is none. Valid
 * until the next call. */
static inline const char *revision_of(enum edition of)
{
    static char text[32];
    char edition[9] = "";
    struct services *s =
        t.server ? server_services(t.server) : NULL; /* NULL: the server is another process */
    struct catalog *c = s ? services_catalog(s) : NULL;
    for (size_t i = 0; c && i < c->n; i++)
        if (!strcmp(c->ds[i]->meta.revision, t.rev))
            response_edition(s, c->ds[i], of, edition);
    if (c)
        catalog_drop(&c);
    snprintf(text, sizeof text, "%s%s%s", t.rev, *edition ? "-" : "", edition);
    return text;
}

static inline const char *tile_target(uint8_t z, const char *ext, char out[128])
{
    struct key k = served_key(z);
    snprintf(out, 128, "/d/toy/r/%s/t/%u/%u/%u.%s", revision_of(EDITION_TILES), k.z, k.x, k.y, ext);
    return out;
}

/* ---- the server ---- */

static inline void start(void)
{
    struct err e = {0};
#ifdef OVER_TLS
    tunnel_pair(t.dir, "toy", 90, t.cert, t.key);
    t.cfg.tls_cert = t.cert;
    t.cfg.tls_key = t.key;
#endif
    kit_ok(server_start(&t.cfg, t.paths, 1, &t.server, &e), e);
    const char *colon = strrchr(server_url(t.server), ':');
    t.port = (uint16_t)atoi(colon + 1);
#ifdef OVER_TLS
    tunnels_open(&t.tunnels, t.port);
    t.port = t.tunnels.port;
#endif
    struct catalog *c = services_catalog(server_services(t.server));
    memcpy(t.rev, c->ds[0]->meta.revision, sizeof t.rev);
    catalog_drop(&c);
}

/* Starts the server with pictures. If there is no device it prints that and returns false. It waits
 * until the process that draws has started, so that the start does not count against the first
 * request's deadline. */
static inline bool start_with_device(void)
{
    struct err e = {0};
    struct dev dev;
    if (t.server)
        return true; /* that of the test before: SHARED_TEST */
    if (dev_open("cpu", &dev, &e) != ERR_OK) {
        print_message("skipped: %s\n", e.msg);
        return false;
    }
    dev_close(&dev);
    t.cfg.device = "cpu";
    start();
    const struct picture *p = server_services(t.server)->picture;
    for (double end_s = clock_s() + 60; picture_state(p) == PICTURE_STARTING && clock_s() < end_s;)
        nap_ms(20);
    return true;
}

/* Number of open file descriptors of this process. */
static inline size_t open_files(void)
{
    size_t n = 0;
    DIR *d = opendir("/proc/self/fd");
    assert_non_null(d);
    while (readdir(d))
        n++;
    closedir(d);
    return n;
}

static inline int setup_all(void **state)
{
    struct err e = {0};
    log_set_level(LOG_ERROR);
    kit_tmpdir(t.dir);
    kit_ok(file_join(t.path, t.dir, "toy.tiles", &e), e);
    served_city(t.path, "toy", 2000);
    t.paths[0] = t.path;
    return 0;
}

static inline int teardown_all(void **state)
{
    kit_rmdir(t.dir);
    return 0;
}

static inline int setup(void **state)
{
    struct err e = {0};
    arena_free(&t.arena);
    served_config(&t.cfg, &t.arena);
    kit_ok(file_mkdir(t.dir, &e), e);
    t.cfg.web_dir = NULL;
    t.cfg.workers = 2;
    t.cfg.http_threads = 2;
    return 0;
}

static inline int teardown(void **state)
{
#ifdef OVER_TLS
    if (t.server)
        tunnels_close(&t.tunnels);
#endif
    server_stop(&t.server);
    arena_free(&t.arena);
    return 0;
}

static inline uint64_t connections(void)
{
    return atomic_load(&server_services(t.server)->metrics.connections);
}

static inline void await_no_connections(void)
{
    kit_await(!connections());
}

/* Parts of most requests. */
#define H "Host: a\r\n"
#define POST "POST /d/toy/render HTTP/1.1\r\n" H
#define HTTP_TEST(f) cmocka_unit_test_setup_teardown(f, setup, teardown)

/* Successive tests that share one server, because a process that draws takes a second of processor
 * time to start. The first test starts the server, and SHARED_LAST stops it. */
static inline int setup_shared(void **state)
{
    return t.server ? 0 : setup(state);
}
#define SHARED_TEST(f) cmocka_unit_test_setup_teardown(f, setup_shared, NULL)
#define SHARED_LAST(f) cmocka_unit_test_setup_teardown(f, setup_shared, teardown)

#endif
