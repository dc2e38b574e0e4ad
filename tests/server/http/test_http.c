/* The HTTP layer over loopback: headers of every kind of answer, keep-alive and pipelining, single
 * flight, clients that vanish, starting, reloading, draining.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>

#include "core/pool.h"
#include "lod/store/key.h"

/* ---- answers ---- */

/* How many results of this process lie in files of memory. */
static size_t results_in_files(void)
{
    char path[64], to[64];
    size_t n = 0;
    for (int fd = 0; fd < 256; fd++) {
        snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
        const ssize_t size = readlink(path, to, sizeof to - 1);
        to[size > 0 ? size : 0] = '\0';
        n += strstr(to, "citysplat-result") != NULL;
    }
    return n;
}

/* A large result comes from memory by a file: the same bytes as when it was made, in parts, too,
 * and with nothing left open. */
static void test_large_answers(void **state)
{
    enum { AGAIN = 50, FROM = 70000, TO = 170000 };
    struct reply first, r;
    char target[128], line[64];
    start();
    ask("GET", tile_target(17, "ply", target), "", &first);
    assert_int_equal(first.status, 200);
    assert_true(first.body_size > TO);
    assert_int_equal(results_in_files(), 1);
    for (int i = 0; i < AGAIN; i++) {
        ask("GET", target, "", &r);
        assert_int_equal(r.status, 200);
        assert_int_equal(r.body_size, first.body_size);
        assert_memory_equal(r.body, first.body, r.body_size);
        buf_free(&r.raw);
    }
    snprintf(line, sizeof line, "Range: bytes=%d-%d\r\n", FROM, TO - 1);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 206);
    assert_int_equal(r.body_size, TO - FROM);
    assert_memory_equal(r.body, first.body + FROM, r.body_size);
    buf_free(&r.raw);
    ask("HEAD", target, "", &r);
    assert_int_equal(r.status, 200);
    assert_int_equal(atoll(header(&r, "Content-Length")), first.body_size);
    buf_free(&r.raw);
    buf_free(&first.raw);
    kit_await(results_in_files() == 1); /* answers end a moment after their last byte */
    server_stop(&t.server);
    assert_int_equal(results_in_files(), 0);
}

