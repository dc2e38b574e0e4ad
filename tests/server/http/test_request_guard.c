/* Clients that make mistakes, are slow, or are many: malformed requests, oversized ones, random
 * bytes, slow headers, slow bodies, slow readers, too many connections.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include "server/base/text.h"
#include "server/http.h"

/* ---- malformed requests ---- */

/* A status line; libmicrohttpd's own pages speak of "HTTP/1.1" as well. */
static const char *next_answer(const char *text)
{
    const char *p = strstr(text, "HTTP/1.");
    while (p && (p[8] != ' ' || p[9] < '0' || p[9] > '9'))
        p = strstr(p + 1, "HTTP/1.");
    return p;
}

/* There must be one status line, and it must say `status` (0: no answer at all), and if `close`,
 * the stream ends. A request hidden in a body must not be answered: that would be a 200. */
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
    for (const char *p = next_answer((char *)b.data); p; p = next_answer(p + 1), count++)
        if (atoi(p + 9) != status)
            fail_msg("%s: got %d, want %d", what, atoi(p + 9), status);
    if (count != (status > 0)) /* two would be a second request, or one answered twice */
        fail_msg("%s: %d answers", what, count);
    buf_free(&b);
    close(fd);
}

/* Refused, once, and the connection ends: server/malformed.def. */
static void test_malformed_requests(void **state)
{
    static const struct {
        const char *what, *bytes;
        int status[2];
    } rows[] = {
#define MALFORMED(what, bytes, status, strict) {what, bytes, {status, strict}},
#include "server/malformed.def"
#undef MALFORMED
    };
    start();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char bytes[256];
        const size_t n = strlen(rows[i].bytes);
        memcpy(bytes, rows[i].bytes, n);
        for (size_t k = 0; k < n; k++)
            bytes[k] = bytes[k] == '~' ? '\0' : bytes[k];
        probe(rows[i].what, bytes, n, rows[i].status[http_is_strict()], true);
    }
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* What is missing, and limits in bytes. */
static void test_reasons_of_refusals(void **state)
{
    static const struct {
        const char *head, *says; /* an empty head is made of the next three */
        int target, fields, field;
    } rows[] = {
        {"GET /healthz HTTP/1.1\r\n\r\n", "needs the header field Host", 0, 0, 0},
        {POST "Content-Length: 65537\r\n\r\n", "the body is too large: at most 65536 bytes", 0, 0,
         0},
        {"", "target is too long: at most 2048 bytes", 3000, 0, 0},
        {"", "target is too long: at most 2048 bytes", 30000, 0, 0},
        {"", "too many header fields: at most 16384 bytes in all, and 64 fields", 1, 70, 1},
        {"", "a header field is too long: at most 16384 bytes in all, and 64 fields", 1, 1, 30000},
    };
    struct reply r;
    start();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct buf b = {0};
        if (rows[i].field > 1 && http_is_strict()) /* the library's own page */
            continue;
        int fd = dial(t.port);
        buf_printf(&b, "%s", rows[i].head);
        if (rows[i].target)
            buf_printf(&b, "GET /%0*d HTTP/1.1\r\n" H, rows[i].target, 0);
        for (int k = 0; k < rows[i].fields; k++)
            buf_printf(&b, "X: %0*d\r\n", rows[i].field, 0);
        if (rows[i].target)
            buf_printf(&b, "\r\n");
        say_bytes(fd, (const char *)b.data, b.size);
        hear(fd, true, NULL, &r);
        if (!strstr((const char *)r.body, rows[i].says))
            fail_msg("row %zu: want %s: %s", i, rows[i].says, (const char *)r.body);
        buf_free(&r.raw);
        buf_free(&b);
        close(fd);
    }
}

