/* Folders of stores, as the program serves them: stores that come, go, are broken, hang, or are
 * many.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): leases
#include "tests/server/program_kit.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <sysexits.h>

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

static void is_there(uint16_t port, const char *target)
{
    struct reply r;
    ask_port(port, "GET", target, "", &r);
    assert_int_equal(r.status, 200);
    buf_free(&r.raw);
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
    start(); /* tells the revision of the store, which addresses of tiles have */
    server_stop(&t.server);
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
    if (fcntl(lease, F_SETLEASE, F_WRLCK)) { /* none on this file system */
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
    is_there(p.port, "/healthz");
    is_there(p.port, tile_target(17, "glb", target));
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
    is_there(p.port, "/d/slow/tileset.json");
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_a_folder_is_served),
        HTTP_TEST(test_it_starts_with_what_is_whole),
        HTTP_TEST(test_exit_hung),
        HTTP_TEST(test_a_store_that_hangs),
        HTTP_TEST(test_a_store_that_hangs_at_the_end),
        HTTP_TEST(test_descriptors_for_more_stores),
        HTTP_TEST(test_a_thousand_stores),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