static void test_headers(void **state)
{
    struct reply r;
    char target[128];
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
    const char *shown = header(&r, "Access-Control-Expose-Headers");
    assert_non_null(strstr(shown, "Link,"));
    assert_non_null(strstr(shown, "Location,"));
    char etag[64], line[128];
    snprintf(etag, sizeof etag, "%s", header(&r, "ETag"));
    size_t size = r.body_size;
    buf_free(&r.raw);

    ask("HEAD", target, "", &r); /* the same headers, no bytes */
    assert_int_equal(r.status, 200);
    assert_int_equal(atoll(header(&r, "Content-Length")), size);
    assert_string_equal(header(&r, "ETag"), etag);
    assert_int_equal(r.raw.size, (size_t)(r.body - r.raw.data));
    buf_free(&r.raw);

    snprintf(line, sizeof line, "If-None-Match: \"x\", W/%s\r\n", etag);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 304);
    assert_string_equal(header(&r, "ETag"), etag);
    assert_string_equal(header(&r, "Cache-Control"), "public, max-age=31536000, immutable");
    assert_int_equal(atoll(header(&r, "Content-Length")), size); /* or nothing, but never 0 */
    assert_int_equal(r.raw.size, (size_t)(r.body - r.raw.data));
    buf_free(&r.raw);

    snprintf(line, sizeof line, "Range: bytes=10-19\r\nIf-Range: %s\r\n", etag);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 206);
    assert_int_equal(r.body_size, 10);
    snprintf(line, sizeof line, "bytes 10-19/%zu", size);
    assert_string_equal(header(&r, "Content-Range"), line);
    buf_free(&r.raw);

    ask("GET", target, "Range: bytes=99999999-\r\n", &r);
    assert_int_equal(r.status, 416);
    snprintf(line, sizeof line, "bytes */%zu", size);
    assert_string_equal(header(&r, "Content-Range"), line);
    buf_free(&r.raw);

    ask("OPTIONS", "/d/toy/render", "Access-Control-Request-Method: POST\r\n", &r);
    assert_int_equal(r.status, 204);
    assert_string_equal(header(&r, "Allow"), "POST, OPTIONS");
    assert_string_equal(header(&r, "Access-Control-Allow-Methods"), "POST, OPTIONS");
    assert_string_equal(header(&r, "Access-Control-Max-Age"), "86400");
    assert_non_null(strstr(header(&r, "Access-Control-Allow-Headers"), "If-Match,"));
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

    snprintf(line, sizeof line, "/d/toy/t/%s", strstr(target, "/t/") + 3);
    ask("GET", line, "", &r);
    assert_int_equal(r.status, 307);
    assert_non_null(strstr(header(&r, "Location"), t.rev));
    buf_free(&r.raw);

    ask("GET", "/d/toy/static/13.4,52.5,99@0,-90/64x64.jpg", "", &r);
    assert_int_equal(r.status, 307);
    buf_free(&r.raw);
    snprintf(line, sizeof line, "/d/toy/r/%s/static/13.4,52.5,99@0,-90/64x64.jpg", t.rev);
    ask("GET", line, "", &r);
    assert_int_equal(r.status, 503); /* no device: tiles are served, pictures are not */
    assert_string_equal(header(&r, "Retry-After"), ""); /* nor after a while */
    buf_free(&r.raw);

    assert_int_equal(status_of("GET", "/metrics", ""), 200);
    static const char *const signs[] = {"X-Forwarded-For: 9.9.9.9\r\n",
                                        "X-Forwarded-Proto: https\r\n",
                                        "X-Forwarded-Host: a\r\n",
                                        "Forwarded: for=9.9.9.9\r\n",
                                        "Via: 1.1 a\r\n",
                                        "X-Real-IP: 9.9.9.9\r\n",
                                        "CF-Connecting-IP: 9.9.9.9\r\n",
                                        "True-Client-IP: 9.9.9.9\r\n",
                                        "Origin: https://evil.example\r\n"};
    for (size_t i = 0; i < sizeof signs / sizeof *signs; i++)
        assert_int_equal(status_of("GET", "/metrics", signs[i]), 403);
    static const struct {
        const char *request;
        int status;
    } hosts[] = {
        {"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nConnection: close\r\n\r\n", 200},
        {"GET /metrics HTTP/1.1\r\nHost: [::1]\r\nConnection: close\r\n\r\n", 200},
        {"GET /metrics HTTP/1.1\r\nHost: citysplat\r\nConnection: close\r\n\r\n", 403},
        {"GET /metrics HTTP/1.1\r\nHost: maps.example.org\r\nConnection: close\r\n\r\n", 403},
        /* what a bare proxy_pass of nginx sends */
        {"GET /metrics HTTP/1.0\r\nHost: 127.0.0.1:8080\r\nConnection: close\r\n\r\n", 403},
    };
    for (size_t i = 0; i < sizeof hosts / sizeof *hosts; i++) {
        int fd = dial(t.port);
        say(fd, hosts[i].request);
        hear(fd, true, NULL, &r);
        assert_int_equal(r.status, hosts[i].status);
        buf_free(&r.raw);
        close(fd);
    }
}

/* A tile that was never made answers 304 from the index, with no claim about its length. */
static void test_304_of_a_cold_tile(void **state)
{
    struct reply r;
    char target[128], line[128];
    struct job_stats before, after;
    start();
    ask("GET", tile_target(15, "spz", target), "", &r);
    snprintf(line, sizeof line, "If-None-Match: %s\r\n", header(&r, "ETag"));
    buf_free(&r.raw);
    server_stop(&t.server);
    start(); /* an empty cache */
    job_count(server_services(t.server)->jobs, &before);
    ask("GET", target, line, &r);
    assert_int_equal(r.status, 304);
    assert_string_equal(header(&r, "Content-Length"), "");
    buf_free(&r.raw);
    job_count(server_services(t.server)->jobs, &after);
    assert_int_equal(served_tiles(&after, JOB_OK), served_tiles(&before, JOB_OK));
}

