/* The folder of results: it keeps its limit, and stays valid whatever happens to its files, its
 * disk or its server.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include "core/pool.h"
#include "server/data/disk.h"

ssize_t __real_write(int fd, const void *bytes, size_t n); // NOLINT: the linker's names
ssize_t __wrap_write(int fd, const void *bytes, size_t n); // NOLINT

static _Atomic long write_room = -1; /* bytes that the disk still takes; -1: any number */

ssize_t __wrap_write(int fd, const void *bytes, size_t n) // NOLINT
{
    const long room = atomic_load(&write_room);
    if (room < 0 || fd <= STDERR_FILENO)
        return __real_write(fd, bytes, n);
    if (!room) {
        errno = ENOSPC;
        return -1;
    }
    n = n < (size_t)room ? n : (size_t)room; /* the last write is a short one */
    atomic_fetch_sub(&write_room, (long)n);
    return __real_write(fd, bytes, n);
}

/* ---- a folder ---- */

enum { MB = 1 << 20, SIZE = 200, LONG = FILE_PATH_MAX + 320 };
static char folder[FILE_PATH_MAX];

static struct hash128 disk_id(uint64_t k)
{
    return hash_bytes(&k, sizeof k);
}

/* What is kept under the k-th name. */
static void disk_bytes(uint64_t k, size_t n, struct buf *out)
{
    const uint64_t word = hash_bytes(&k, sizeof k).lo;
    for (size_t i = 0; i < n; i++)
        buf_u8(out, (unsigned)(word >> i % 57) & 0xff);
}

static void put(struct disk *d, uint64_t k, size_t n)
{
    struct buf b = {0};
    disk_bytes(k, n, &b);
    disk_put(d, disk_id(k), b.data, b.size, false);
    buf_free(&b);
}

/* True when it is there; whatever is there is right. */
static bool got(struct disk *d, uint64_t k, size_t n)
{
    struct buf b = {0}, want = {0};
    bool there = disk_get(d, disk_id(k), &b);
    disk_bytes(k, n, &want);
    if (there && (b.size != want.size || memcmp(b.data, want.data, b.size) != 0))
        fail_msg("name %llu has other bytes", (unsigned long long)k);
    if (!there)
        assert_int_equal(b.size, 0);
    buf_free(&b);
    buf_free(&want);
    return there;
}

static void path_of(uint64_t k, char out[LONG])
{
    char name[33];
    hash_text(disk_id(k), name);
    snprintf(out, LONG, "%s/%.2s/%s", folder, name, name + 2);
}

static struct disk *open_folder(const char *name, uint64_t limit)
{
    struct disk *d = NULL;
    struct err e = {0};
    kit_ok(file_join(folder, t.dir, name, &e), e);
    kit_ok(disk_open(folder, limit, &d, &e), e);
    return d;
}

static struct disk_stats count(struct disk *d)
{
    struct disk_stats st;
    disk_count(d, &st);
    return st;
}

/* Files of the folder, and their bytes in whole blocks. */
static size_t files(uint64_t *bytes)
{
    char path[LONG];
    size_t n = 0;
    *bytes = 0;
    for (unsigned i = 0; i < 256; i++) {
        snprintf(path, sizeof path, "%s/%02x", folder, i);
        DIR *dir = opendir(path);
        for (struct dirent *f; dir && (f = readdir(dir));) {
            struct stat st;
            if (f->d_name[0] == '.' || fstatat(dirfd(dir), f->d_name, &st, 0))
                continue;
            *bytes += (uint64_t)(st.st_size + 4095) / 4096 * 4096;
            n++;
        }
        if (dir)
            closedir(dir);
    }
    return n;
}

