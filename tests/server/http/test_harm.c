/* Damage from outside while the server runs: a store that is truncated, readers that take large
 * bodies slowly, a log that nobody reads, revisions that come and go.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include <fcntl.h>
#include <sys/stat.h>

/* ---- the file under it ---- */

/* A store that is cut short while it is served: the tiles that are gone are 500 and named, the
 * others are served, and /readyz says so. The process lives. */
static void test_truncated_store(void **state)
{
    static const char *const forms[] = {"glb", "spz", "drc", "ply", "plain.glb", "compressed.ply",
                                        "sog"};
    struct err e = {0};
    char path[FILE_PATH_MAX], target[128];
    struct stat st;
    int n_ok = 0, n_bad = 0;
    struct reply r;
    kit_ok(file_join(path, t.dir, "cut.tiles", &e), e);
    served_city(path, "toy", 4000);
    t.paths[0] = path;
    start();
    t.paths[0] = t.path;
    ask("GET", "/readyz", "", &r);
    buf_add(&r.raw, "", 1);
    assert_non_null(strstr((const char *)r.body, "\"ready\""));
    buf_free(&r.raw);
    assert_int_equal(stat(path, &st), 0);
    assert_int_equal(truncate(path, st.st_size / 2), 0);
    for (size_t f = 0; f < sizeof forms / sizeof *forms; f++)
        for (uint8_t z = SERVED_ZOOM_MIN; z <= SERVED_ZOOM_MAX; z++) {
            char name[64];
            struct key k = served_key(z);
            ask("GET", tile_target(z, forms[f], target), "", &r);
            n_ok += r.status == 200;
            n_bad += r.status == 500;
            snprintf(name, sizeof name, "tile %u/%u/%u", k.z, k.x, k.y);
            buf_add(&r.raw, "", 1);
            if (r.status == 500)
                assert_non_null(strstr((const char *)r.body, name));
            else
                assert_int_equal(r.status, 200);
            buf_free(&r.raw);
        }
    assert_true(n_ok > 0 && n_bad > 0);
    ask("GET", "/readyz", "", &r);
    assert_int_equal(r.status, 200); /* it answers: a balancer need not take it out */
    buf_add(&r.raw, "", 1);
    kit_expect_text((const char *)r.body, "degraded", __FILE__, __LINE__);
    kit_expect_text((const char *)r.body, "toy", __FILE__, __LINE__);
    buf_free(&r.raw);
    assert_int_equal(truncate(path, 0), 0);
    assert_int_equal(status_of("GET", tile_target(16, "ply", target), "Range: bytes=0-9\r\n"),
                     n_ok ? status_of("GET", target, "Range: bytes=0-9\r\n") : 500);
    struct err why = {0};
    t.paths[0] = path;
    assert_int_not_equal(server_reload(t.server, &why), ERR_OK); /* the old index stays */
    assert_int_not_equal(server_reload(t.server, NULL), ERR_OK);
    t.paths[0] = t.path;
    assert_int_equal(status_of("GET", "/d/toy/tileset.json", ""), 200);
}

/* ---- revisions that come and go ---- */

/* The status of /readyz, and what it says of the last reload. */
static void readyz(const char *status, const char *reload, const char *extra)
{
    struct reply r;
    ask("GET", "/readyz", extra, &r);
    assert_int_equal(r.status, 200);
    buf_add(&r.raw, "", 1);
    kit_expect_text((const char *)r.body, status, __FILE__, __LINE__);
    if (reload)
        kit_expect_text((const char *)r.body, reload, __FILE__, __LINE__);
    else
        assert_null(strstr((const char *)r.body, "reload"));
    buf_free(&r.raw);
}

/* The file is replaced twelve times: tiles of the last three revisions are served, cold ones as
 * well, open files do not grow, and a day later only the current one is left. A reload that fails
 * leaves all as it was, and /readyz says why. */