static void test_keep_alive_and_pipelining(void **state)
{
    struct buf q = {0}, rest = {0};
    char target[128];
    t.cfg.requests_per_connection = 5;
    start();
    int fd = dial(t.port);
    for (int i = 0; i < 5; i++) /* hot and cold mixed, in one write */
        buf_printf(&q, "GET %s HTTP/1.1\r\n" H "\r\n",
                   i == 1   ? tile_target(16, "drc", target)
                   : i == 3 ? tile_target(16, "ply", target)
                            : "/healthz");
    say_bytes(fd, (char *)q.data, q.size);
    for (int i = 0; i < 5; i++) {
        struct reply r;
        hear(fd, true, &rest, &r);
        assert_int_equal(r.status, 200);
        assert_string_equal(header(&r, "Content-Type"),
                            i == 1 || i == 3 ? "application/octet-stream" : "application/json");
        assert_string_equal(header(&r, "Connection"),
                            i == 4 ? "close" : ""); /* the limit was reached */
        buf_free(&r.raw);
    }
    struct buf more = {0};
    assert_false(hear_some(fd, &more, PATIENCE_S));
    close(fd);
    buf_free(&q);
    buf_free(&rest);
    buf_free(&more);
}

/* One flipped bit, end to end: in every format the tile is refused by name, every other tile is
 * served whole, the log and `citysplat verify` say which it is and what to do. */
static void test_damaged_tile(void **state)
{
    static const char *const forms[] = {"glb", "spz", "drc", "ply", "plain.glb", "compressed.ply",
                                        "sog"};
    enum { FORMS = sizeof forms / sizeof *forms };
    struct err e = {0};
    char path[FILE_PATH_MAX], target[128], name[64], text[256];
    const struct key bad = served_key(17);
    struct buf said = {0};
    kit_ok(file_join(path, t.dir, "damaged.tiles", &e), e);
    served_city(path, "toy", 30);
    store_fixture_damage(path, bad, path);
    t.paths[0] = path;
    start();
    t.paths[0] = t.path;
    snprintf(name, sizeof name, "tile %u/%u/%u", bad.z, bad.x, bad.y);
    snprintf(text, sizeof text, "\"tile\":{\"z\":%u,\"x\":%u,\"y\":%u}", bad.z, bad.x, bad.y);
    for (size_t f = 0; f < FORMS; f++) {
        struct reply r;
        ask("GET", tile_target(17, forms[f], target), "", &r);
        assert_int_equal(r.status, 500);
        assert_string_equal(header(&r, "Content-Type"), "application/problem+json");
        assert_string_equal(header(&r, "Cache-Control"), "no-store");
        assert_string_equal(header(&r, "ETag"), "");
        buf_add(&r.raw, "", 1);
        assert_non_null(strstr((const char *)r.raw.data, name));
        assert_non_null(strstr((const char *)r.raw.data, text));
        assert_non_null(strstr((const char *)r.raw.data, "citysplat verify"));
        buf_free(&r.raw);
        for (uint8_t z = 15; z <= 16; z++)
            assert_int_equal(status_of("GET", tile_target(z, forms[f], target), ""), 200);
    }
    /* Its sibling, which lies beside it in the file. */
    snprintf(target, sizeof target, "/d/toy/r/%s/t/%u/%u/%u.glb", t.rev, bad.z, bad.x ^ 1, bad.y);
    assert_int_equal(status_of("GET", target, ""), 200);
    assert_int_equal(atomic_load(&server_services(t.server)->metrics.store_errors), FORMS);
    server_stop(&t.server);
    assert_true(kit_run(&said, "'%s' verify -q '%s' 2>&1", kit_program(), path) > 0);
    kit_expect_text((const char *)said.data, name, __FILE__, __LINE__);
    kit_expect_text((const char *)said.data, "hash", __FILE__, __LINE__);
    kit_expect_text((const char *)said.data, "tile the scene again", __FILE__, __LINE__);
    buf_free(&said);
}

