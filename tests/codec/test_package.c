/* 3TZ archives: what a reader of the index finds, what a reader of zips finds, and failures of
 * writing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/archive.h"
#include "codec/container/package.h"
#include "tests/kit.h"

#include <nettle/md5.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

enum { FILES = 70 };
static struct fixture {
    char dir[FILE_PATH_MAX], out[FILE_PATH_MAX];
    char *names[FILES];
    struct arena arena;
} f;

/* Of i bytes; the first is empty. */
static void content(size_t i, struct buf *b)
{
    for (size_t k = 0; k < i * i; k++)
        buf_u8(b, (unsigned)(i * 7 + k) & 255);
}

static int setup(void **state)
{
    struct err e = {0};
    kit_tmpdir(f.dir);
    kit_ok(file_join(f.out, f.dir, "city.3tz", &e), e);
    for (size_t i = 0; i < FILES; i++) {
        char path[FILE_PATH_MAX], folder[FILE_PATH_MAX];
        struct buf b = {0};
        f.names[i] = arena_get(&f.arena, 40, 1);
        snprintf(f.names[i], 40, i ? "t/17/%zu/%zu.glb" : "tileset.json", i % 3, i);
        snprintf(folder, sizeof folder, "%.4000s/t/17/%zu", f.dir, i % 3);
        kit_ok(file_mkdir(folder, &e), e);
        kit_ok(file_join(path, f.dir, f.names[i], &e), e);
        content(i, &b);
        kit_ok(file_write(path, b.data, b.size, &e), e);
        buf_free(&b);
    }
    return 0;
}

static int teardown(void **state)
{
    arena_free(&f.arena);
    kit_rmdir(f.dir);
    return 0;
}

static uint64_t le(const uint8_t *p, int n)
{
    uint64_t v = 0;
    for (int i = n; i-- > 0;)
        v = v << 8 | p[i];
    return v;
}

/* As readers of 3TZ do: by halves in the index, then the local header. */
static const uint8_t *find(const uint8_t *zip, const uint8_t *index, size_t n, const char *name,
                           size_t *size)
{
    uint8_t digest[16];
    struct md5_ctx md5;
    md5_init(&md5);
    md5_update(&md5, strlen(name), (const uint8_t *)name);
    md5_digest(&md5, sizeof digest, digest);
    const uint64_t want[2] = {le(digest, 8), le(digest + 8, 8)};
    size_t lo = 0, hi = n;
    while (lo < hi) {
        const size_t mid = (lo + hi) / 2;
        const uint64_t at[2] = {le(index + 24 * mid, 8), le(index + 24 * mid + 8, 8)};
        if (at[0] < want[0] || (at[0] == want[0] && at[1] < want[1]))
            lo = mid + 1;
        else
            hi = mid;
    }
    if (lo == n || memcmp(index + 24 * lo, digest, 16) != 0)
        return NULL;
    const uint8_t *head = zip + le(index + 24 * lo + 16, 8);
    assert_memory_equal(head, "PK\3\4", 4);
    assert_int_equal(le(head + 8, 2), 0); /* stored */
    assert_int_equal(le(head + 26, 2), strlen(name));
    assert_memory_equal(head + 30, name, strlen(name));
    *size = le(head + 22, 4);
    return head + 30 + le(head + 26, 2) + le(head + 28, 2);
}

static void test_index(void **state)
{
    struct err e = {0};
    struct buf zip = {0}, again = {0}, index = {0};
    struct archive_reader *r = NULL;
    kit_ok(package_write(f.dir, f.names, FILES, f.out, &e), e);
    kit_ok(file_read(f.out, 0, &zip, &e), e);
    kit_ok(archive_open(zip.data, zip.size, &r, &e), e);
    kit_ok(archive_get(r, PACKAGE_INDEX, 1 << 20, &index, &e), e); /* its CRC is checked by this */
    assert_int_equal(index.size, 24 * FILES);
    for (size_t i = 0; i < FILES; i++) {
        struct buf want = {0}, got = {0};
        size_t size = 0;
        content(i, &want);
        kit_ok(archive_get(r, f.names[i], 1 << 20, &got, &e), e);
        const uint8_t *found = find(zip.data, index.data, FILES, f.names[i], &size);
        assert_non_null(found);
        assert_true(size == want.size && got.size == want.size);
        if (size) {
            assert_memory_equal(found, want.data, size);
            assert_memory_equal(got.data, want.data, size);
        }
        buf_free(&want);
        buf_free(&got);
    }
    size_t size;
    assert_null(find(zip.data, index.data, FILES, "t/17/0/1.glb", &size));
    /* the last entry is the index: nothing but the directory follows it */
    const uint8_t *end = zip.data + zip.size - 22;
    assert_memory_equal(end, "PK\5\6", 4);
    assert_true(!memcmp(zip.data + le(end + 16, 4) - index.size, index.data, index.size));
    /* the same files are the same bytes, over an older archive */
    kit_ok(package_write(f.dir, f.names, FILES, f.out, &e), e);
    kit_ok(file_read(f.out, 0, &again, &e), e);
    assert_int_equal(again.size, zip.size);
    assert_memory_equal(again.data, zip.data, zip.size);
    archive_close(&r);
    buf_free(&zip);
    buf_free(&again);
    buf_free(&index);
}

static size_t files_here(void)
{
    struct err e = {0};
    struct arena a = {0};
    char **names;
    size_t n;
    kit_ok(file_list(f.dir, NULL, &a, &names, &n, &e), e);
    arena_free(&a);
    return n;
}

/* What fails leaves what was there, and nothing beside it. */
static void test_failures(void **state)
{
    struct err e = {0};
    struct buf before = {0}, after = {0};
    char *names[3] = {f.names[0], f.names[1], f.names[2]}, missing[] = "t/17/0/absent.glb";
    kit_ok(package_write(f.dir, names, 2, f.out, &e), e);
    kit_ok(file_read(f.out, 0, &before, &e), e);
    const size_t n = files_here();
    names[1] = missing;
    kit_fails(package_write(f.dir, names, 3, f.out, &e), ERR_NOENT, e, "absent.glb");
    names[1] = names[0];
    enum err_code rc = package_write(f.dir, names, 3, f.out, &e); /* one name twice */
    assert_true(rc == ERR_MEM || rc == ERR_INTERNAL);
    kit_fails(package_write(f.dir, f.names, 2, "/nowhere/city.3tz", &e), ERR_IO, e, "/nowhere");
    struct rlimit old, full;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
    full = old;
    full.rlim_cur = 4096; /* as a full disk */
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &full), 0);
    signal(SIGXFSZ, SIG_IGN);
    rc = package_write(f.dir, f.names, FILES, f.out, &e);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &old), 0);
    assert_int_equal(rc, ERR_IO);
    kit_ok(file_read(f.out, 0, &after, &e), e);
    assert_true(after.size == before.size && !memcmp(after.data, before.data, before.size));
    assert_int_equal(files_here(), n);
    buf_free(&before);
    buf_free(&after);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_index),
                                       cmocka_unit_test(test_failures)};
    return cmocka_run_group_tests(tests, setup, teardown);
}