static void test_round_trip(void **state)
{
    struct err e = {0};
    struct disk *d, *other = NULL;
    struct stat st;
    uint64_t bytes;
    d = open_folder("round", 64 * MB);
    for (uint64_t k = 0; k < 50; k++) {
        assert_false(got(d, k, k * 97));
        put(d, k, k * 97);
        assert_true(got(d, k, k * 97));
    }
    put(d, 7, 7 * 97); /* written again */
    assert_int_equal(count(d).entries, 50);
    assert_int_equal(count(d).bytes, files(&bytes) ? bytes : 0);
    kit_fails(disk_open(folder, MB, &other, &e), ERR_BUSY, e, "another server uses it");
    kit_ok(disk_check(folder, &e), e);
    put(NULL, 1, 1); /* no disk cache: nothing happens */
    disk_close(&d);
    assert_int_equal(stat(folder, &st), 0);
    d = open_folder("round", 64 * MB);
    assert_int_equal(count(d).entries, 50);
    for (uint64_t k = 0; k < 50; k++)
        assert_true(got(d, k, k * 97));
    char path[LONG]; /* somebody empties it under way */
    path_of(3, path);
    assert_int_equal(unlink(path), 0);
    *strrchr(path, '/') = '\0';
    (void)rmdir(path);
    assert_false(got(d, 3, 3 * 97));
    put(d, 3, 3 * 97);
    assert_true(got(d, 3, 3 * 97));
    assert_int_equal(count(d).damaged + count(d).failed, 0);
    disk_close(&d);
    kit_fails(disk_check("/proc/nowhere", &e), ERR_IO, e, "--cache-dir");
    kit_fails(disk_open("/proc/nowhere", MB, &d, &e), ERR_IO, e, "--cache-dir");
}

/* Never more than the limit, the least recently used goes first, also after a restart. */
static void test_bounded(void **state)
{
    enum { N = 60, BYTES = 60000, LIMIT = 16 * 65536 /* of each a sixteenth */ };
    struct disk *d = open_folder("bounded", LIMIT);
    uint64_t bytes;
    for (uint64_t k = 0; k < N; k++) {
        put(d, k, BYTES);
        assert_true(count(d).bytes <= LIMIT);
        assert_true(got(d, 0, BYTES)); /* the one that is used stays */
    }
    assert_int_equal(files(&bytes), count(d).entries);
    assert_true(bytes <= LIMIT && bytes > LIMIT / 2);
    assert_int_equal(count(d).evicted, N - count(d).entries);
    put(d, 1000, LIMIT / 16 + 1); /* too large to be worth it */
    assert_false(got(d, 1000, LIMIT / 16 + 1));
    const size_t n = count(d).entries;
    for (uint64_t k = 1; k < N; k++)
        assert_int_equal(got(d, k, BYTES), k >= N - n + 1);
    disk_close(&d);
    static const struct timespec old[2] = {{.tv_sec = 1}, {.tv_sec = 1}};
    char path[LONG];
    path_of(N - 1, path); /* by their times: this is the oldest now */
    assert_int_equal(utimensat(AT_FDCWD, path, old, 0), 0);
    d = open_folder("bounded", LIMIT / 2); /* less is allowed now */
    assert_true(count(d).bytes <= LIMIT / 2);
    assert_int_equal(files(&bytes), count(d).entries);
    assert_false(got(d, N - 1, BYTES));
    disk_close(&d);
}

/* What cannot be read now is no damage: no memory, or a limit that is smaller than at its time. */
static void test_sound_files_are_no_damage(void **state)
{
    enum { BYTES = 60000, LIMIT = 16 * 65536 };
    struct disk *d = open_folder("sound", LIMIT);
    char path[LONG];
    put(d, 1, BYTES);
    path_of(1, path);
    struct buf b = {0};
    mem_fail_at(1);
    assert_false(disk_get(d, disk_id(1), &b));
    mem_fail_at(0);
    buf_free(&b);
    assert_true(file_exists(path));
    assert_true(got(d, 1, BYTES));
    disk_close(&d);
    d = open_folder("sound", LIMIT / 2);
    assert_false(got(d, 1, BYTES));
    assert_false(file_exists(path)); /* it would never be read */
    assert_int_equal(count(d).evicted, 1);
    assert_int_equal(count(d).entries, 0);
    assert_int_equal(count(d).damaged, 0);
    disk_close(&d);
}