/* ---- jobs ---- */

/* Everybody asks for the same tile, which nobody has made, at the same moment. */
static void test_one_job_for_many_clients(void **state)
{
    enum { CLIENTS = 100 };
    int fd[CLIENTS];
    char target[128], request[256];
    struct reply first = {0};
    struct job_stats st;
    start();
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             tile_target(17, "ply", target));
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
    assert_in_range(served_tiles(&st, JOB_OK), 1,
                    2); /* 2: asked between the end of one and the cache */
    await_no_connections();
}

enum { CLIENTS = 4, ASKED = 250 };
static char shared_target[3][128];
static size_t shared_size[3];

/* One client on a connection of its own; the returned error stands for a wrong answer. */
static enum err_code shared_client(void *user, size_t i, struct err *e)
{
    int fd = dial(t.port);
    struct buf rest = {0};
    size_t wrong = 0;
    (void)user;
    for (size_t k = 0; k < ASKED; k++) {
        const size_t which = (k / 3 + i) % 3;
        struct buf q = {0};
        struct reply r;
        buf_printf(&q, "GET %s HTTP/1.1\r\n" H "%s\r\n", shared_target[which],
                   k % 3 == 2 ? "If-None-Match: *\r\n" : "");
        say_bytes(fd, (char *)q.data, q.size);
        hear(fd, true, &rest, &r);
        wrong += r.status != (k % 3 == 2 ? 304 : 200) ||
                 (r.status == 200 && r.body_size != shared_size[which]);
        buf_free(&q);
        buf_free(&r.raw);
    }
    buf_free(&rest);
    close(fd);
    return wrong ? err_set(e, ERR_INTERNAL, "%zu wrong answers", wrong) : ERR_OK;
}

/* A tile that nobody has made since the start, and that the client has: a head, and not one byte
 * behind it that would be the beginning of the next answer. */
