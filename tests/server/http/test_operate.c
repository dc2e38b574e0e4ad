/* What operators rely on: tokens that are revoked, caches by dataset, ids of requests, logs of
 * three kinds, their own listener, base paths, --check and exit codes, and a supervisor that is
 * told the state and hands over sockets. It is one long file, because every case starts the server
 * or the program by the same few functions.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): leases
#include "server/access/cache_policy.h"
#include "tests/server/rights_kit.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <sysexits.h>

/* ---- caches ---- */

static void test_cache_policies(void **state)
{
    static const char immutable[] = "public, max-age=31536000, immutable",
                      moving[] =
                          "public, max-age=60, stale-while-revalidate=600, stale-if-error=86400";
    static const char *const bad[] = {"a",    "=private",   "a=",    "a=never",
                                      "a=-1", "a=99999999", "a=b=c", ",a=1"};
    struct cache_policy p;
    struct err e = {0};
    struct reply r;
    char target[128];
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        kit_fails(cache_policy_read(bad[i], &p, &e), ERR_ARG, e, "--cache-policy");
    kit_ok(cache_policy_read("a=private,b=no-store,c=300,*=public", &p, &e), e);
    assert_string_equal(cache_policy_of(&p, "a", true, immutable),
                        "private, max-age=31536000, immutable");
    assert_string_equal(cache_policy_of(&p, "a", true, moving), "private, max-age=60");
    assert_string_equal(cache_policy_of(&p, "a", true, "no-store"), "no-store");
    assert_string_equal(cache_policy_of(&p, "b", true, immutable), "private, no-store");
    assert_string_equal(cache_policy_of(&p, "c", true, immutable), immutable);
    assert_string_equal(cache_policy_of(&p, "c", true, moving),
                        "public, max-age=300, stale-while-revalidate=600, stale-if-error=86400");
    assert_string_equal(cache_policy_of(&p, "d", true, moving), moving);
    assert_string_equal(cache_policy_of(&p, "d", false, immutable),
                        "private, max-age=31536000, immutable");
    kit_ok(cache_policy_read(NULL, &p, &e), e);
    assert_string_equal(cache_policy_of(&p, "d", true, immutable), immutable);

    static const char *const tags[] = {"Surrogate-Key", "xkey", "Cache-Tag", "none"};
    t.cfg.cache_policy = "toy=private";
    for (int k = 0; k < 4; k++) {
        t.cfg.tag_header = k;
        start();
        for (int again = 0; again < 2; again++) {
            ask("GET", tile_target(17, "glb", target), "", &r);
            assert_string_equal(header(&r, "Cache-Control"),
                                "private, max-age=31536000, immutable");
            assert_string_equal(header(&r, "Cache-Status"),
                                again ? "citysplat; hit" : "citysplat; fwd=miss; stored");
            for (int i = 0; i < 3; i++)
                assert_int_equal(header(&r, tags[i])[0] != 0, i == k);
            buf_free(&r.raw);
        }
        ask("GET", "/d/toy/tileset.json", "", &r); /* what moves has the tag of its dataset */
        assert_string_equal(header(&r, "Cache-Control"), "private, max-age=60");
        if (k < 3)
            assert_string_equal(header(&r, tags[k]), "ds-toy");
        buf_free(&r.raw);
        ask("GET", "/d/toy/seed.ndjson?clip=1,1,2,1,1,2", "", &r); /* a job finds nothing */
        assert_int_equal(r.status, 404);
        assert_string_equal(header(&r, "Cache-Control"), "private, max-age=60");
        buf_free(&r.raw);
        server_stop(&t.server);
    }
}

/* ---- ids of requests, base path, listener of operators ---- */