/* ---- damage ---- */

static void write_file(const char *path, const struct buf *b, size_t n)
{
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(b->data, 1, n, f), n);
    assert_int_equal(fclose(f), 0);
}

/* A scan of the city, each result used once, leaves what was used again; so it does after a
 * restart, and where memory answered in between. */
static void test_scan(void **state)
{
    enum { WARM = 600, SCAN = 4000, EACH = 16000 };
    struct disk *d = open_folder("scan", 16 * MB);
    for (uint64_t k = 0; k < WARM; k++)
        put(d, k, EACH);
    for (uint64_t k = 0; k < WARM; k++) {
        if (k % 2)
            disk_note(d, disk_id(k));
        else
            assert_true(got(d, k, EACH));
    }
    for (uint64_t run = 0; run < 2; run++) {
        size_t kept = 0;
        for (uint64_t k = 0; k < SCAN; k++)
            put(d, 1000 + run * SCAN + k, EACH);
        assert_true(count(d).bytes <= 16 * MB);
        for (uint64_t k = 0; k < WARM; k++)
            kept += got(d, k, EACH);
        assert_true(kept >= WARM * 9 / 10);
        disk_close(&d);
        d = open_folder("scan", 16 * MB);
    }
    disk_close(&d);
}

/* Results of polygons have an eighth and push out only each other, also after a restart. */
static void test_apart(void **state)
{
    enum { OWN = 100, APART = 1000, EACH = 16000 };
    struct disk *d = open_folder("apart", 16 * MB);
    struct buf b = {0};
    size_t kept = 0;
    for (uint64_t k = 0; k < OWN; k++)
        put(d, k, EACH);
    disk_bytes(7, EACH, &b);
    for (int run = 0; run < 2; run++) {
        for (uint64_t k = 0; k < APART; k++)
            disk_put(d, disk_id(5000 + k + (uint64_t)run * APART), b.data, b.size, true);
        assert_true(count(d).bytes <= OWN * 20480 + 2 * MB);
        disk_close(&d);
        d = open_folder("apart", 16 * MB);
    }
    for (uint64_t k = 0; k < OWN; k++)
        kept += got(d, k, EACH);
    assert_int_equal(kept, OWN);
    buf_free(&b);
    disk_close(&d);
}

static void test_damage(void **state)
{
    char path[LONG], other[LONG + 8];
    struct disk *d = open_folder("damage", 64 * MB);
    struct buf good = {0}, bad = {0};
    struct err e = {0};
    log_set_level(LOG_ERROR);
    put(d, 1, SIZE);
    path_of(1, path);
    kit_ok(file_read(path, 0, &good, &e), e);
    uint64_t damaged = 0;
    for (size_t i = 0; i < good.size; i++) { /* each byte, and each length */
        const bool unused = i >= 48 && i < 64;
        put(d, 1, SIZE);
        bad.size = 0;
        buf_add(&bad, good.data, good.size);
        bad.data[i] ^= (uint8_t)(1 << i % 8);
        write_file(path, &bad, bad.size);
        assert_int_equal(got(d, 1, SIZE), unused);
        damaged += !unused;
        assert_int_equal(file_exists(path), unused);
        put(d, 1, SIZE);
        write_file(path, &good, i);
        assert_false(got(d, 1, SIZE));
        damaged++;
    }
    put(d, 1, SIZE);
    buf_u8(&good, 0); /* longer */
    write_file(path, &good, good.size);
    assert_false(got(d, 1, SIZE));
    put(d, 1, SIZE);
    put(d, 2, SIZE);
    path_of(2, other); /* another one's file under its name */
    assert_int_equal(rename(other, path), 0);
    assert_false(got(d, 1, SIZE));
    assert_false(got(d, 2, SIZE)); /* gone, and not damaged */
    assert_int_equal(count(d).damaged, damaged + 2);
    put(d, 1, SIZE);
    put(d, 2, SIZE);
    assert_int_equal(unlink(other), 0);
    assert_int_equal(symlink(path, other), 0); /* is not followed */
    assert_false(got(d, 2, SIZE));
    disk_close(&d);
    snprintf(other, sizeof other, "%s.part", path); /* left by a server that was killed */
    write_file(other, &good, 10);
    d = open_folder("damage", 64 * MB);
    assert_false(file_exists(other));
    assert_int_equal(count(d).entries, 1);
    assert_true(got(d, 1, SIZE));
    disk_close(&d);
    buf_free(&good);
    buf_free(&bad);
}