static void test_revisions(void **state)
{
    enum { ROUNDS = 12, KEEP = 3 };
    static const char *const exts[] = {"spz", "drc", "glb"};
    struct err e = {0};
    char path[FILE_PATH_MAX], target[128], revs[ROUNDS][13];
    size_t files = 0;
    kit_ok(file_join(path, t.dir, "moving.tiles", &e), e);
    t.paths[0] = path;
    t.cfg.keep_revisions = KEEP;
    served_city(path, "toy", 100);
    start();
    t.paths[0] = t.path;
    for (int i = 0; i < ROUNDS; i++) {
        memcpy(revs[i], t.rev, sizeof t.rev);
        if (i == ROUNDS - 1)
            break;
        served_city(path, "toy", 101 + (size_t)i);
        t.paths[0] = path;
        kit_ok(server_reload(t.server, &e), e);
        t.paths[0] = t.path;
        struct catalog *c = services_catalog(server_services(t.server));
        memcpy(t.rev, c->ds[0]->meta.revision, sizeof t.rev);
        catalog_drop(&c);
        if (i == KEEP)
            files = open_files();
    }
    assert_int_equal(open_files(), files);
    for (int i = 0; i < ROUNDS; i++) {
        memcpy(t.rev, revs[i], sizeof t.rev);
        for (size_t f = 0; f < 3; f++) {
            int status = status_of("GET", tile_target(17, exts[f], target), "");
            assert_int_equal(status, i >= ROUNDS - 1 - KEEP ? 200 : 404);
        }
        snprintf(target, sizeof target, "/d/toy/r/%s/tileset.json", t.rev);
        assert_int_equal(status_of("GET", target, ""), i >= ROUNDS - 1 - KEEP ? 200 : 404);
    }
    readyz("ready", NULL, "");
    kit_ok(file_write(path, "not a store", 11, &e), e);
    t.paths[0] = path;
    kit_fails(server_reload(t.server, &e), ERR_FORMAT, e, "moving.tiles");
    t.paths[0] = t.path;
    readyz("degraded", "moving.tiles: not a tile store", "");
    readyz("degraded", "the log says why", "X-Forwarded-For: 9.9.9.9\r\n"); /* no names of files */
    assert_int_equal(status_of("GET", tile_target(16, "ply", target), ""), 200);
    served_city(path, "toy", 100 + ROUNDS - 1); /* the bytes that are served, again */
    t.paths[0] = path;
    kit_ok(server_reload(t.server, &e), e);
    t.paths[0] = t.path;
    readyz("ready", NULL, "");
    size_t before = open_files();
    server_expire(t.server, clock_s() + 86500);
    assert_true(open_files() < before);
    assert_int_equal(status_of("GET", tile_target(16, "ply", target), ""), 200);
    memcpy(t.rev, revs[ROUNDS - 2], sizeof t.rev);
    assert_int_equal(status_of("GET", tile_target(17, "spz", target), ""), 404);
}

/* ---- slow readers ---- */

static double resident_mb(void)
{
    long pages = 0, skip = 0;
    FILE *f = fopen("/proc/self/statm", "r");
    assert_non_null(f);
    assert_int_equal(fscanf(f, "%ld %ld", &skip, &pages), 2);
    fclose(f);
    return (double)pages * (double)sysconf(_SC_PAGESIZE) / 1048576.0;
}

/* Ask without reading more than the beginning of the answer; its status. */
static int ask_slowly(int fd, const char *target)
{
    char request[256];
    struct buf b = {0};
    const int small = 4096;
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n", target);
    say(fd, request);
    char head[16] = "";
    for (size_t n = 0; n < 15;) {
        ssize_t k = recv(fd, head + n, 15 - n, 0);
        if (k <= 0)
            fail_msg("no answer to %s", target);
        n += (size_t)k;
    }
    buf_free(&b);
    return atoi(head + 9);
}

/* Forty clients take one body that is larger than what the cache keeps, slowly: it is in memory
 * once. Other large bodies are made as far as the budget goes, then 503 with Retry-After; when the
 * readers have gone, everything is served again. */
static void test_large_bodies_in_flight(void **state)
{
    enum { READERS = 40, GAUSSIANS = 60000 };
    struct err e = {0};
    char path[FILE_PATH_MAX], target[128], other[128];
    int fd[READERS], others[8], refused = 0;
    struct reply r;
    kit_ok(file_join(path, t.dir, "large.tiles", &e), e);
    served_city(path, "toy", GAUSSIANS);
    t.paths[0] = path;
    t.cfg.cache_mb = 16;
    t.cfg.inflight_mb = 16;
    start();
    t.paths[0] = t.path;
    tile_target(17, "ply", target);
    ask("GET", target, "", &r); /* what one costs is paid before */
    assert_int_equal(r.status, 200);
    double body_mb = (double)r.body_size / 1048576.0;
    assert_true(body_mb > 1); /* a shard of the cache */
    buf_free(&r.raw);
    double before_mb = resident_mb();
    for (int i = 0; i < READERS; i++) {
        fd[i] = dial(t.port);
        assert_int_equal(ask_slowly(fd[i], target), 200);
    }
    double grown_mb = resident_mb() - before_mb;
#ifdef __SANITIZE_THREAD__
    grown_mb /= 4; /* its shadow of every byte written is resident as well */
#endif
    if (grown_mb > 4 * body_mb + 8)
        fail_msg("%d readers of %.1f MB: %.1f MB more", READERS, body_mb, grown_mb);
    size_t n = 0;
    for (uint8_t z = 15; z <= 17; z++)
        for (int f = z == 17; f < 2; f++, n++) {
            others[n] = dial(t.port);
            int status = ask_slowly(others[n], tile_target(z, f ? "plain.glb" : "ply", other));
            assert_true(status == 200 || status == 503);
            refused += status == 503;
        }
    assert_true(refused > 0);
    assert_true(live_bodies_bytes(server_services(t.server)->live_bodies) <= (size_t)17 << 20);
    ask("GET", tile_target(15, "glb", other), "", &r); /* small ones may wait, too */
    assert_true(r.status == 200 || (r.status == 503 && atoi(header(&r, "Retry-After")) > 0));
    buf_free(&r.raw);
    for (int i = 0; i < READERS; i++)
        close(fd[i]);
    for (size_t i = 0; i < n; i++)
        close(others[i]);
    await_no_connections();
    for (uint8_t z = 15; z <= 17; z++)
        assert_int_equal(status_of("GET", tile_target(z, "ply", other), ""), 200);
}

