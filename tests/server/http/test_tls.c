/* TLS: the same bytes as without it, the screen in front of the parser, certificates that a reload
 * replaces, and what is refused. test_request_guard.c also runs over TLS (request_guard_tls).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _XOPEN_SOURCE 700 // NOLINT(cert-dcl51-cpp)
#include "tests/server/client.h"
#include "tests/server/tunnel.h"

static const char USUAL[] = "NORMAL";
static char cert[FILE_PATH_MAX], key[FILE_PATH_MAX];

static void start_tls(void)
{
    tunnel_pair(t.dir, "first", 90, cert, key);
    t.cfg.tls_cert = cert;
    t.cfg.tls_key = key;
    start();
    assert_memory_equal(server_url(t.server), "https://", 8);
}

static void say_tls(struct tunnel *x, const char *text, size_t n, size_t step)
{
    for (size_t at = 0; at < n; at += step) {
        size_t k = at + step < n ? step : n - at;
        if (gnutls_record_send(x->session, text + at, k) < 0)
            return; /* the server has closed */
    }
}

/* All that comes until the server closes. */
static void hear_tls(struct tunnel *x, struct buf *b)
{
    char bytes[16384];
    ssize_t n;
    do {
        n = gnutls_record_recv(x->session, bytes, sizeof bytes);
        if (n > 0)
            buf_add(b, bytes, (size_t)n);
    } while (n > 0 || n == GNUTLS_E_AGAIN || n == GNUTLS_E_INTERRUPTED);
    buf_add(b, "", 1);
    b->size--;
}

static size_t count(const struct buf *b, const char *word)
{
    size_t n = 0, k = strlen(word);
    for (size_t i = 0; i + k <= b->size; i++)
        n += !memcmp(b->data + i, word, k);
    return n;
}

static void test_same_bytes(void **state)
{
    char target[128], text[300];
    struct reply plain;
    start();
    ask("GET", tile_target(16, "plain.glb", target), "", &plain);
    assert_int_equal(plain.status, 200);
    assert_true(plain.body_size > 100000); /* many records */
    server_stop(&t.server);
    start_tls();
    for (int k = 0; k < 3; k++) {
        struct tunnel x;
        struct buf b = {0};
        assert_true(tunnel_open(&x, t.port, USUAL));
        int n = snprintf(text, sizeof text, "GET %s HTTP/1.1\r\n" H "Connection: close\r\n\r\n",
                         target);
        say_tls(&x, text, (size_t)n, k ? 1 : sizeof text);
        hear_tls(&x, &b);
        const char *end = strstr((char *)b.data, "\r\n\r\n");
        assert_non_null(end);
        assert_int_equal(b.size - (size_t)(end + 4 - (char *)b.data), plain.body_size);
        assert_memory_equal(end + 4, plain.body, plain.body_size);
        buf_free(&b);
        tunnel_close(&x);
    }
    buf_free(&plain.raw);
}

/* Twenty requests in one record, and in records of a few bytes. */
static void test_pipelined(void **state)
{
    enum { N = 20 };
    char target[128];
    struct buf ask_all = {0};
    start_tls();
    for (int i = 0; i < N; i++)
        buf_printf(&ask_all, "GET %s HTTP/1.1\r\n" H "%s\r\n", tile_target(17, "drc", target),
                   i == N - 1 ? "Connection: close\r\n" : "");
    for (size_t step = 3; step < 20000; step *= 40) {
        struct tunnel x;
        struct buf b = {0};
        assert_true(tunnel_open(&x, t.port, USUAL));
        say_tls(&x, (char *)ask_all.data, ask_all.size, step < 16384 ? step : 16384);
        hear_tls(&x, &b);
        assert_int_equal(count(&b, "HTTP/1.1 200 OK\r\n"), N);
        buf_free(&b);
        tunnel_close(&x);
    }
    buf_free(&ask_all);
}