static void test_request_ids(void **state)
{
    struct reply r;
    char own[2][80];
    const char *at;
    start();
    ask("GET", "/healthz", "X-Request-Id: proxy-7.a_B\r\n", &r);
    assert_string_equal(header(&r, "X-Request-Id"), "proxy-7.a_B");
    buf_free(&r.raw);
    static const char *const cached[] = {"/d/toy/tileset.json", "/nothing/here",
                                         "/d/none/map.json"};
    for (int i = 0; i < 3; i++) /* a cache would give it to everybody */
        for (int again = 0; again < 2; again++) {
            ask("GET", cached[i], "X-Request-Id: of-one\r\n", &r);
            assert_non_null(strstr(header(&r, "Cache-Control"), "public"));
            assert_string_equal(header(&r, "X-Request-Id"), "");
            buf_u8(&r.raw, 0);
            assert_null(strstr((const char *)r.raw.data, "of-one"));
            buf_free(&r.raw);
        }
    ask("GET", "/metrics", "X-Request-Id: of-one\r\nX-Forwarded-For: 1.2.3.4\r\n", &r);
    assert_int_equal(r.status, 403); /* not kept: there it is */
    assert_string_equal(header(&r, "X-Request-Id"), "of-one");
    assert_non_null(strstr((const char *)r.body, "\"request_id\":\"of-one\""));
    buf_free(&r.raw);
    ask("GET", "/healthz", "", &r);
    assert_string_equal(header(&r, "X-Request-Id"), "");
    buf_free(&r.raw);
    for (int i = 0; i < 2; i++) { /* neither quotes nor what is too long are repeated */
        ask("GET", "/nothing/here", i ? "X-Request-Id: a\"b\r\n" : "", &r);
        assert_int_equal(r.status, 404);
        snprintf(own[i], sizeof own[i], "%s", header(&r, "X-Request-Id"));
        assert_int_equal(strlen(own[i]), 16);
        assert_non_null(at = strstr((const char *)r.body, "\"request_id\":\""));
        assert_memory_equal(at + 14, own[i], 16);
        buf_free(&r.raw);
    }
    assert_string_not_equal(own[0], own[1]);
    char line[200] = "X-Request-Id: ";
    memset(line + 14, 'a', 65);
    memcpy(line + 79, "\r\n", 3);
    ask("GET", "/nothing/here", line, &r);
    assert_int_equal(strlen(header(&r, "X-Request-Id")), 16);
    buf_free(&r.raw);
}

static void test_base_path(void **state)
{
    static const char *const bad[] = {"splats", "/", "/splats/", "//a", "/a/../b", "/a b"};
    struct err e = {0};
    struct reply r;
    struct server *none = NULL;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        t.cfg.base_path = bad[i];
        kit_fails(server_start(&t.cfg, t.paths, 1, &none, &e), ERR_ARG, e, "--base-path");
    }
    t.cfg.base_path = "/maps/splats";
    start();
    assert_int_equal(status_of("GET", "/maps/splats/d/toy/tileset.json", ""), 200);
    assert_int_equal(status_of("GET", "/d/toy/tileset.json", ""), 200); /* a proxy that strips it */
    assert_int_equal(status_of("GET", "/maps/splatsd/toy/tileset.json", ""), 404);
    assert_int_equal(status_of("GET", "/maps/splats/maps/splats/healthz", ""), 404);
    ask("GET", "/maps/splats", "", &r);
    assert_int_equal(r.status, 308);
    assert_string_equal(header(&r, "Location"), "/maps/splats/");
    buf_free(&r.raw);
    ask("GET", "/maps/splats/d/toy/t/17/1/1.glb", "",
        &r); /* relative, so it holds below the path */
    assert_int_equal(r.status, 307);
    assert_int_not_equal(header(&r, "Location")[0], '/');
    buf_free(&r.raw);
}

/* A page in an operator's browser: it asks for nothing, and reads nothing. */
static void admin_refuses_pages(uint16_t admin)
{
    struct reply r;
    ask_port(admin, "POST", "/-/reload",
             "Origin: https://elsewhere.example\r\nContent-Length: 0\r\n", &r);
    assert_int_equal(r.status, 403);
    assert_string_equal(header(&r, "Access-Control-Allow-Origin"), "");
    buf_free(&r.raw);
    ask_port(admin, "GET", "/metrics", "Origin: https://elsewhere.example\r\n", &r);
    assert_int_equal(r.status, 403);
    buf_free(&r.raw);
}

/* The status of a request for metrics that names a host. */
static int status_by_name(uint16_t port, const char *host)
{
    char text[400];
    struct reply r;
    snprintf(text, sizeof text, "GET /metrics HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n",
             host);
    int fd = dial(port);
    say(fd, text);
    hear(fd, true, NULL, &r);
    const int status = r.status;
    buf_free(&r.raw);
    close(fd);
    return status;
}

