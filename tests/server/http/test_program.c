/* The program under its operators: logs, --check and exit codes, tokens that are revoked, and a
 * supervisor that is told the state and hands over sockets.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/program_kit.h"

#include <fcntl.h>
#include <jansson.h>
#include <sysexits.h>

/* Each line of the log begins with its priority where stderr is the journal, and not else. With
 * --log-format json all lines are objects, from the first to the error that ends the program. */
static void test_lines_of_the_log(void **state)
{
    char bad[FILE_PATH_MAX];
    const char *const whole[] = {"--port", "0", bad, NULL}, *const broken[] = {
                                                                bad,    "--port",
                                                                "0",    "--log-format",
                                                                "json", NULL};
    struct err e = {0};
    rights_put("lines.tiles", "this is no store", bad);
    for (int journal = 0; journal < 2; journal++) {
        struct program p = {.journal = journal};
        struct buf log = {0};
        program_start(&p, NULL, whole);
        assert_int_equal(program_end(&p, SIGTERM), 0);
        kit_ok(file_read(p.log, 0, &log, &e), e);
        buf_u8(&log, 0);
        size_t n = 0;
        for (const char *line = (char *)log.data; *line; line += strcspn(line, "\n") + 1, n++)
            if (strncmp(line, "<6>", 3) != 0 && strncmp(line, "<4>", 3) != 0 && journal)
                fail_msg("%.80s", line);
            else if (*line == '<' && !journal)
                fail_msg("%.80s", line);
        assert_true(n > 3);
        assert_int_equal(strstr((char *)log.data, "\n<4>") != NULL, journal);
        buf_free(&log);
        program_start(&p, NULL, broken);
        assert_int_equal(program_end(&p, 0), EX_DATAERR);
        kit_ok(file_read(p.log, 0, &log, &e), e);
        buf_u8(&log, 0);
        const char *from = (char *)log.data + (journal ? 3 : 0);
        if (journal)
            assert_memory_equal(log.data, "<3>", 3);
        json_t *o = json_loadb(from, strcspn(from, "\n"), 0, NULL);
        assert_string_equal(json_string_value(json_object_get(o, "level")), "error");
        assert_non_null(strstr(json_string_value(json_object_get(o, "msg")), "lines.tiles"));
        assert_string_equal(from + strcspn(from, "\n"), "\n"); /* and nothing behind it */
        json_decref(o);
        buf_free(&log);
    }
    const char *const json[] = {"--port", "0", "--log-format", "json", NULL};
    struct program p = {0};
    program_start(&p, NULL, json);
    json_t *o = json_loads(p.line, 0, NULL);
    assert_non_null(strstr(json_string_value(json_object_get(o, "msg")), "open http://"));
    json_decref(o);
    assert_int_equal(program_end(&p, SIGTERM), 0);
}

static void test_supervisor(void **state)
{
    static const char *const args[] = {"--port", "0", "--log-format", "json", NULL};
    struct program p = {0};
    struct reply r;
    struct buf log = {0};
    struct err e = {0};
#ifndef CITYSPLAT_SYSTEMD
    skip();
#endif
    program_start(&p, NULL, args);
    hears(&p, "READY=1");
    hears(&p, "WATCHDOG=1");
    hears(&p, "WATCHDOG=1"); /* again and again */
    ask_port(p.port, "GET", "/d/toy/tileset.json?v=\"", "User-Agent: a\"b\\c\r\n", &r);
    buf_free(&r.raw);
    ask_port(p.port, "GET", "/d/toy/tileset.json?v=%22",
             "User-Agent: a\"b\\c\r\nX-Request-Id: q7\r\n", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
    kill(p.pid, SIGHUP);
    hears(&p, "RELOADING=1");
    hears(&p, "READY=1");
    kill(p.pid, SIGTERM);
    hears(&p, "STOPPING=1");
    assert_int_equal(program_end(&p, 0), 0);
    kit_ok(file_read(p.log, 0, &log, &e), e);
    buf_add(&log, "", 1);
    bool seen = false;
    int lines = 0;
    for (char *line = (char *)log.data; *line; lines++) { /* every line is an object */
        size_t n = strcspn(line, "\n");
        json_error_t je;
        json_t *o = json_loadb(line, n, JSON_REJECT_DUPLICATES, &je);
        if (!o)
            fail_msg("not JSON: %.*s: %s", (int)n, line, je.text);
        const char *id = json_string_value(json_object_get(o, "id"));
        assert_non_null(json_string_value(json_object_get(o, "ts")));
        if (id && !strcmp(id, "q7")) {
            seen = true;
            assert_string_equal(json_string_value(json_object_get(o, "agent")), "a\"b\\c");
            assert_string_equal(json_string_value(json_object_get(o, "client")), "127.0.0.1");
            assert_int_equal(json_integer_value(json_object_get(o, "status")), 200);
        }
        json_decref(o);
        line += n + (line[n] == '\n');
    }
    assert_true(seen && lines > 4);
    buf_free(&log);
}

static int listen_here(uint16_t *port)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    socklen_t n = sizeof a;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(listen(fd, 100), 0);
    assert_int_equal(getsockname(fd, (struct sockaddr *)&a, &n), 0);
    *port = ntohs(a.sin_port);
    return fcntl(fd, F_DUPFD, 20); /* away from 3 and 4 */
}