static void test_unusual_requests(void **state)
{
    const bool strict = http_is_strict();
    const struct {
        const char *what, *bytes;
        int status;
    } rows[] = {
        {"expected in 1.0",
         "POST /d/toy/render HTTP/1.0\r\n" H "Expect: 100-continue\r\nContent-Length: 2\r\n\r\n{}",
         422},
        {"expects something else", "GET /healthz HTTP/1.1\r\n" H "Expect: 200-maybe\r\n\r\n", 200},
        {"absolute form", "GET http://a/healthz HTTP/1.1\r\n" H "\r\n", 200},
        {"absolute form without a path", "GET http://a HTTP/1.1\r\n" H "\r\n", 200},
        {"absolute form with a query", "GET HTTP://a?x HTTP/1.1\r\n" H "\r\n", 200},
        {"absolute form, metrics", "GET http://a/metrics HTTP/1.1\r\n" H "\r\n", 403},
        {"empty host", "GET /healthz HTTP/1.1\r\nHost:\r\n\r\n", 200},
        {"If-Match of another", "GET /collections HTTP/1.1\r\n" H "If-Match: \"x\"\r\n\r\n", 412},
        {"If-Match of any", "GET /collections HTTP/1.1\r\n" H "If-Match: *\r\n\r\n", 200},
        {"percent", "GET /%2e%2e/etc/passwd HTTP/1.1\r\n" H "\r\n", 400},
        {"percent NUL", "GET /healthz%00x HTTP/1.1\r\n" H "\r\n", 400},
        {"dots", "GET /../../etc/passwd HTTP/1.1\r\n" H "\r\n", 400},
        {"space in target", "GET /a b HTTP/1.1\r\n" H "\r\n", 400},
        {"other method", "DELETE /healthz HTTP/1.1\r\n" H "\r\n", 405},
        {"HTTP/1.0", "GET /healthz HTTP/1.0\r\n\r\n", 200},
        {"bare LF", "GET /healthz HTTP/1.1\nHost: a\n\n", strict ? 400 : 200},
        {"line before", "\r\nGET /healthz HTTP/1.1\r\n" H "\r\n", 200},
        {"chunk extension", POST "Transfer-Encoding: chunked\r\n\r\n2;a=b\r\n{}\r\n0\r\n\r\n",
         strict ? 400 : 422}, /* allowed, but nobody sends one */
        {"length with space behind", POST "Content-Length: 2 \r\n\r\n{}", 422},
        {"half a request", "GET /healthz HT", 0},
        {"nothing", "", 0},
    };
    start();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        probe(rows[i].what, rows[i].bytes, strlen(rows[i].bytes), rows[i].status, false);
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* A client that waits is told to go on when its head is sound, and then answered. */
static void test_expect(void **state)
{
    struct reply r;
    start();
    int fd = dial(t.port);
    say(fd, POST "Expect: 100-continue\r\nContent-Length: 2\r\n\r\n");
    hear(fd, false, NULL, &r);
    assert_int_equal(r.status, 100);
    buf_free(&r.raw);
    say(fd, "{}");
    hear(fd, true, NULL, &r);
    assert_int_equal(r.status, 422);
    buf_free(&r.raw);
    close(fd);
}

/* A request reads the same however its bytes are cut into packets, and requests behind each other
 * on a connection are told apart: the third of these is malformed, the first two are answered. */
static void test_cut_and_pipelined(void **state)
{
    /* Version 1.0 of libmicrohttpd refuses extensions of chunks. */
    char all[512];
    const size_t n = (size_t)snprintf(
        all, sizeof all,
        "GET /healthz HTTP/1.1\r\n" H "\r\n" POST
        "Transfer-Encoding: chunked \r\n\r\n1\r\n{\r\n1%s\r\n}\r\n0\r\nT: x\r\n\r\n" POST
        "Content-Length: 2x\r\n\r\n{}GET /healthz HTTP/1.1\r\n" H "\r\n",
        http_is_strict() ? "" : ";x");
    start();
    for (size_t step = 1; step <= n; step = step * 3 + 1) {
        struct buf b = {0}, statuses = {0};
        int fd = dial(t.port);
        bool open = true;
        for (size_t at = 0; at < n; at += step) {
            say_bytes(fd, all + at, at + step < n ? step : n - at);
            nap_ms(1);
        }
        for (double end_s = clock_s() + PATIENCE_S; open && clock_s() < end_s;)
            open = hear_some(fd, &b, 0.2);
        assert_false(open);
        buf_add(&b, "", 1);
        for (const char *p = next_answer((char *)b.data); p; p = next_answer(p + 1))
            buf_printf(&statuses, "%d ", atoi(p + 9));
        assert_string_equal((const char *)statuses.data, "200 422 400 ");
        buf_free(&statuses);
        buf_free(&b);
        close(fd);
    }
}

/* Keys of a query take libmicrohttpd's memory: too many are answered, not hung up on. */
static void test_many_keys(void **state)
{
    struct buf b = {0};
    start();
    for (int n = 10; n <= 600; n += 590) {
        b.size = 0;
        buf_printf(&b, "GET /healthz?");
        for (int i = 0; i < n; i++)
            buf_printf(&b, "&a");
        buf_printf(&b, " HTTP/1.1\r\n" H "\r\n");
        probe("keys", (char *)b.data, b.size, n < 64 ? 200 : http_is_strict() ? 431 : 400, n >= 64);
    }
    buf_free(&b);
}

static void test_oversized_requests(void **state)
{
    struct buf b = {0};
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
    static const char good[] =
        POST "Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{}"
             "GET /collections HTTP/1.1\r\n" H "Accept-Encoding: gzip\r\n\r\n";
    t.cfg.header_timeout_s = t.cfg.body_timeout_s = 1;
    start();
    for (uint64_t batch = 0; batch < 10; batch++) {
        int fd[EACH];
        for (uint64_t i = 0; i < EACH; i++) {
            char bytes[sizeof good];
            memcpy(bytes, good, sizeof good);
            for (uint64_t k = 0; k < 1 + i % 5; k++)
                bytes[rng_u64(batch, 2 * k, i) % (sizeof good - 1)] =
                    (char)rng_u64(batch, 2 * k + 1, i);
            fd[i] = dial(t.port);
            say_bytes(fd[i], bytes, sizeof good - 1);
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

/* ---- slow clients ---- */

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
    double since_s = clock_s(); /* before the request: how late the answer is read does not count */
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    hear(fd, true, NULL, &r);
    assert_int_equal(r.status, 200);
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

/* Someone who does not read an answer is cut as well. The answer must not fit into socket buffers.
 */
static void test_a_client_that_does_not_read(void **state)
{
    char target[128], request[256];
    const int small = 4096;
    t.cfg.write_timeout_s = 0.1;
    start();
    int fd = dial(t.port);
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             tile_target(17, "spz", target));
    struct services *s = server_services(t.server);
    for (int i = 0; i < 300; i++)
        say(fd, request);
    for (double end_s = clock_s() + 60; !atomic_load(&s->metrics.reaped) && clock_s() < end_s;)
        nap_ms(20);
    assert_true(atomic_load(&s->metrics.reaped) >= 1);
    await_no_connections();
    close(fd);
}

/* Words of eight bytes and what is left of them: each byte at each place of each length. */
static void test_control_bytes(void **state)
{
    enum { LONGEST = 26 };
    char text[LONGEST];
    for (size_t n = 0; n <= LONGEST; n++)
        for (size_t at = 0; at < n; at++)
            for (int byte = 0; byte < 256; byte++) {
                memset(text, at % 2 ? '\t' : 'a', sizeof text);
                text[at] = (char)byte;
                if (text_is_clean(text, n) != ((byte >= 0x20 && byte != 0x7f) || byte == '\t'))
                    fail_msg("byte %d at %zu of %zu", byte, at, n);
            }
    assert_true(text_is_clean("\n", 0));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_control_bytes),
        HTTP_TEST(test_malformed_requests),
        HTTP_TEST(test_reasons_of_refusals),
        HTTP_TEST(test_unusual_requests),
        HTTP_TEST(test_expect),
        HTTP_TEST(test_cut_and_pipelined),
        HTTP_TEST(test_many_keys),
        HTTP_TEST(test_oversized_requests),
        HTTP_TEST(test_any_bytes),
        HTTP_TEST(test_slow_clients_are_cut),
        HTTP_TEST(test_a_client_that_does_not_read),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