/* A page of another site whose name leads to this machine (DNS rebinding) learns nothing. */
static void admin_knows_its_names(uint16_t admin)
{
    static const char *const own[] = {"localhost", "LOCALHOST:9", "127.0.0.1:9", "[::1]:9",
                                      "10.1.2.3:80"},
                             *const foreign[] = {"evil.example",           "evil.example:80",
                                                 "localhost.evil.example", "127.0.0.1.evil.example",
                                                 "maps.example",           ""};
    char name[300] = "", longer[330];
    for (size_t i = 0; i < sizeof own / sizeof *own; i++)
        if (status_by_name(admin, own[i]) != 200)
            fail_msg("%s is refused", own[i]);
    for (size_t i = 0; i < sizeof foreign / sizeof *foreign; i++)
        if (status_by_name(admin, foreign[i]) != 403)
            fail_msg("%s is not refused", foreign[i]);
    assert_int_equal(gethostname(name, 256), 0);
    assert_int_equal(status_by_name(admin, name), 200);
    snprintf(longer, sizeof longer, "%s.evil.example", name);
    assert_int_equal(status_by_name(admin, longer), 403);
}

/* The host of --public-url is one of its names. */
static void test_admin_of_a_public_url(void **state)
{
    t.cfg.admin = "127.0.0.1:0";
    t.cfg.public_url = "https://maps.example:8443/splats";
    start();
    const uint16_t admin = server_admin_port(t.server);
    assert_int_equal(status_by_name(admin, "maps.example"), 200);
    assert_int_equal(status_by_name(admin, "evil.example"), 403);
}

static void test_admin_listener(void **state)
{
    struct err e = {0};
    struct reply r;
    struct server *none = NULL;
    t.cfg.admin = "localhost:1";
    kit_fails(server_start(&t.cfg, t.paths, 1, &none, &e), ERR_ARG, e, "--admin");
    t.cfg.admin = "127.0.0.1";
    kit_fails(server_start(&t.cfg, t.paths, 1, &none, &e), ERR_ARG, e, "--admin");
    t.cfg.admin = "127.0.0.1:0";
    start();
    uint16_t admin = server_admin_port(t.server);
    assert_int_not_equal(admin, 0);
    assert_int_not_equal(admin, t.port);
    assert_int_equal(status_of("GET", "/metrics", ""), 404);
    assert_int_equal(status_of("POST", "/-/reload", "Content-Length: 0\r\n"), 404);
    ask_port(admin, "GET", "/metrics", "X-Forwarded-For: 1.2.3.4\r\n", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "citysplat_http_requests_total"));
    buf_free(&r.raw);
    static const char *const there[] = {"/healthz", "/readyz", "/version"},
                             *const not_there[] = {"/", "/d/toy/tileset.json", "/collections"};
    for (int i = 0; i < 3; i++) {
        ask_port(admin, "GET", there[i], "", &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
        ask_port(admin, "GET", not_there[i], "", &r);
        assert_int_equal(r.status, 404);
        buf_free(&r.raw);
    }
    admin_refuses_pages(admin);
    admin_knows_its_names(admin);
    ask_port(admin, "GET", "/metrics", "", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Access-Control-Allow-Origin"), "");
    assert_string_equal(header(&r, "Cross-Origin-Resource-Policy"), "same-origin");
    buf_free(&r.raw);
    ask_port(admin, "POST", "/-/reload", "Content-Length: 0\r\n", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "\"status\": \"reloaded\""));
    buf_free(&r.raw);
    assert_true(server_answers(t.server, 2));
    /* idle connections of operators do not hold up the end */
    int fd = dial(admin);
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    hear(fd, true, NULL, &r);
    buf_free(&r.raw);
    double start_s = clock_s();
    server_stop(&t.server);
    assert_true(clock_s() - start_s < 5);
    close(fd);
}

/* ---- the program ---- */

struct program {
    pid_t pid;
    int out, notify; /* what it prints; what its supervisor hears */
    char log[FILE_PATH_MAX], socket[FILE_PATH_MAX], line[256];
    uint16_t port;
    bool journal; /* its log is taken for the journal */
    bool alone;   /* it has no supervisor, which would have to hear it */
};

