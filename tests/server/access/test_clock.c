/* The time of day is set forward and back while the server works (the linker's --wrap puts a shift
 * between program and clock). Waits and deadlines do not change; dates in answers follow it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include <fcntl.h>
#include <stdatomic.h>
#include <sys/stat.h>

#include "server/access/auth.h"

int __real_clock_gettime(clockid_t id, struct timespec *out); // NOLINT: the linker's names
int __wrap_clock_gettime(clockid_t id, struct timespec *out); // NOLINT
time_t __real_time(time_t *out);                              // NOLINT
time_t __wrap_time(time_t *out);                              // NOLINT

enum { DAY_S = 86400 };
static const double SOON_S = 10; /* far above what a busy machine needs, far below a day */
static _Atomic long shift_s;

int __wrap_clock_gettime(clockid_t id, struct timespec *out) // NOLINT
{
    int rc = __real_clock_gettime(id, out);
    if (id == CLOCK_REALTIME)
        out->tv_sec += atomic_load(&shift_s);
    return rc;
}

time_t __wrap_time(time_t *out) // NOLINT
{
    time_t now = __real_time(NULL) + atomic_load(&shift_s);
    if (out)
        *out = now;
    return now;
}

/* ---- stopping ---- */

static _Atomic bool hangs, runs;

static enum err_code clock_run(void *user, const struct job *j, void *work, size_t worker,
                               struct body **out, struct err *e)
{
    (void)user, (void)j, (void)work, (void)worker;
    atomic_store(&runs, true);
    while (atomic_load(&hangs))
        nap_ms(2);
    *out = body_text("a picture");
    return *out ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
}

static void clock_drop(void *user, void *work)
{
    (void)user;
    mem_free(work);
}

static void clock_wake(struct job_waiter *w)
{
    body_drop(&w->result.body);
}

/* The clock is put back by a day just as the server begins to wait for a device that hangs: what it
 * read then is a day ahead of the kernel's. */
static void test_stopping(void **state)
{
    const struct job_config cfg = {.draw_threads = 1,
                                   .queue_limit = {4, 4, 4, 4, 4, 4},
                                   .stop_s = 0.2,
                                   .run = clock_run,
                                   .drop = clock_drop};
    struct err e = {0};
    struct jobs *js = NULL;
    struct job_waiter w = {.wake = clock_wake};
    atomic_store(&hangs, true);
    kit_ok(job_open(&cfg, &js, &e), e);
    assert_int_equal(job_submit(js, JOB_VIEW, (struct hash128){1, 2}, mem_text("work"), 1, 5, &w),
                     ERR_OK);
    while (!atomic_load(&runs))
        nap_ms(2);
    atomic_store(&shift_s, DAY_S);
    double start_s = clock_s();
    assert_false(job_stop(js));
    assert_true(clock_s() - start_s < SOON_S);
    atomic_store(&hangs, false);
    assert_true(job_close(&js));
    atomic_store(&shift_s, 0);
}

/* The same of the log, whose reader has stopped. */
static void test_log(void **state)
{
    struct err e = {0};
    int pipe_fd[2], err_fd = dup(STDERR_FILENO);
    char bytes[65536];
    assert_int_equal(pipe(pipe_fd), 0);
    assert_true(fcntl(pipe_fd[0], F_SETFL, O_NONBLOCK) >= 0);
    kit_ok(log_start(&e), e);
    assert_true(dup2(pipe_fd[1], STDERR_FILENO) >= 0);
    memset(bytes, 'x', sizeof bytes);
    bytes[1000] = '\n';
    for (int i = 0; i < 200; i++) /* more than a pipe holds */
        log_write(bytes, 1001);
    atomic_store(&shift_s, DAY_S);
    double start_s = clock_s();
    log_stop(0.1);
    assert_true(clock_s() - start_s < SOON_S);
    atomic_store(&shift_s, 0);
    assert_true(dup2(err_fd, STDERR_FILENO) >= 0); /* the next half goes there */
    close(pipe_fd[1]);
    for (int i = 0; i < 200 && read(pipe_fd[0], bytes, sizeof bytes) != 0; i++)
        nap_ms(2);
    log_stop(5);
    close(pipe_fd[0]);
    close(err_fd);
}

