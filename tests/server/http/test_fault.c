/* Faults in the server: the k-th allocation, thread, opened file, read, socket and epoll set fails,
 * one after another; SQLite's reads fail; stderr cannot be written. The linker puts __wrap_NAME in
 * place of NAME in our code (tests/CMakeLists.txt); libraries keep their functions.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include <errno.h>
#include <pthread.h>
#include <sqlite3.h>
#include <sys/epoll.h>

enum fault {
    FAULT_MEMORY,
    FAULT_THREAD,
    FAULT_OPEN,
    FAULT_READ,
    FAULT_SOCKET,
    FAULT_EPOLL,
    FAULTS
};
static const char *const fault_names[FAULTS] = {"allocation", "thread", "open",
                                                "read",       "socket", "epoll set"};
static _Atomic int fault_at[FAULTS]; /* counts down; fails where it becomes 0 */
static _Atomic bool fault_write, fault_pread;

static bool fault_now(enum fault f)
{
    return atomic_load(&fault_at[f]) > 0 && atomic_fetch_sub(&fault_at[f], 1) == 1;
}

static void fault_set(enum fault f, int k)
{
    if (f == FAULT_MEMORY)
        mem_fail_at((size_t)k);
    else
        atomic_store(&fault_at[f], k);
}

/* NOLINTBEGIN(cert-dcl51-cpp): the names that the linker gives */
int __real_pthread_create(pthread_t *id, const pthread_attr_t *a, void *(*fn)(void *), void *arg);
int __wrap_pthread_create(pthread_t *id, const pthread_attr_t *a, void *(*fn)(void *), void *arg);
int __wrap_pthread_create(pthread_t *id, const pthread_attr_t *a, void *(*fn)(void *), void *arg)
{
    return fault_now(FAULT_THREAD) ? EAGAIN : __real_pthread_create(id, a, fn, arg);
}

int __real_open(const char *path, int flags, ...);
int __wrap_open(const char *path, int flags, mode_t mode);
int __wrap_open(const char *path, int flags, mode_t mode)
{
    if (fault_now(FAULT_OPEN))
        return errno = EMFILE, -1;
    return __real_open(path, flags, mode);
}

ssize_t __real_read(int fd, void *p, size_t n);
ssize_t __wrap_read(int fd, void *p, size_t n);
ssize_t __wrap_read(int fd, void *p, size_t n)
{
    if (fault_now(FAULT_READ))
        return errno = EIO, -1;
    return __real_read(fd, p, n);
}

ssize_t __real_write(int fd, const void *p, size_t n);
ssize_t __wrap_write(int fd, const void *p, size_t n);
ssize_t __wrap_write(int fd, const void *p, size_t n)
{
    if (fd == STDERR_FILENO && atomic_load(&fault_write))
        return errno = EIO, -1;
    return __real_write(fd, p, n);
}

int __real_epoll_create1(int flags);
int __wrap_epoll_create1(int flags);
int __wrap_epoll_create1(int flags)
{
    if (fault_now(FAULT_EPOLL))
        return errno = EMFILE, -1;
    return __real_epoll_create1(flags);
}

int __real_listen(int fd, int n);
int __wrap_listen(int fd, int n);
int __wrap_listen(int fd, int n)
{
    if (fault_now(FAULT_SOCKET))
        return errno = EADDRINUSE, -1;
    return __real_listen(fd, n);
}
/* NOLINTEND(cert-dcl51-cpp) */

/* Starting fails in order at every step, says why, and leaves nothing open; the next try is
 * well. */
static void test_starting(void **state)
{
    enum { MOST = 100000 };
    t.cfg.admin = "127.0.0.1:0";
    int before = (int)open_files();
    for (int f = 0; f < FAULTS; f++) {
        int failed = 0;
        for (int k = 1; k < MOST; k += 1 + k / 12) {
            struct err e = {0};
            fault_set((enum fault)f, k);
            enum err_code rc = server_start(&t.cfg, t.paths, 1, &t.server, &e);
            fault_set((enum fault)f, 0);
            if (!rc) {
                server_stop(&t.server);
                break;
            }
            failed++;
            assert_null(t.server);
            if (!e.msg[0] || rc == ERR_INTERNAL)
                fail_msg("%s %d fails: %s '%s'", fault_names[f], k, kit_err(rc), e.msg);
        }
        print_message("%s: %d starts failed in order\n", fault_names[f], failed);
        if (f != FAULT_READ) /* nothing has to be read to start */
            assert_true(failed > 0);
        assert_int_equal((int)open_files(), before);
    }
    start();
    assert_int_equal(status_of("GET", "/healthz", ""), 200);
}