/* Malformed before anybody parses it, however records cut it. */
static void test_the_screen_is_in_front(void **state)
{
    static const struct {
        const char *bytes; /* '~' stands for NUL */
        size_t n_answers;
    } rows[] = {
        {"GET /healthz HTTP/1.1\r\n" H "~: x\r\nGET /version HTTP/1.1\r\n" H "\r\n", 1},
        {POST "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n"
              "GET /healthz HTTP/1.1\r\n" H "\r\n",
         1},
        {POST "Content-Length: 2x\r\n\r\n{}GET /healthz HTTP/1.1\r\n" H "\r\n", 1},
        {"GET /healthz HTTP/1.1\r\n" H "\r\nGET /healthz HTTP/1.1\r\nHost: a~b\r\n\r\n", 2},
    };
    start_tls();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        for (size_t step = 1; step < 1000; step = step * 7 + 1) {
            struct tunnel x;
            struct buf b = {0};
            char bytes[400];
            size_t n = strlen(rows[i].bytes);
            memcpy(bytes, rows[i].bytes, n);
            for (size_t k = 0; k < n; k++)
                bytes[k] = bytes[k] == '~' ? '\0' : bytes[k];
            assert_true(tunnel_open(&x, t.port, USUAL));
            say_tls(&x, bytes, n, step);
            hear_tls(&x, &b);
            assert_int_equal(count(&b, "HTTP/1.1 "), rows[i].n_answers);
            assert_int_equal(count(&b, "HTTP/1.1 400 "), 1);
            buf_free(&b);
            tunnel_close(&x);
        }
    await_no_connections();
}