/* A client that reads, but below the least rate, is cut; one that reads faster is not, however long
 * it takes. */
static void test_least_rate(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX], target[128], request[256], bytes[8192];
    kit_ok(file_join(path, t.dir, "rate.tiles", &e), e);
    served_city(path, "toy", 60000);
    t.paths[0] = path;
    t.cfg.write_timeout_s = 0.5;
    t.cfg.min_rate_kb = 200;
    start();
    t.paths[0] = t.path;
    struct metrics *m = &server_services(t.server)->metrics;
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             tile_target(17, "ply", target));
    const struct {
        size_t chunk;
        int buffer, rate_kb;
        bool cut;
        double most_s; /* a loaded machine may be late to cut, never early */
    } rows[] = {{400, 4096, 40, true, 20.0}, {sizeof bytes, 65536, 800, false, 2.5}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        uint64_t reaped = atomic_load(&m->reaped);
        int fd = dial(t.port);
        setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &rows[i].buffer, sizeof rows[i].buffer);
        say(fd, request);
        double start_s = clock_s(), got_kb = 0;
        while (clock_s() < start_s + rows[i].most_s && atomic_load(&m->reaped) == reaped) {
            ssize_t n = recv(fd, bytes, rows[i].chunk, 0);
            if (n <= 0)
                break;
            got_kb += (double)n / 1000;
            while (got_kb > rows[i].rate_kb * (clock_s() - start_s)) /* late naps are caught up */
                nap_ms(1);
        }
        assert_int_equal(atomic_load(&m->reaped) > reaped, rows[i].cut);
        close(fd);
        await_no_connections();
    }
}

/* ---- a log that nobody reads ---- */

static void test_blocked_stderr(void **state)
{
    int log[2], was = dup(STDERR_FILENO);
    char bytes[4096];
    assert_int_equal(pipe(log), 0);
    assert_int_equal(fcntl(log[1], F_SETFL, O_NONBLOCK), 0);
    memset(bytes, 'x', sizeof bytes);
    while (write(log[1], bytes, sizeof bytes) > 0)
        continue;
    assert_int_equal(fcntl(log[1], F_SETFL, 0), 0);
    assert_int_equal(dup2(log[1], STDERR_FILENO), STDERR_FILENO); /* from here, writing hangs */
    log_set_level(LOG_INFO);
    t.cfg.access_log = true;
    t.cfg.header_timeout_s = 0.3;
    start();
    bool served = true;
    for (int i = 0; i < 50; i++) {
        served &= status_of("GET", "/healthz", "") == 200;
        nap_ms(10);
    }
    int fd = dial(t.port); /* timeouts work */
    struct buf b = {0};
    say(fd, "GET / HT");
    double start_s = clock_s();
    bool open = hear_some(fd, &b, 10);
    double cut_s = clock_s() - start_s;
    close(fd);
    start_s = clock_s();
    server_stop(&t.server); /* and so does stopping */
    double stop_s = clock_s() - start_s;
    dup2(was, STDERR_FILENO);
    close(was);
    close(log[0]); /* the thread that hangs gets EPIPE */
    close(log[1]);
    log_set_level(LOG_ERROR);
    nap_ms(100);
    log_stop(1);
    buf_free(&b);
    assert_true(served);
    assert_false(open);
    assert_true(cut_s < 5 && stop_s < 10);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_truncated_store),        HTTP_TEST(test_revisions),
        HTTP_TEST(test_large_bodies_in_flight), HTTP_TEST(test_least_rate),
        HTTP_TEST(test_blocked_stderr),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