/* A status, or 0: closed without one. */
static int ask_anyhow(const char *target)
{
    struct buf b = {0}, q = {0};
    int fd = dial(t.port);
    buf_printf(&q, "GET %s HTTP/1.1\r\n" H "Connection: close\r\n\r\n", target);
    say_bytes(fd, (char *)q.data, q.size);
    double end_s = clock_s() + PATIENCE_S;
    while (hear_some(fd, &b, 0.5) && clock_s() < end_s)
        continue;
    assert_true(clock_s() < end_s); /* an answer or an end, but never nothing */
    close(fd);
    int status = b.size > 12 ? atoi((const char *)b.data + 9) : 0;
    buf_free(&b);
    buf_free(&q);
    return status;
}

static void test_serving_without_memory(void **state)
{
    enum { MOST = 60 };
    char target[128], cold[200];
    struct reply want, r;
    int by[600] = {0};
    t.cfg.client_tiles_s = 0;
    start();
    mem_on_short(NULL, NULL); /* else the cache gives way, and all are 200 (test_memory.c) */
    ask("GET", tile_target(17, "glb", target), "", &want);
    assert_int_equal(want.status, 200);
    static const char *const presets[] = {"spz", "preview", "balanced", "near-lossless"};
    for (int k = 1; k <= MOST; k++) {
        char drc[128];
        snprintf(cold, sizeof cold, "%s?preset=%s&sh=%d",
                 tile_target((uint8_t)(15 + k % 3), k % 2 ? "drc" : "spz", drc), presets[k / 3 % 4],
                 k / 12 % 2);
        mem_fail_at((size_t)k + 12); /* those of the asker among them */
        int status = ask_anyhow(cold);
        mem_fail_at(0);
        by[status]++;
        if (status && status != 200 && status != 500 && status != 503)
            fail_msg("allocation %d fails: status %d", k, status);
        ask("GET", target, "", &r); /* whatever happened, the next one is well */
        assert_int_equal(r.status, 200);
        assert_int_equal(r.body_size, want.body_size);
        assert_memory_equal(r.body, want.body, want.body_size);
        buf_free(&r.raw);
    }
    print_message("closed %d, 200 %d, 500 %d, 503 %d\n", by[0], by[200], by[500], by[503]);
    assert_true(by[0] + by[500] + by[503] > 0);
    buf_free(&want.raw);
    await_no_connections();
}

static ssize_t bad_pread(int fd, void *p, size_t n, off_t at)
{
    if (atomic_load(&fault_pread))
        return errno = EIO, -1;
    return pread(fd, p, n, at);
}

/* The disk fails for a while: what is in memory is served, the rest is 500, and afterwards all of
 * it again. */
static void test_disk_that_fails(void **state)
{
    char hot[128], cold[128];
    struct reply r;
    sqlite3_vfs *vfs = sqlite3_vfs_find(NULL);
    vfs->xSetSystemCall(vfs, "pread", (sqlite3_syscall_ptr)bad_pread);
    vfs->xSetSystemCall(vfs, "pread64", (sqlite3_syscall_ptr)bad_pread);
    start();
    assert_int_equal(status_of("GET", tile_target(17, "glb", hot), ""), 200);
    atomic_store(&fault_pread, true);
    ask("GET", tile_target(15, "ply", cold), "", &r);
    bool reads =
        r.status != 200; /* else SQLite was built to read in another way, or had the page */
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", hot, ""), 200);
    if (reads) {
        ask("GET", "/readyz", "", &r);
        assert_int_equal(r.status, 200);
        assert_non_null(strstr((const char *)r.body, "degraded"));
        buf_free(&r.raw);
    }
    atomic_store(&fault_pread, false);
    int status = 0;
    for (double end_s = clock_s() + PATIENCE_S; status != 200 && clock_s() < end_s; nap_ms(50))
        status = status_of("GET", cold, "");
    assert_int_equal(status, 200);
    print_message("the disk %s\n", reads ? "failed and came back" : "was not asked");
    vfs->xSetSystemCall(vfs, "pread", NULL);
    vfs->xSetSystemCall(vfs, "pread64", NULL);
}

static void test_log_that_fails(void **state)
{
    t.cfg.access_log = true;
    log_set_level(LOG_INFO);
    atomic_store(&fault_write, true);
    start();
    for (int i = 0; i < 50; i++)
        assert_int_equal(status_of("GET", "/healthz", ""), 200);
    server_stop(&t.server);
    atomic_store(&fault_write, false);
    log_set_level(LOG_ERROR);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_starting),
        HTTP_TEST(test_serving_without_memory),
        HTTP_TEST(test_disk_that_fails),
        HTTP_TEST(test_log_that_fails),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