/* A disk that is full after so many bytes: nothing half is left, and it is as before when there is
 * room again. */
static void test_full_disk(void **state)
{
    struct disk *d = open_folder("full", 64 * MB);
    uint64_t bytes;
    put(d, 1, SIZE);
    for (long room = 0; room < 64 + SIZE; room += 7) {
        atomic_store(&write_room, room);
        put(d, 2, SIZE);
        put(d, 3, 3 * SIZE);
        atomic_store(&write_room, -1);
        assert_false(got(d, 2, SIZE));
        assert_false(got(d, 3, 3 * SIZE));
        assert_true(got(d, 1, SIZE));
        assert_int_equal(files(&bytes), 1);
    }
    assert_int_equal(count(d).failed, 2 * ((64 + SIZE + 6) / 7));
    put(d, 2, SIZE);
    assert_true(got(d, 2, SIZE));
    disk_close(&d);
}

/* ---- processes and threads ---- */

enum { KILLS = 25, NAMES = 30 };

/* Writes until it is killed, and closes `began` after its first file. */
static void write_for_ever(uint64_t first, const int began[2])
{
    struct disk *d = NULL;
    struct err e = {0};
    if (file_join(folder, t.dir, "killed", &e) || disk_open(folder, 4 * MB, &d, &e))
        _exit(1);
    put(d, first % NAMES, 20000 + first % NAMES);
    close(began[0]);
    close(began[1]);
    for (uint64_t k = first + 1;; k++)
        put(d, k % NAMES, 20000 + k % NAMES);
}

/* Killed while it writes: whatever the next one finds is whole. */
static void test_killed(void **state)
{
    size_t found = 0;
    for (unsigned i = 0; i < KILLS; i++) {
        int began[2]; /* closed by its first file: on a busy machine it may take long to begin */
        char none;
        assert_int_equal(pipe(began), 0);
        pid_t pid = fork();
        assert_true(pid >= 0);
        if (!pid)
            write_for_ever(i, began);
        close(began[1]);
        assert_int_equal(read(began[0], &none, 1), 0);
        close(began[0]);
        nap_ms(5 + (long)(hash_bytes(&i, sizeof i).lo % 20));
        assert_int_equal(kill(pid, SIGKILL), 0);
        int status;
        assert_int_equal(waitpid(pid, &status, 0), pid);
        assert_true(WIFSIGNALED(status));
        struct disk *d = open_folder("killed", 4 * MB); /* the lock went with it */
        for (uint64_t k = 0; k < NAMES; k++)
            found += got(d, k, 20000 + k);
        assert_int_equal(count(d).damaged, 0); /* renamed when it is whole */
        disk_close(&d);
    }
    assert_true(found > NAMES);
    print_message("%zu files, all whole, after %d kills\n", found, KILLS);
}

static enum err_code disk_thread(void *user, size_t i, struct err *e)
{
    struct disk *d = user;
    (void)e;
    for (uint64_t k = 0; k < 300; k++) {
        uint64_t name = hash_bytes(&(uint64_t){k * 4 + i}, sizeof k).lo % NAMES;
        if (!got(d, name, 30000))
            put(d, name * 1000 + i + 1000000, 30000); /* single flight: nobody else writes it */
        (void)got(d, (hash_bytes(&k, sizeof k).lo % NAMES) * 1000 + (i + 1) % 4 + 1000000, 30000);
    }
    return ERR_OK;
}