static void test_304_of_what_was_not_made(void **state)
{
    char target[128], etag[BODY_ETAG_SIZE], line[400];
    struct reply r;
    struct buf got = {0};
    start();
    ask("GET", tile_target(17, "glb", target), "", &r);
    snprintf(etag, sizeof etag, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    server_stop(&t.server);
    start();
    int fd = dial(t.port);
    snprintf(line, sizeof line, "GET %s HTTP/1.1\r\n" H "If-None-Match: %s\r\n\r\n", target, etag);
    say(fd, line);
    shutdown(fd, SHUT_WR);
    while (hear_some(fd, &got, 1))
        ;
    buf_u8(&got, 0);
    const char *text = (const char *)got.data, *end = strstr(text, "\r\n\r\n");
    assert_int_equal(strncmp(text, "HTTP/1.1 304 ", 13), 0);
    assert_non_null(end);
    assert_string_equal(end, "\r\n\r\n");
    assert_null(strstr(text, "Transfer-Encoding"));
    assert_null(strstr(text, "\r\nContent-Length"));
    buf_free(&got);
    close(fd);
}

/* Kept answers go out from several threads at once. */
static void test_shared(void **state)
{
    static const char *const exts[3] = {"spz", "glb", "drc"};
    struct err e = {0};
    start();
    for (size_t i = 0; i < 3; i++) {
        struct reply r;
        ask("GET", tile_target(17, exts[i], shared_target[i]), "", &r);
        shared_size[i] = r.body_size;
        buf_free(&r.raw);
    }
    kit_ok(pool_for(CLIENTS, CLIENTS, shared_client, NULL, &e), e);
}

/* Clients that reset the connection while their tiles wait leave nothing behind. */
static void test_vanishing_clients(void **state)
{
    static const char *const exts[] = {"glb", "spz", "drc", "ply", "plain.glb", "compressed.ply",
                                       "sog"};
    const struct linger reset = {.l_onoff = 1, .l_linger = 0};
    t.cfg.workers = 1;
    start();
    struct services *s = server_services(t.server);
    for (int round = 0; round < 4; round++) {
        int fd[15], n = 0;
        for (int f = 0; f < 5; f++)
            for (uint8_t z = 15; z <= 17; z++) {
                char target[128], request[256];
                snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
                         tile_target(z, exts[f], target));
                fd[n] = dial(t.port);
                say(fd[n++], request);
            }
        nap_ms(round * 3);
        for (int i = 0; i < n; i++) {
            setsockopt(fd[i], SOL_SOCKET, SO_LINGER, &reset, sizeof reset);
            close(fd[i]);
        }
        await_no_connections();
    }
    assert_int_equal(atomic_load(&s->metrics.inflight), 0);
    kit_await(job_idle(s->jobs));
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* ---- start and stop ---- */

static void test_busy_port(void **state)
{
    struct err e = {0};
    struct server *second = NULL;
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
    static const char *const exts[] = {"glb", "spz", "drc", "ply", "plain.glb", "compressed.ply",
                                       "sog"};
    struct err e = {0};
    int fd[20], idle;
    t.cfg.workers = 1;
    start();
    idle = dial(t.port);
    for (int i = 0; i < 20; i++) {
        char target[128], request[256];
        snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
                 tile_target((uint8_t)(15 + i % 3), exts[i % 6], target));
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

/* Wait until a file holds this text. */
static void await_text(const char *path, const char *text)
{
    struct err e = {0};
    bool found = false;
    for (double end_s = clock_s() + PATIENCE_S; !found && clock_s() < end_s;) {
        struct buf b = {0};
        nap_ms(5);
        kit_ok(file_read(path, 0, &b, &e), e);
        buf_add(&b, "", 1);
        found = strstr((char *)b.data, text);
        buf_free(&b);
    }
    if (!found)
        fail_msg("%s: '%s' did not come", path, text);
}

/* The program itself: prints where it listens, logs which tile is damaged and what to do, drains on
 * SIGTERM, exits 0. */
static void test_program(void **state)
{
    const char *program = kit_program();
    int out[2], status = -1;
    char line[256] = "", target[128], request[256], log[FILE_PATH_MAX];
    struct err e = {0};
    start();
    server_stop(&t.server); /* for the revision alone */
    char damaged[FILE_PATH_MAX];
    const struct key bad = served_key(15);
    kit_ok(file_join(damaged, t.dir, "bad.tiles", &e), e);
    served_city(damaged, "toy", 2000);
    store_fixture_damage(damaged, bad, damaged);
    kit_ok(file_join(log, t.dir, "serve.log", &e), e);
    assert_int_equal(pipe(out), 0);
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        dup2(out[1], 1);
        close(out[0]);
        if (!freopen(log, "w", stderr))
            _exit(126);
        execl(program, program, "serve", damaged, "--port", "0", "--device", "none", (char *)NULL);
        _exit(127);
    }
    close(out[1]);
    FILE *f = fdopen(out[0], "r");
    assert_non_null(fgets(line, sizeof line, f));
    const char *colon = strrchr(line, ':');
    assert_non_null(colon);
    uint16_t port = (uint16_t)atoi(colon + 1);
    assert_int_equal(kill(pid, SIGHUP), 0); /* opens the stores again, and goes on */
    await_text(log, "info serve reloaded");
    int fd = dial(port);
    struct buf rest = {0}, end = {0};
    struct reply r;
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             tile_target(15, "drc", target));
    say(fd, request);
    hear(fd, true, &rest, &r);
    assert_int_equal(r.status, 500);
    buf_free(&r.raw);
    snprintf(line, sizeof line, "job failed ds=toy tile %u/%u/%u.drc: ", bad.z, bad.x, bad.y);
    await_text(log, line);
    await_text(log, "damaged (its hash differs); restore the file or tile the scene again");
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             tile_target(17, "ply", target));
    say(fd, request);
    while (!rest.size) /* the answer has begun */
        assert_true(hear_some(fd, &rest, PATIENCE_S));
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
    struct buf said = {0};
    kit_ok(file_read(log, 0, &said, &e), e);
    buf_add(&said, "", 1);
    snprintf(line, sizeof line, "http GET %.150s status=200 bytes=%zu ", target, r.body_size);
    assert_non_null(strstr((char *)said.data, line)); /* the last request is in the log, too */
    buf_free(&said);
    close(fd);
    fclose(f);
}