static void test_what_is_refused(void **state)
{
    static const char *const old[] = {"NORMAL:-VERS-ALL:+VERS-TLS1.1",
                                      "NORMAL:-VERS-ALL:+VERS-TLS1.0"};
    struct tunnel x;
    struct buf b = {0};
    char answer[16] = "";
    t.cfg.header_timeout_s = 0.4;
    start_tls();
    for (size_t i = 0; i < sizeof old / sizeof *old; i++) {
        assert_false(tunnel_open(&x, t.port, old[i]));
        tunnel_close(&x);
    }
    assert_true(tunnel_open(&x, t.port, "NORMAL:-VERS-ALL:+VERS-TLS1.2"));
    tunnel_close(&x);
    assert_true(tunnel_open(&x, t.port, "NORMAL:-VERS-ALL:+VERS-TLS1.3"));
    tunnel_close(&x);
    /* HTTP as it is gets nothing of it; a handshake that does not go on is ended. */
    int fd = dial(t.port), idle = dial(t.port);
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    say_bytes(idle, "\x16\x03\x01", 3);
    for (int k = 0; k < 2; k++) {
        bool open = true;
        for (double end_s = clock_s() + PATIENCE_S; open && clock_s() < end_s;)
            open = hear_some(k ? idle : fd, &b, 0.2);
        assert_false(open);
    }
    assert_int_equal(count(&b, "HTTP/1"), 0);
    buf_free(&b);
    close(fd);
    close(idle);
    fd = dial(t.port);
    assert_true(tls_ask(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n", answer, sizeof answer - 1));
    assert_memory_equal(answer, "HTTP/1.1 200", 12);
    close(fd);
    assert_true(server_answers(t.server, 5));
}

static void shown(const char *want)
{
    struct tunnel x;
    char name[80];
    assert_true(tunnel_open(&x, t.port, USUAL));
    tunnel_name(&x, name);
    assert_string_equal(name, want);
    tunnel_close(&x);
}

static void move(const char *from, const char *to)
{
    assert_int_equal(rename(from, to), 0);
}

static void test_reload(void **state)
{
    static const char ask_it[] = "GET /healthz HTTP/1.1\r\n" H "\r\n";
    char cert2[FILE_PATH_MAX], key2[FILE_PATH_MAX], bytes[2000];
    struct err e = {0};
    struct tunnel early;
    start_tls();
    shown("first");
    assert_true(tunnel_open(&early, t.port, USUAL));
    tunnel_pair(t.dir, "second", 30, cert2, key2);
    /* The new key with the old certificate: nothing changes. */
    move(key2, key);
    kit_fails(server_reload(t.server, &e), ERR_DATA, e, "is not the key");
    shown("first");
    move(cert2, cert);
    e = (struct err){0};
    kit_ok(server_reload(t.server, &e), e);
    shown("second");
    kit_ok(server_reload(t.server, &e), e); /* of the same files */
    shown("second");
    say_tls(&early, ask_it, sizeof ask_it - 1, sizeof ask_it); /* begun with the first */
    assert_true(gnutls_record_recv(early.session, bytes, sizeof bytes) > 0);
    assert_memory_equal(bytes, "HTTP/1.1 200", 12);
    tunnel_close(&early);
    kit_ok(file_write(cert, "nothing", 7, &e), e);
    kit_fails(server_reload(t.server, &e), ERR_FORMAT, e, "--tls-cert");
    shown("second");
}

static void test_files(void **state)
{
    char other_cert[FILE_PATH_MAX], other_key[FILE_PATH_MAX], about[256];
    struct err e = {0};
    struct tls *x = NULL;
    tunnel_pair(t.dir, "first", 90, cert, key);
    tunnel_pair(t.dir, "other", -10, other_cert, other_key);
    kit_fails(tls_open(cert, NULL, &x, &e), ERR_ARG, e, "--tls-key");
    kit_fails(tls_open(NULL, key, &x, &e), ERR_ARG, e, "--tls-cert");
    kit_fails(tls_open("/nonexistent", key, &x, &e), ERR_NOENT, e, "/nonexistent");
    kit_fails(tls_open(cert, "/nonexistent", &x, &e), ERR_NOENT, e, "--tls-key");
    kit_fails(tls_open(cert, other_key, &x, &e), ERR_DATA, e, "is not the key");
    kit_fails(tls_open(key, key, &x, &e), ERR_FORMAT, e, "--tls-cert");
    static const struct {
        unsigned mode;
        bool well;
    } modes[] = {{0600, true},  {0400, true},  {0640, true}, {0644, false},
                 {0660, false}, {0604, false}, {0602, false}};
    for (size_t i = 0; i < sizeof modes / sizeof *modes; i++) {
        assert_int_equal(chmod(key, modes[i].mode), 0);
        if (modes[i].well)
            kit_ok(tls_open(cert, key, &x, &e), e);
        else
            kit_fails(tls_open(cert, key, &x, &e), ERR_ARG, e, "chmod 600");
        tls_close(&x);
    }
    log_set_level(LOG_ERROR); /* it warns */
    kit_ok(tls_open(other_cert, other_key, &x, &e), e);
    tls_about(x, about, sizeof about);
    assert_non_null(strstr(about, "CN=other"));
    tls_close(&x);
    /* --check reads them, too. */
    char text[4096] = "";
    FILE *out = fmemopen(text, sizeof text, "w");
    assert_int_equal(chmod(key, 0600), 0);
    t.cfg.tls_cert = cert;
    t.cfg.tls_key = key;
    kit_ok(server_check(&t.cfg, t.paths, 1, out, &e), e);
    fclose(out);
    assert_non_null(strstr(text, "TLS: certificate of CN=first, until 20"));
    t.cfg.tls_key = other_key;
    assert_true(server_check(&t.cfg, t.paths, 1, NULL, &e) != ERR_OK);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_same_bytes),
        HTTP_TEST(test_pipelined),
        HTTP_TEST(test_the_screen_is_in_front),
        HTTP_TEST(test_what_is_refused),
        HTTP_TEST(test_reload),
        HTTP_TEST(test_files),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