static void test_threads(void **state)
{
    struct disk *d = open_folder("threads", 16 * 65536);
    struct err e = {0};
    uint64_t bytes;
    kit_ok(pool_for(4, 4, disk_thread, d, &e), e);
    assert_int_equal(count(d).failed + count(d).damaged, 0);
    assert_int_equal(files(&bytes), count(d).entries);
    assert_int_equal(bytes, count(d).bytes);
    disk_close(&d);
}

/* ---- a server ---- */

static const char *const exts[] = {"glb", "spz", "drc", "ply", "sog"};
enum { EXTS = sizeof exts / sizeof *exts };

/* All forms of a tile; they are on disk when this returns. */
static void ask_all(struct hash128 hash[EXTS], uint64_t written)
{
    char target[128];
    struct reply r;
    for (size_t i = 0; i < EXTS; i++) {
        ask("GET", tile_target(17, exts[i], target), "", &r);
        assert_int_equal(r.status, 200);
        hash[i] = hash_bytes(r.body, r.body_size);
        buf_free(&r.raw);
    }
    struct disk *d = server_services(t.server)->disk;
    /* they are written when the answers are out */
    kit_await(count(d).written + count(d).failed == written);
}

static void test_server(void **state)
{
    struct hash128 first[EXTS], again[EXTS];
    struct err e = {0};
    struct reply r;
    uint64_t bytes;
    kit_ok(file_join(folder, t.dir, "server/cache", &e), e);
    t.cfg.cache_dir = folder;
    start();
    ask_all(first, EXTS);
    assert_int_equal(files(&bytes), EXTS);
    ask("GET", "/metrics", "", &r);
    assert_non_null(strstr(r.head, "\ncitysplat_disk_cache_writes_total 5\n"));
    buf_free(&r.raw);
    kit_ok(server_check(&t.cfg, t.paths, 1, NULL, &e), e); /* beside it */
    server_stop(&t.server);

    start(); /* nothing is made again */
    ask_all(again, 0);
    assert_memory_equal(first, again, sizeof first);
    assert_int_equal(count(server_services(t.server)->disk).hits, EXTS);
    server_stop(&t.server);

    for (unsigned i = 0; i < 256; i++) { /* every file is cut short */
        char path[LONG];
        snprintf(path, sizeof path, "%s/%02x", folder, i);
        DIR *dir = opendir(path);
        for (struct dirent *f; dir && (f = readdir(dir));) {
            char file[LONG + 320];
            snprintf(file, sizeof file, "%s/%s", path, f->d_name);
            if (f->d_name[0] != '.')
                assert_int_equal(truncate(file, 100), 0);
        }
        if (dir)
            closedir(dir);
    }
    start();
    ask_all(again, EXTS); /* made, and written, again */
    assert_memory_equal(first, again, sizeof first);
    assert_int_equal(count(server_services(t.server)->disk).damaged, EXTS);
    server_stop(&t.server);

    kit_rmdir(folder);
    start();
    atomic_store(&write_room, 0); /* a full disk: answers as ever */
    ask_all(again, EXTS);
    atomic_store(&write_room, -1);
    assert_memory_equal(first, again, sizeof first);
    assert_int_equal(count(server_services(t.server)->disk).failed, EXTS);
    assert_int_equal(files(&bytes), 0);
    assert_int_equal(status_of("GET", "/readyz", ""), 200);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip),
        cmocka_unit_test(test_bounded),
        cmocka_unit_test(test_sound_files_are_no_damage),
        cmocka_unit_test(test_scan),
        cmocka_unit_test(test_apart),
        cmocka_unit_test(test_damage),
        cmocka_unit_test(test_full_disk),
        cmocka_unit_test(test_killed),
        cmocka_unit_test(test_threads),
        HTTP_TEST(test_server),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