/* With fewer descriptors than its options need, new clients are served all the same: idle
 * connections give way before accept() fails. The soft limit is raised where that is allowed. */
static void test_few_descriptors(void **state)
{
    enum { IDLE = 200 };
    int out[2], status = -1, idle[IDLE];
    char line[256] = "", log[FILE_PATH_MAX];
    struct err e = {0};
    struct rlimit soft, was;
    kit_ok(file_join(log, t.dir, "few.log", &e), e);
    assert_int_equal(pipe(out), 0);
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        const struct rlimit few = {150, 150};
        dup2(out[1], 1);
        close(out[0]);
        if (!freopen(log, "w", stderr) || setrlimit(RLIMIT_NOFILE, &few))
            _exit(126);
        execl(kit_program(), kit_program(), "serve", t.path, "--port", "0", "--device", "none",
              "--workers", "2", (char *)NULL);
        _exit(127);
    }
    close(out[1]);
    FILE *f = fdopen(out[0], "r");
    assert_non_null(fgets(line, sizeof line, f));
    uint16_t port = (uint16_t)atoi(strrchr(line, ':') + 1);
    await_text(log, "descriptors limit=150");
    for (int i = 0; i < IDLE; i++)
        idle[i] = dial(port);
    int fd = dial(port);
    struct reply r;
    struct buf rest = {0};
    double asked_s = clock_s();
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    hear(fd, true, &rest, &r);
    assert_int_equal(r.status, 200);
    assert_true(clock_s() - asked_s < 3); /* --header-timeout-s, which closes idle ones, is 5 */
    buf_free(&r.raw);
    buf_free(&rest);
    for (int i = 0; i < IDLE; i++)
        close(idle[i]);
    close(fd);
    assert_int_equal(kill(pid, SIGTERM), 0);
    assert_int_equal(waitpid(pid, &status, 0), pid);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    fclose(f);

    assert_int_equal(getrlimit(RLIMIT_NOFILE, &was), 0);
    soft = (struct rlimit){512, was.rlim_max};
    assert_int_equal(setrlimit(RLIMIT_NOFILE, &soft), 0);
    start();
    assert_int_equal(getrlimit(RLIMIT_NOFILE, &soft), 0);
    assert_true(soft.rlim_cur > 512 || was.rlim_max <= 512);
    setrlimit(RLIMIT_NOFILE, &was);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_headers),
        HTTP_TEST(test_304_of_a_cold_tile),
        HTTP_TEST(test_keep_alive_and_pipelining),
        HTTP_TEST(test_damaged_tile),
        HTTP_TEST(test_one_job_for_many_clients),
        HTTP_TEST(test_304_of_what_was_not_made),
        HTTP_TEST(test_shared),
        HTTP_TEST(test_vanishing_clients),
        HTTP_TEST(test_large_answers),
        HTTP_TEST(test_busy_port),
        HTTP_TEST(test_stopping_finishes_answers),
        HTTP_TEST(test_program),
        HTTP_TEST(test_few_descriptors),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
