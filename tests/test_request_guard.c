/* Clients that make mistakes, are slow, or are many: malformed requests, oversized ones, random
 * bytes, slow headers, slow bodies, slow readers, too many connections.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/client.h"

#include "server/base/text.h"

/* ---- malformed requests ---- */

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
    for (const char *p = strstr((char *)b.data, "HTTP/1."); p;
         p = strstr(p + 1, "HTTP/1."), count++)
        if (atoi(p + 9) != status)
            fail_msg("%s: got %d, want %d", what, atoi(p + 9), status);
    if (count != (status > 0)) /* two would be a second request, or one answered twice */
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
        {"length and coding",
         POST "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n"
              "GET /healthz HTTP/1.1\r\n" H "\r\n",
         400, true},
        {"coding and length",
         POST "Transfer-Encoding: chunked\r\nContent-Length: 40\r\n\r\n0\r\n\r\n"
              "GET /healthz HTTP/1.1\r\n" H "\r\n",
         400, true},
        {"two lengths", POST "Content-Length: 5\r\nContent-Length: 6\r\n\r\nhello1", 400, true},
        {"two equal lengths", POST "Content-Length: 5\r\nContent-Length: 5\r\n\r\nhello", 400,
         true},
        {"length before space", POST "Content-Length : 5\r\n\r\nhello", 400, true},
        {"length +5", POST "Content-Length: +5\r\n\r\nhello", 400, true},
        {"length -1", POST "Content-Length: -1\r\n\r\nhello", 400, true},
        {"length 0x5", POST "Content-Length: 0x5\r\n\r\nhello", 400, true},
        {"length 5,5", POST "Content-Length: 5,5\r\n\r\nhello", 400, true},
        {"length beyond 64 bits", POST "Content-Length: 99999999999999999999\r\n\r\nhello", 413,
         true},
        {"length beyond the limit", POST "Content-Length: 1000000\r\n\r\nhello", 413, true},
        /* what is refused by its head is not told to go on */
        {"expected length beyond the limit",
         POST "Expect: 100-continue\r\nContent-Length: 1000000\r\n\r\n", 413, true},
        {"expected length twice",
         POST "Expect: 100-continue\r\nContent-Length: 5\r\nContent-Length: 5\r\n\r\n", 400, true},
        {"expected by an unknown method",
         "FOO /d/toy/render HTTP/1.1\r\n" H "Expect: 100-continue\r\nContent-Length: 2\r\n\r\n",
         501, true},
        {"expected in 1.0",
         "POST /d/toy/render HTTP/1.0\r\n" H "Expect: 100-continue\r\nContent-Length: 2\r\n\r\n{}",
         422, false},
        {"expects something else", "GET /healthz HTTP/1.1\r\n" H "Expect: 200-maybe\r\n\r\n", 200,
         false},
        {"two codings", POST "Transfer-Encoding: gzip, chunked\r\n\r\n0\r\n\r\n", 501, true},
        {"coding twice",
         POST "Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400,
         true},
        {"unknown coding", POST "Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n", 501, true},
        {"bad chunk", POST "Transfer-Encoding: chunked\r\n\r\nZZ\r\n{}\r\n0\r\n\r\n", 400, true},
        {"negative chunk", POST "Transfer-Encoding: chunked\r\n\r\n-2\r\n{}\r\n0\r\n\r\n", 400,
         true},
        {"chunked in 1.0",
         "POST /d/toy/render HTTP/1.0\r\n" H "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400,
         true},
        {"body of GET", "GET /healthz HTTP/1.1\r\n" H "Content-Length: 3\r\n\r\nabc", 400, true},
        {"chunked GET", "GET /healthz HTTP/1.1\r\n" H "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
         400, true},
        {"no host", "GET /healthz HTTP/1.1\r\n\r\n", 400, true},
        {"two hosts", "GET /healthz HTTP/1.1\r\n" H "Host: b\r\n\r\n", 400, true},
        {"unknown method", "FOO /healthz HTTP/1.1\r\n" H "\r\n", 501, true},
        {"method with dirt", "helloGET /healthz HTTP/1.1\r\n" H "\r\n", 501, true},
        {"lower case", "get /healthz HTTP/1.1\r\n" H "\r\n", 501, true},
        {"absolute form", "GET http://a/healthz HTTP/1.1\r\n" H "\r\n", 200, false},
        {"absolute form without a path", "GET http://a HTTP/1.1\r\n" H "\r\n", 200, false},
        {"absolute form with a query", "GET HTTP://a?x HTTP/1.1\r\n" H "\r\n", 200, false},
        {"absolute form of nothing", "GET http:/healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"absolute form with a name", "GET http://a@b/healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"absolute form, no host", "GET http://a/healthz HTTP/1.1\r\n\r\n", 400, true},
        {"absolute form, metrics", "GET http://a/metrics HTTP/1.1\r\n" H "\r\n", 403, false},
        {"ftp", "GET ftp://a/healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"host with a space", "GET /healthz HTTP/1.1\r\nHost: a b\r\n\r\n", 400, true},
        {"host with a path", "GET /healthz HTTP/1.1\r\nHost: a/b\r\n\r\n", 400, true},
        {"empty host", "GET /healthz HTTP/1.1\r\nHost:\r\n\r\n", 200, false},
        {"two spaces", "GET  /healthz HTTP/1.1\r\n" H "\r\n", 400, true},
        {"LF behind a chunk's size", POST "Transfer-Encoding: chunked\r\n\r\n2\n{}\r\n0\r\n\r\n",
         400, true},
        {"LF behind a chunk", POST "Transfer-Encoding: chunked\r\n\r\n2\r\n{}\n0\r\n\r\n", 400,
         true},
        {"If-Match of another", "GET /collections HTTP/1.1\r\n" H "If-Match: \"x\"\r\n\r\n", 412,
         false},
        {"If-Match of any", "GET /collections HTTP/1.1\r\n" H "If-Match: *\r\n\r\n", 200, false},
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
        {"chunk extension", POST "Transfer-Encoding: chunked\r\n\r\n2;a=b\r\n{}\r\n0\r\n\r\n", 422,
         false},
        {"length 4, 4", POST "Content-Length: 4, 4\r\n\r\nhell", 400, true},
        {"length empty", POST "Content-Length:\r\n\r\nhello", 400, true},
        {"length with space behind", POST "Content-Length: 2 \r\n\r\n{}", 422, false},
        {"empty name", "GET /healthz HTTP/1.1\r\n" H ": x\r\nGET /version HTTP/1.1\r\n" H "\r\n",
         400, true},
        {"folded field", "GET /healthz HTTP/1.1\r\n" H "X: a\r\n b\r\n\r\n", 400, true},
        {"line of spaces", "GET /healthz HTTP/1.1\r\n" H " \r\n\r\n", 400, true},
        {"chunk without end", POST "Transfer-Encoding: chunked\r\n\r\n2\r\n{}x\r\n0\r\n\r\n", 400,
         true},
        {"trailer without name",
         POST "Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n: x\r\n\r\n", 400, true},
        {"half a request", "GET /healthz HT", 0, false},
        {"nothing", "", 0, false},
    };
    (void)state;
    start();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        probe(rows[i].what, rows[i].bytes, strlen(rows[i].bytes), rows[i].status, rows[i].close);
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* A client that waits is told to go on when its head is sound, and then answered. */
static void test_expect(void **state)
{
    struct reply r;
    (void)state;
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

/* A NUL in each part of a request; the C library's text functions stop at it, a proxy does not. */
static void test_nul_bytes(void **state)
{
    static const struct {
        const char *what, *bytes; /* '~' stands for NUL */
    } rows[] = {
        {"method", "GE~T /healthz HTTP/1.1\r\n" H "\r\n"},
        {"target", "GET /healthz~x HTTP/1.1\r\n" H "\r\n"},
        {"version", "GET /healthz HTTP/1.1~x\r\n" H "\r\n"},
        {"host", "GET /healthz HTTP/1.1\r\nHost: a~b\r\n\r\n"},
        {"length", POST "Content-Length: 4~x\r\n\r\nhell"},
        {"coding", POST "Transfer-Encoding: chunked~x\r\n\r\n0\r\n\r\n"},
        {"name", "GET /healthz HTTP/1.1\r\n" H "X~: x\r\n\r\n"},
        {"first of a name",
         "GET /healthz HTTP/1.1\r\n" H "~: x\r\nGET /version HTTP/1.1\r\n" H "\r\n"},
        {"chunk", POST "Transfer-Encoding: chunked\r\n\r\n2~\r\n{}\r\n0\r\n\r\n"},
    };
    char bytes[256];
    (void)state;
    start();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        size_t n = strlen(rows[i].bytes);
        memcpy(bytes, rows[i].bytes, n);
        for (size_t k = 0; k < n; k++)
            if (bytes[k] == '~')
                bytes[k] = '\0';
        probe(rows[i].what, bytes, n, 400, true);
    }
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* A request reads the same however its bytes are cut into packets, and requests behind each other
 * on a connection are told apart: the third of these is malformed, the first two are answered. */
static void test_cut_and_pipelined(void **state)
{
    static const char all[] = "GET /healthz HTTP/1.1\r\n" H "\r\n" POST
                              "Transfer-Encoding: chunked \r\n\r\n1\r\n{\r\n1;x\r\n}\r\n0\r\nT: "
                              "x\r\n\r\n" POST "Content-Length: 2x\r\n\r\n{}"
                              "GET /healthz HTTP/1.1\r\n" H "\r\n";
    (void)state;
    start();
    for (size_t step = 1; step < sizeof all; step = step * 3 + 1) {
        struct buf b = {0}, statuses = {0};
        int fd = dial(t.port);
        bool open = true;
        for (size_t at = 0; at < sizeof all - 1; at += step) {
            say_bytes(fd, all + at, at + step < sizeof all - 1 ? step : sizeof all - 1 - at);
            nap_ms(1);
        }
        for (double end_s = clock_s() + PATIENCE_S; open && clock_s() < end_s;)
            open = hear_some(fd, &b, 0.2);
        assert_false(open);
        buf_add(&b, "", 1);
        for (const char *p = strstr((char *)b.data, "HTTP/1."); p; p = strstr(p + 1, "HTTP/1."))
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
    (void)state;
    start();
    for (int n = 10; n <= 600; n += 590) {
        b.size = 0;
        buf_printf(&b, "GET /healthz?");
        for (int i = 0; i < n; i++)
            buf_printf(&b, "&a");
        buf_printf(&b, " HTTP/1.1\r\n" H "\r\n");
        probe("keys", (char *)b.data, b.size, n < 64 ? 200 : 400, n >= 64);
    }
    buf_free(&b);
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
    static const char good[] =
        POST "Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{}"
             "GET /collections HTTP/1.1\r\n" H "Accept-Encoding: gzip\r\n\r\n";
    (void)state;
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
    (void)state;
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
    (void)state;
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
        HTTP_TEST(test_expect),
        HTTP_TEST(test_nul_bytes),
        HTTP_TEST(test_cut_and_pipelined),
        HTTP_TEST(test_many_keys),
        HTTP_TEST(test_oversized_requests),
        HTTP_TEST(test_any_bytes),
        HTTP_TEST(test_slow_clients_are_cut),
        HTTP_TEST(test_a_client_that_does_not_read),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