static void program_exec(struct program *p, const char *name, const int *listener,
                         const char *const *args)
{
    /* of the store of the tests, unless there are others */
    const char *argv[24] = {name, "serve", "--device", "none", t.path};
    char pid[16], fds[4] = "0";
    int n = args[0] && args[0][0] != '-' ? 4 : 5, k = 0;
    for (int i = 0; args[i]; i++)
        argv[n++] = args[i];
    argv[n] = NULL;
    for (; k < 2 && listener && listener[k] >= 0; k++)
        if (dup2(listener[k], 3 + k) < 0)
            _exit(126);
    dup2(p->out, 1);
    struct stat st;
    char stream[64];
    if (!freopen(p->log, "w", stderr) || fstat(2, &st))
        _exit(126);
    snprintf(stream, sizeof stream, "%llu:%llu", (unsigned long long)st.st_dev,
             (unsigned long long)st.st_ino + !p->journal);
    setenv("JOURNAL_STREAM", stream, 1);
    snprintf(pid, sizeof pid, "%ld", (long)getpid());
    snprintf(fds, sizeof fds, "%d", k);
    if (!p->alone)
        setenv("NOTIFY_SOCKET", p->socket, 1);
    setenv("WATCHDOG_PID", pid, 1);
    setenv("WATCHDOG_USEC", "400000", 1);
    if (k) {
        setenv("LISTEN_PID", pid, 1);
        setenv("LISTEN_FDS", fds, 1);
        setenv("LISTEN_FDNAMES", k > 1 ? "http:admin" : "http", 1);
    }
    execv(argv[0], (char *const *)(uintptr_t)argv);
    _exit(127);
}