/* The sockets outlive the program: what comes while it is started anew waits, and nothing is
 * refused. */
static void test_socket_activation(void **state)
{
    static const char *const args[] = {
        "--admin", "127.0.0.1:0", "--access-format", "combined", "--log-clients", "network", NULL};
    struct program p = {0};
    struct reply r;
    uint16_t port, admin;
#ifndef CITYSPLAT_SYSTEMD
    skip();
#endif
    const int fds[2] = {listen_here(&port), listen_here(&admin)};
    for (int round = 0; round < 3; round++) {
        int early = dial(port); /* before there is a program */
        say(early, "GET /d/toy/tileset.json HTTP/1.1\r\n" H
                   "Referer: http://a/\r\nConnection: close\r\n\r\n");
        program_start(&p, fds, args);
        hear(early, true, NULL, &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
        close(early);
        ask_port(admin, "GET", "/metrics", "", &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
        assert_int_equal(program_end(&p, SIGTERM), 0);
    }
    struct buf log = {0};
    struct err e = {0};
    kit_ok(file_read(p.log, 0, &log, &e), e);
    buf_add(&log, "", 1);
    const char *line = strstr((char *)log.data, "127.0.0.0 - - [");
    assert_non_null(line);
    assert_non_null(strstr(line, "] \"GET /d/toy/tileset.json HTTP/1.1\" 200 "));
    assert_non_null(strstr(line, " \"http://a/\" \"-\"\n"));
    buf_free(&log);
    close(fds[0]);
    close(fds[1]);
}

static int exit_code(const char *const *args, struct buf *said)
{
    struct program p = {0};
    struct err e = {0};
    program_start(&p, NULL, args);
    int code = program_end(&p, 0);
    kit_ok(file_read(p.log, 0, said, &e), e);
    buf_add(said, "", 1);
    return code;
}

/* A trace that was asked for is there when the program has ended, and replaces no file. */
static void test_trace_is_written(void **state)
{
    char path[FILE_PATH_MAX];
    const char *args[] = {"--port", "0", "--trace", path, NULL};
    struct program p = {0};
    struct reply r;
    struct err e = {0};
    bool seen = false;
    size_t i;
    const json_t *ev;
    kit_ok(file_join(path, t.dir, "trace.json", &e), e);
    program_start(&p, NULL, args);
    ask_port(p.port, "GET", "/d/toy/tileset.json", "", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
    assert_false(file_exists(path));
    assert_int_equal(program_end(&p, SIGTERM), 0);
    json_t *o = json_load_file(path, 0, NULL);
    assert_non_null(o);
    json_array_foreach(json_object_get(o, "traceEvents"), i, ev) seen |=
        !strcmp(json_string_value(json_object_get(ev, "name")), "/d/{ds}/tileset.json");
    assert_true(seen);
    json_decref(o);
    struct buf said = {0};
    assert_int_equal(exit_code(args, &said), EX_USAGE);
    assert_non_null(strstr((char *)said.data, "serve replaces no trace: remove it"));
    assert_null(strstr((char *)said.data, "--overwrite"));
    buf_free(&said);
}

/* The log has '-' in the place of secrets [n], which it has none of. */
static void log_has_no(const struct buf *log, const char *const *secrets, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        char secret[48];
        snprintf(secret, sizeof secret, "%.43s", secrets[i]);
        if (strstr((const char *)log->data, secret))
            fail_msg("the log has %s", secret);
    }
    assert_non_null(strstr((const char *)log->data, "GET /signed/-/d/toy/tileset.json HTTP"));
    assert_non_null(strstr((const char *)log->data, "\"http://h/signed/-/d/toy/tileset.json\""));
    assert_non_null(strstr((const char *)log->data, "&key=k1&sig=- HTTP"));
}

/* A token and a key that are taken from the file open nothing a second after SIGHUP, by whatever
 * they opened before; the log has none of what opens. */
static void test_revocation(void **state)
{
    char path[FILE_PATH_MAX], bearer[128], cookie[2 * AUTH_SEAL_MAX + 300],
        sealed[AUTH_SEAL_MAX + 200], query[AUTH_QUERY_MAX], alone[AUTH_QUERY_MAX + 200],
        seal[AUTH_SEAL_MAX];
    const char *const args[] = {"--port", "0", "--access-format", "combined", "--auth", path, NULL};
    struct program p = {0};
    struct reply r;
    struct auth *a = NULL;
    struct err e = {0};
    struct buf log = {0};
    int64_t for_s;
    rights_file("\"read:toy\"", "", path);
    program_start(&p, NULL, args);
    kit_ok(auth_open(path, &a, &e), e);
    const int64_t now_s = (int64_t)time(NULL);
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", now_s + 60, now_s, seal, &e), e);
    snprintf(sealed, sizeof sealed, "/signed/%s/d/toy/tileset.json", seal);
    kit_ok(
        auth_sign_path(a, NULL, "/d/toy/r/000000000000/t/0/0/0.glb", now_s + 60, now_s, query, &e),
        e);
    snprintf(alone, sizeof alone, "/d/toy/r/000000000000/t/0/0/0.glb?%s", query);
    assert_int_equal(auth_session(a, TOKEN, now_s, seal, &for_s), AUTH_OK);
    auth_close(&a);
    snprintf(bearer, sizeof bearer, "Authorization: Bearer %s\r\n", TOKEN);
    snprintf(cookie, sizeof cookie, "Cookie: citysplat=%s\r\nReferer: http://h%s\r\n", seal,
             sealed);
    const struct {
        const char *target, *fields;
        int before, after;
    } rows[] = {{"/d/toy/tileset.json", bearer, 200, 403},
                {"/d/toy/tileset.json", cookie, 200, 401},
                {sealed, "", 200, 403},
                {alone, "", 404, 403}}; /* 404: allowed, and not there */
    for (int after = 0; after < 2; after++) {
        for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
            ask_port(p.port, "GET", rows[i].target, rows[i].fields, &r);
            if (r.status != (after ? rows[i].after : rows[i].before))
                fail_msg("row %zu, file %d: %d", i, after, r.status);
            buf_free(&r.raw);
        }
        rights_put("auth.jsonc", "{\"keys\": {\"k1\": \"another-key-another-key-another-key\"}}",
                   path);
        kill(p.pid, SIGHUP);
        nap_ms(900);
        for (char said[512]; recv(p.notify, said, sizeof said, MSG_DONTWAIT) > 0;)
            ; /* what its supervisor does not hear would hold it up */
    }
    assert_int_equal(program_end(&p, SIGTERM), 0);
    kit_ok(file_read(p.log, 0, &log, &e), e);
    buf_u8(&log, 0);
    const char *const secrets[] = {TOKEN, strrchr(seal, '.'), strstr(sealed, ".toy.") + 5,
                                   strstr(query, "sig=") + 4};
    log_has_no(&log, secrets, sizeof secrets / sizeof *secrets);
    buf_free(&log);
}

static void test_check_and_exit_codes(void **state)
{
    char bad[FILE_PATH_MAX], conf[FILE_PATH_MAX], fifo[FILE_PATH_MAX], trace[FILE_PATH_MAX],
        open[FILE_PATH_MAX], state_dir[FILE_PATH_MAX], names[FILE_PATH_MAX];
    struct err e = {0};
    assert_int_equal(chmod(rights_file("\"admin\"", "", open), 0644), 0);
    kit_ok(file_join(state_dir, t.dir, "state", &e), e);
    kit_ok(file_mkdir(state_dir, &e), e);
    kit_ok(file_join(names, state_dir, "appearances.sqlite", &e), e);
    kit_ok(file_write(names, "", 0, &e), e);
    kit_ok(file_join(trace, t.dir, "checked.json", &e), e);
    kit_ok(file_join(fifo, t.dir, "fifo.tiles", &e), e);
    assert_int_equal(mkfifo(fifo, 0600), 0);
    rights_put("bad.tiles", "this is no store", bad);
    rights_put("bad-conf.jsonc", "{\"port\": 70000}", conf);
    int busy = -1;
    uint16_t port;
    char taken[16];
    busy = listen_here(&port);
    snprintf(taken, sizeof taken, "%d", port);
    const struct {
        int code;
        const char *says, *args[8];
    } rows[] = {
        {0, "", {"--check"}},
        {EX_CONFIG, "--base-path", {"--check", "--base-path", "x"}},
        {EX_CONFIG, "--cache-policy", {"--check", "--cache-policy", "x"}},
        {EX_CONFIG, "--address localhost", {"--check", "--address", "localhost"}},
        {EX_CONFIG, "--admin", {"--check", "--admin", "8078"}},
        {EX_CONFIG, "the first listener is", {"--check", "--admin", "127.0.0.1:8080"}},
        {0, "", {"--check", "--admin", "127.0.0.2:8080"}},
        {EX_CONFIG, "the first", {"--check", "--address", "::1", "--admin", "[0:0::0:1]:8080"}},
        {EX_CONFIG, "the first", {"--check", "--admin", "[::ffff:127.0.0.1]:8080"}},
        {EX_CONFIG, "the first", {"--check", "--address", "0.0.0.0", "--admin", "127.0.0.1:8080"}},
        {EX_CONFIG, "the first", {"--check", "--address", "::", "--admin", "127.0.0.1:8080"}},
        {0, "", {"--check", "--address", "0.0.0.0", "--admin", "[::1]:8080"}},
        {0, "", {"--check", "--port", "0", "--admin", "127.0.0.1:8080"}},
        {EX_CONFIG, "--public-url foo", {"--check", "--public-url", "foo"}},
        {EX_CONFIG, "--public-url", {"--check", "--public-url", "https://a.org/?x"}},
        {0, "", {"--check", "--public-url", "https://a.org:8443/b", "--admin", "[::1]:8078"}},
        {EX_CONFIG, "/nonexistent", {"--check", "--auth", "/nonexistent"}},
        {EX_CONFIG, "others may read", {"--check", "--auth", open}},
        {EX_CONFIG, "it is empty", {"--check", "--state-dir", state_dir}},
        {EX_DATAERR, "it is empty", {"--port", "0", "--state-dir", state_dir}},
        {EX_CONFIG, "bad.tiles", {"--check", bad}},
        {EX_CONFIG, "no file", {"--check", fifo}}, /* not waited for */
        {EX_CONFIG, "--trusted-proxy", {"--check", "--trusted-proxy", "x"}},
        {EX_CONFIG, "/nonexistent", {"--check", "--web-dir", "/nonexistent"}},
        {EX_CONFIG, "replaces no trace", {"--check", "--trace", conf}},
        {EX_CONFIG, "cannot be written there", {"--check", "--trace", "/nonexistent/t.json"}},
        {0, "", {"--check", "--trace", trace}},
        {EX_USAGE, "--prot", {"--prot", "1"}},
        {EX_CONFIG, "port", {"--config", conf}},
        {EX_DATAERR, "bad.tiles", {bad, "--port", "0"}},
        {EX_NOINPUT, "/nonexistent", {"/nonexistent.tiles", "--port", "0"}},
        {EX_UNAVAILABLE, "--port", {"--port", taken}},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct buf said = {0};
        int code = exit_code(rows[i].args, &said);
        if (code != rows[i].code || !strstr((char *)said.data, rows[i].says))
            fail_msg("row %zu: exit code %d, want %d: %s", i, code, rows[i].code,
                     (char *)said.data);
        buf_free(&said);
    }
    assert_false(file_exists(trace));
    close(busy);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_revocation),           HTTP_TEST(test_supervisor),
        HTTP_TEST(test_trace_is_written),     HTTP_TEST(test_socket_activation),
        HTTP_TEST(test_check_and_exit_codes), HTTP_TEST(test_lines_of_the_log),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