/* ---- serving ---- */

static const long jumps_s[] = {DAY_S, -DAY_S, 1, -1, 400L * DAY_S, -400L * DAY_S, 0};

/* Tiles are made and answered, a connection that is idle or waits is kept, one that sends its
 * request too slowly is cut in its time and not before. */
static void test_serving(void **state)
{
    static const char *const exts[] = {"glb", "spz", "drc", "ply", "plain.glb", "compressed.ply",
                                       "sog"};
    char target[128];
    struct buf rest = {0}, q = {0};
    struct reply r;
    t.cfg.header_timeout_s = 1.5;
    t.cfg.idle_timeout_s = 60;
    start();
    int kept = dial(t.port), slow = dial(t.port);
    double start_s = clock_s();
    say(slow, "GET / HTTP/1.1\r\n");
    for (size_t i = 0; i < sizeof jumps_s / sizeof *jumps_s; i++) {
        atomic_store(&shift_s, jumps_s[i]);
        q.size = 0;
        buf_printf(&q, "GET %s HTTP/1.1\r\n" H "\r\n", tile_target(17, exts[i], target));
        say_bytes(kept, (char *)q.data, q.size);
        hear(kept, true, &rest, &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
        nap_ms(120); /* the watching thread looks ten times a second */
    }
    struct pollfd p = {.fd = slow, .events = POLLIN};
    if (clock_s() - start_s < 1.4)
        assert_int_equal(poll(&p, 1, 0), 0);
    assert_int_equal(poll(&p, 1, (int)(SOON_S * 1000)), 1);
    assert_true(clock_s() - start_s >= 1.4);
    assert_true(clock_s() - start_s < SOON_S);
    assert_int_equal(status_of("GET", "/readyz", ""), 200);
    buf_free(&rest);
    buf_free(&q);
    close(kept);
    close(slow);
}

/* A signed address holds until its date, whichever way the clock comes there; tags and caches hold
 * on to what they are. */
static void test_dates(void **state)
{
    static const char text[] = "{\"keys\": {\"k\": \"0123456789abcdef0123456789abcdef\"}}";
    char path[FILE_PATH_MAX], query[AUTH_QUERY_MAX], target[1024], etag[64];
    struct auth *a = NULL;
    struct err e = {0};
    struct reply r;
    kit_ok(file_join(path, t.dir, "auth.jsonc", &e), e);
    kit_ok(file_write(path, text, sizeof text - 1, &e), e);
    assert_int_equal(chmod(path, 0600), 0);
    t.cfg.auth = path;
    start();
    kit_ok(auth_open(path, &a, &e), e);
    const int64_t now_s = (int64_t)time(NULL);
    const int64_t most_s = 30 * 86400 + 60; /* the default of max_age_s, and clocks that differ */
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_READ, "toy", now_s + 3600, now_s, query, &e), e);
    auth_close(&a);
    snprintf(target, sizeof target, "/signed/%s/d/toy/tileset.json", query);
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 200);
    snprintf(etag, sizeof etag, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    for (size_t i = 0; i < sizeof jumps_s / sizeof *jumps_s; i++) {
        atomic_store(&shift_s, jumps_s[i]);
        ask("GET", target, "", &r);
        assert_int_equal(r.status, jumps_s[i] > 3600 || 3600 - jumps_s[i] > most_s ? 403 : 200);
        assert_string_equal(header(&r, "ETag"), r.status == 200 ? etag : "");
        buf_free(&r.raw);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_stopping), cmocka_unit_test(test_log),
                                       HTTP_TEST(test_serving), HTTP_TEST(test_dates)};
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