static void program_start(struct program *p, const int *listener, const char *const *args)
{
    struct err e = {0};
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    int out[2];
    const char *name = kit_program(); /* skips the test where there is none */
    kit_ok(file_join(p->log, t.dir, "operate.log", &e), e);
    kit_ok(file_join(p->socket, t.dir, "notify", &e), e);
    unlink(p->socket);
    snprintf(a.sun_path, sizeof a.sun_path, "%.100s", p->socket);
    p->notify = socket(AF_UNIX, SOCK_DGRAM, 0);
    assert_int_equal(bind(p->notify, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(pipe(out), 0);
    p->out = out[1];
    p->pid = fork();
    assert_true(p->pid >= 0);
    if (p->pid == 0)
        program_exec(p, name, listener, args);
    close(out[1]);
    p->out = out[0];
    size_t n = 0;
    for (; n + 1 < sizeof p->line && read(p->out, p->line + n, 1) == 1; n++)
        if (p->line[n] == '\n')
            break;
    p->line[n] = '\0';
    const char *colon = strrchr(p->line, ':');
    p->port = colon ? (uint16_t)atoi(colon + 1) : 0;
}

static int program_end(struct program *p, int sig)
{
    int status = -1;
    if (sig)
        kill(p->pid, sig);
    assert_int_equal(waitpid(p->pid, &status, 0), p->pid);
    close(p->out);
    close(p->notify);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

/* The supervisor hears this before PATIENCE_S is over. */
static void hears(struct program *p, const char *what)
{
    char text[512];
    for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s;) {
        struct pollfd f = {.fd = p->notify, .events = POLLIN};
        if (poll(&f, 1, 1000) != 1)
            continue;
        ssize_t n = recv(p->notify, text, sizeof text - 1, 0);
        text[n > 0 ? n : 0] = '\0';
        if (strstr(text, what))
            return;
    }
    fail_msg("the supervisor does not hear %s", what);
}

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

/* Waits until /readyz says a word; returns whether it is 200. */
static bool ready_says(uint16_t port, const char *word)
{
    struct reply r;
    bool said = false;
    int status = 0;
    for (double end_s = clock_s() + PATIENCE_S; !said && clock_s() < end_s;) {
        ask_port(port, "GET", "/readyz", "", &r);
        buf_u8(&r.raw, 0);
        said = strstr((const char *)r.body, word) != NULL;
        status = r.status;
        buf_free(&r.raw);
        if (!said)
            nap_ms(20);
    }
    if (!said)
        fail_msg("/readyz does not say '%s'", word);
    return status == 200;
}

/* Expects a line of the metrics. */
static void measures(uint16_t port, const char *line)
{
    struct reply r;
    char want[128];
    snprintf(want, sizeof want, "\ncitysplat_%s\n", line);
    ask_port(port, "GET", "/metrics", "", &r);
    buf_u8(&r.raw, 0);
    if (!strstr((const char *)r.body, want))
        fail_msg("no %s in %s", line, (const char *)r.body);
    buf_free(&r.raw);
}

/* Asks for a reload; its answer has this status, and says this. */
static void reloads(uint16_t admin, int status, const char *says)
{
    struct reply r;
    ask_port(admin, "POST", "/-/reload", "Content-Length: 0\r\n", &r);
    buf_u8(&r.raw, 0);
    if (r.status != status || !strstr((const char *)r.body, says))
        fail_msg("%d, want %d with %s: %s", r.status, status, says, (const char *)r.body);
    buf_free(&r.raw);
}

/* Starts the program with the folder `name` of the tests' and the operators' listener, which is
 * *admin. The folder is in dir. */
static void program_of_folder(struct program *p, const char *name, char dir[FILE_PATH_MAX],
                              const char *option, const char *value, uint16_t *admin)
{
    const char *const args[] = {dir, "--port", "0", "--admin", "127.0.0.1:0", option, value, NULL};
    struct err e = {0};
    char line[256];
    size_t n = 0;
    kit_ok(file_join(dir, t.dir, name, &e), e);
    kit_ok(file_mkdir(dir, &e), e);
    program_start(p, NULL, args);
    for (; n + 1 < sizeof line && read(p->out, line + n, 1) == 1 && line[n] != '\n'; n++)
        continue;
    line[n] = '\0';
    *admin = (uint16_t)atoi(strrchr(line, ' ') + 1);
}

/* A folder that is empty, gets stores, a broken one, and loses one: the program goes on, says what
 * it serves, and a reload answers what changed. */
static void test_a_folder_is_served(void **state)
{
    char dir[FILE_PATH_MAX], good[FILE_PATH_MAX], bad[FILE_PATH_MAX];
    struct program p = {.alone = true};
    struct err e = {0};
    struct buf log = {0};
    uint16_t admin;
    (void)kit_program(); /* skips the test where there is none */
    program_of_folder(&p, "stores", dir, NULL, NULL, &admin);
    kit_ok(file_join(good, dir, "good.tiles", &e), e);
    kit_ok(file_join(bad, dir, "bad.tiles", &e), e);
    assert_false(ready_says(p.port, "add a file NAME.tiles"));
    assert_false(ready_says(admin, "\"empty\""));
    served_city(good, "good", 10);
    reloads(admin, 200, "\"added\": [\n  \"good\"\n ]");
    assert_true(ready_says(p.port, "\"ready\""));
    measures(admin, "stores_degraded 0");
    measures(admin, "datasets 1");
    measures(admin, "last_reload_successful 1");
    measures(admin, "pictures_on 0");
    kit_ok(file_write(bad, "cut off", 7, &e), e);
    served_city(good, "good", 11);
    reloads(admin, 500, "\"to\": \""); /* one is replaced, the other fails */
    reloads(admin, 500, "bad.tiles");
    assert_true(ready_says(admin, "bad.tiles"));
    measures(admin, "stores_degraded 1");
    measures(admin, "last_reload_successful 0");
    measures(admin, "reload_failed_total 2");
    struct reply r;
    ask_port(p.port, "GET", "/readyz", "X-Forwarded-For: 9.9.9.9\r\n", &r); /* no names of files */
    buf_u8(&r.raw, 0);
    assert_non_null(strstr((const char *)r.body, "1 not served"));
    assert_null(strstr((const char *)r.body, "bad.tiles"));
    buf_free(&r.raw);
    assert_int_equal(unlink(bad), 0);
    kill(p.pid, SIGHUP);
    assert_true(ready_says(admin, "\"ready\""));
    assert_int_equal(unlink(good), 0);
    reloads(admin, 200, "\"removed\": [\n  \"good\"\n ]");
    assert_false(ready_says(admin, "\"empty\""));
    assert_int_equal(program_end(&p, SIGTERM), 0);
    kit_ok(file_read(p.log, 0, &log, &e), e);
    buf_u8(&log, 0);
    static const char *const says[] = {"no store is served yet: copy NAME.tiles into",
                                       "dataset name=good",
                                       "dataset replaced name=good",
                                       "bad.tiles is not served",
                                       "reload failed, what could be opened is served",
                                       "dataset removed name=good"};
    for (size_t i = 0; i < sizeof says / sizeof *says; i++)
        kit_expect_text((const char *)log.data, says[i], __FILE__, __LINE__);
    buf_free(&log);
}

/* A store that was broken at the start is served when it is mended, without a reload; a server of
 * an address that is away serves its files at once. */
static void test_it_starts_with_what_is_whole(void **state)
{
    char bad[FILE_PATH_MAX], fifo[FILE_PATH_MAX];
    static const char away[] = "http://127.0.0.1:1/away.tiles";
    struct err e = {0};
    kit_ok(file_join(fifo, t.dir, "pipe.tiles", &e), e);
    assert_int_equal(mkfifo(fifo, 0600), 0);
    rights_put("mended.tiles", "cut off", bad);
    const char *const paths[] = {bad, t.path, fifo, away, "/nonexistent/x.tiles"};
    t.cfg.again_s = 0.1;
    t.cfg.deadline_s = 1; /* so long an address is asked again at once */
    t.cfg.admin = "127.0.0.1:0";
    kit_ok(server_start(&t.cfg, paths, 5, &t.server, &e), e);
    assert_int_equal(server_count(t.server), 1); /* the address is not waited for */
    t.port = strrchr(server_url(t.server), ':')
                 ? (uint16_t)atoi(strrchr(server_url(t.server), ':') + 1)
                 : 0;
    const uint16_t admin = server_admin_port(t.server);
    assert_true(ready_says(t.port, "mended.tiles"));
    assert_true(ready_says(t.port, "pipe.tiles: no file"));
    assert_true(ready_says(t.port, "/nonexistent/x.tiles"));
    assert_true(ready_says(t.port, "http://127.0.0.1:1/away.tiles"));
    measures(admin, "stores_degraded 4");
    served_city(bad, "mended", 10);
    for (double end_s = clock_s() + PATIENCE_S; server_count(t.server) < 2 && clock_s() < end_s;) {
        server_expire(t.server, clock_s());
        nap_ms(10);
    }
    assert_int_equal(status_of("GET", "/d/mended/tileset.json", ""), 200);
    measures(admin, "stores_degraded 3");
    assert_int_not_equal(server_reload(t.server, &e), ERR_OK);
    assert_int_equal(status_of("GET", "/d/toy/tileset.json", ""), 200);
}

/* What the log of a program says, and how often. */
static size_t log_says(const struct program *p, const char *what)
{
    struct buf log = {0};
    struct err e = {0};
    size_t n = 0;
    kit_ok(file_read(p->log, 0, &log, &e), e);
    buf_u8(&log, 0);
    for (const char *at = (const char *)log.data; (at = strstr(at, what)); at++)
        n++;
    buf_free(&log);
    return n;
}

/* A store whose file cannot be opened for a while, as on a disk of a server that is away: the
 * program goes on, is well by its supervisor, encodes tiles by its one worker, and says that it is
 * ready. Those who ask for a reload meanwhile wait for the next one, which finds what the first
 * came too early for. */
static void test_a_store_that_hangs(void **state)
{
    enum { ASKS = 6 };
    static const char post[] =
        "POST /-/reload HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n";
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], late[FILE_PATH_MAX], toy[FILE_PATH_MAX],
        target[128];
    struct program p = {0};
    struct err e = {0};
    struct reply r;
    uint16_t admin;
    int asks[1 + ASKS];
#ifndef CITYSPLAT_SYSTEMD
    skip();
#endif
    (void)kit_program();
    program_of_folder(&p, "hanging", dir, "--workers", "1", &admin);
    kit_ok(file_join(toy, dir, "toy.tiles", &e), e);
    assert_int_equal(link(t.path, toy), 0);
    reloads(admin, 200, "\"added\": [\n  \"toy\"\n ]");
    kit_ok(file_join(late, dir, "late.tiles", &e), e);
    kit_ok(file_join(path, dir, "slow.tiles", &e), e);
    served_city(path, "slow", 10);
    /* Whoever opens the file waits until its lease is given back. */
    signal(SIGIO, SIG_IGN);
    const int lease = open(path, O_RDWR | O_CLOEXEC);
    assert_true(lease >= 0);
    if (fcntl(lease, F_SETLEASE, F_WRLCK)) {
        print_message("no leases on this file system\n");
        close(lease);
        assert_int_equal(program_end(&p, SIGTERM), 0);
        skip();
    }
    say(asks[0] = dial(admin), post);
    while (fcntl(lease, F_GETLEASE) == F_WRLCK) /* until it is opened */
        nap_ms(1);
    served_city(late, "late", 10);
    for (int i = 1; i <= ASKS; i++)
        say(asks[i] = dial(admin), post);
    for (int i = 0; i < 3; i++)
        hears(&p, "WATCHDOG=1");
    assert_int_equal(log_says(&p, "info serve reloaded"), 1);
    ask_port(p.port, "GET", "/healthz", "", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
    ask_port(p.port, "GET", tile_target(17, "glb", target), "", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
    assert_int_equal(fcntl(lease, F_SETLEASE, F_UNLCK), 0);
    close(lease);
    hears(&p, "READY=1");
    for (int i = 0; i <= ASKS; i++) {
        hear(asks[i], true, NULL, &r);
        buf_u8(&r.raw, 0);
        assert_int_equal(r.status, 200);
        kit_expect_text((const char *)r.body, i ? "late" : "slow", __FILE__, __LINE__);
        assert_null(strstr((const char *)r.body, i ? "slow" : "late"));
        buf_free(&r.raw);
        close(asks[i]);
    }
    ask_port(p.port, "GET", "/d/slow/tileset.json", "", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
    assert_int_equal(program_end(&p, SIGTERM), 0);
    /* that of toy, the one that hung, and what the others share */
    assert_int_equal(log_says(&p, "info serve reloaded"), 3);
}

/* Such a store does not keep the program from ending, either. `comes`: it is opened while the
 * program stops, of which the supervisor hears nothing any more. */
static void end_of_a_store_that_hangs(const char *name, bool comes)
{
    char said[512], dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct program p = {0};
    struct err e = {0};
    uint16_t admin;
    program_of_folder(&p, name, dir, "--workers", "2", &admin);
    kit_ok(file_join(path, dir, "slow.tiles", &e), e);
    served_city(path, "slow", 10);
    signal(SIGIO, SIG_IGN);
    const int lease = open(path, O_RDWR | O_CLOEXEC);
    assert_true(lease >= 0);
    if (fcntl(lease, F_SETLEASE, F_WRLCK)) {
        close(lease);
        assert_int_equal(program_end(&p, SIGTERM), 0);
        skip();
    }
    kill(p.pid, SIGHUP);
    hears(&p, "RELOADING=1");
    while (fcntl(lease, F_GETLEASE) == F_WRLCK)
        nap_ms(1);
    const double start_s = clock_s();
    const int heard = dup(p.notify);
    kill(p.pid, SIGTERM);
    hears(&p, "STOPPING=1");
    if (comes)
        assert_int_equal(fcntl(lease, F_SETLEASE, F_UNLCK), 0);
    assert_int_equal(program_end(&p, 0), 0);
    assert_true(clock_s() - start_s < 20);
    assert_int_equal(log_says(&p, "it is left behind"), !comes);
    assert_int_equal(log_says(&p, "info serve reloaded"), comes);
    for (ssize_t n; (n = recv(heard, said, sizeof said - 1, MSG_DONTWAIT)) > 0;) {
        said[n] = '\0';
        assert_null(strstr(said, "READY"));
    }
    close(heard);
    close(lease);
}

static void test_a_store_that_hangs_at_the_end(void **state)
{
#ifndef CITYSPLAT_SYSTEMD
    skip();
#endif
    (void)kit_program();
    end_of_a_store_that_hangs("endless", false);
    end_of_a_store_that_hangs("ending", true);
}

/* Stores that a reload finds have descriptors, too, where the limit may be raised. */
static void test_descriptors_for_more_stores(void **state)
{
    enum { STORES = 60, SOFT = 128 };
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], name[32];
    struct program p = {.alone = true};
    struct rlimit was;
    struct err e = {0};
    uint16_t admin;
    (void)kit_program();
    assert_int_equal(getrlimit(RLIMIT_NOFILE, &was), 0);
    if (was.rlim_max < 4096)
        skip();
    const struct rlimit few = {SOFT, was.rlim_max};
    assert_int_equal(setrlimit(RLIMIT_NOFILE, &few), 0);
    program_of_folder(&p, "more", dir, "--max-connections", "8", &admin);
    assert_int_equal(setrlimit(RLIMIT_NOFILE, &was), 0);
    for (int i = 0; i < STORES; i++) {
        snprintf(name, sizeof name, "more-%d.tiles", i);
        kit_ok(file_join(path, dir, name, &e), e);
        name[strlen(name) - strlen(".tiles")] = '\0';
        served_city(path, name, 10);
    }
    reloads(admin, 200, "more-59");
    measures(admin, "datasets 60");
    assert_int_equal(program_end(&p, SIGTERM), 0);
}

/* A thousand stores in a folder are served in little memory. How long the start takes is printed.
 */
static void test_a_thousand_stores(void **state)
{
    enum { STORES = 1000 };
#if defined(__SANITIZE_THREAD__) || defined(__SANITIZE_ADDRESS__)
    static const size_t most_bytes = SIZE_MAX; /* sanitizers keep several bytes for each */
#else
    static const size_t most_bytes = (size_t)64 << 20; /* 55 MB were measured */
#endif
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], name[32];
    const char *const args[] = {dir, "--port", "0", "--no-access-log", NULL};
    struct program p = {0};
    struct reply r;
    struct err e = {0};
    (void)kit_program(); /* skips the test where there is none */
    kit_ok(file_join(dir, t.dir, "many", &e), e);
    kit_ok(file_mkdir(dir, &e), e);
    for (int i = 0; i < STORES; i++) {
        snprintf(name, sizeof name, "many-%d.tiles", i);
        kit_ok(file_join(path, dir, name, &e), e);
        name[strlen(name) - strlen(".tiles")] = '\0';
        served_city(path, name, 10);
    }
    const double start_s = clock_s();
    program_start(&p, NULL, args);
    const double took_s = clock_s() - start_s;
    const size_t held = mem_held_bytes((int)p.pid);
    print_message("%d stores: served after %.2f s, %zu MB\n", STORES, took_s, held >> 20);
    assert_non_null(strstr(p.line, "serves 1000 datasets"));
    assert_true(held <= most_bytes);
    ask_port(p.port, "GET", "/d/many-999/tileset.json", "", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
    assert_int_equal(program_end(&p, SIGTERM), 0);
}

/* Whether ThreadSanitizer, if programs are built with it, lets threads be left behind. */
static void leave_threads(bool yes)
{
    static char was[512];
    char now[sizeof was + 32];
    if (yes)
        snprintf(was, sizeof was, "%s", getenv("TSAN_OPTIONS") ? getenv("TSAN_OPTIONS") : "");
    snprintf(now, sizeof now, "%s%s", was, yes ? " report_thread_leaks=0" : "");
    assert_int_equal(setenv("TSAN_OPTIONS", now, 1), 0);
}

/* Pictures that never come end the program, where that is asked for. It says why, also when a
 * thread is left behind, which opens a file that hangs. */
static void test_exit_hung(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    const char *const args[] = {
        dir, "--port", "0", "--device", "no such device", "--exit-hung", "--device-timeout-s",
        "1", NULL};
    struct program p = {.alone = true};
    struct err e = {0};
    kit_ok(file_join(dir, t.dir, "hung", &e), e);
    kit_ok(file_mkdir(dir, &e), e);
    kit_ok(file_join(path, dir, "good.tiles", &e), e);
    served_city(path, "good", 10);
    leave_threads(true); /* they are this test's subject, and no fault */
    program_start(&p, NULL, args);
    leave_threads(false);
    assert_true(ready_says(p.port, "\"pictures\": \"off: "));
    assert_true(ready_says(p.port, "tried again in"));
    kit_ok(file_join(path, dir, "slow.tiles", &e), e);
    served_city(path, "slow", 10);
    signal(SIGIO, SIG_IGN);
    const int lease = open(path, O_RDWR | O_CLOEXEC);
    assert_true(lease >= 0);
    const bool hangs = !fcntl(lease, F_SETLEASE, F_WRLCK); /* not on every file system */
    kill(p.pid, SIGHUP);
    assert_int_equal(program_end(&p, 0), EX_UNAVAILABLE);
    assert_int_equal(log_says(&p, "it is left behind"), hangs);
    assert_int_equal(log_says(&p, "--exit-hung is set"), 1);
    close(lease);
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
    program_start(&p, NULL, args);
    assert_true(program_end(&p, 0) != 0);
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
    char bad[FILE_PATH_MAX], conf[FILE_PATH_MAX], fifo[FILE_PATH_MAX], open[FILE_PATH_MAX],
        state_dir[FILE_PATH_MAX], names[FILE_PATH_MAX];
    struct err e = {0};
    assert_int_equal(chmod(rights_file("\"admin\"", "", open), 0644), 0);
    kit_ok(file_join(state_dir, t.dir, "state", &e), e);
    kit_ok(file_mkdir(state_dir, &e), e);
    kit_ok(file_join(names, state_dir, "appearances.sqlite", &e), e);
    kit_ok(file_write(names, "", 0, &e), e);
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
    close(busy);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_revocation),
        HTTP_TEST(test_cache_policies),
        HTTP_TEST(test_request_ids),
        HTTP_TEST(test_base_path),
        HTTP_TEST(test_admin_listener),
        HTTP_TEST(test_admin_of_a_public_url),
        HTTP_TEST(test_supervisor),
        HTTP_TEST(test_trace_is_written),
        HTTP_TEST(test_socket_activation),
        HTTP_TEST(test_check_and_exit_codes),
        HTTP_TEST(test_a_folder_is_served),
        HTTP_TEST(test_it_starts_with_what_is_whole),
        HTTP_TEST(test_exit_hung),
        HTTP_TEST(test_lines_of_the_log),
        HTTP_TEST(test_a_store_that_hangs),
        HTTP_TEST(test_a_store_that_hangs_at_the_end),
        HTTP_TEST(test_descriptors_for_more_stores),
        HTTP_TEST(test_a_thousand_stores),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
