/* PMTiles as a reader sees them that knows only the specification: ids, directories with one and
 * two steps, deduplication, order, and failures of writing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/pmtiles.h"
#include "tests/kit.h"

#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <zlib.h>

static char path[FILE_PATH_MAX];

int __real_close(int fd); // NOLINT: the linker's names
int __wrap_close(int fd); // NOLINT

static bool close_fails; /* the next one, as of a disk that is away */
static int closed_twice;

int __wrap_close(int fd) // NOLINT
{
    const bool fails = close_fails;
    close_fails = false;
    if (__real_close(fd) && errno == EBADF)
        closed_twice++;
    if (fails)
        errno = EIO;
    return fails ? -1 : 0;
}

static int setup(void **state)
{
    struct err e = {0};
    kit_tmp_make(state);
    kit_ok(file_join(path, kit_tmp, "map.pmtiles", &e), e);
    return 0;
}

/* ---- a reader ---- */

static uint64_t number(const uint8_t *p, int bytes)
{
    uint64_t v = 0;
    for (int i = 0; i < bytes; i++)
        v |= (uint64_t)p[i] << 8 * i;
    return v;
}

static uint64_t varint(const uint8_t **p)
{
    uint64_t v = 0;
    int shift = 0;
    do
        v |= (uint64_t)(**p & 127) << shift, shift += 7;
    while (*(*p)++ & 128);
    return v;
}

static void unpack(const uint8_t *bytes, size_t n, struct buf *out)
{
    z_stream z = {.next_in = (uint8_t *)(uintptr_t)bytes, .avail_in = (unsigned)n};
    const size_t room = 8 << 20;
    assert_int_equal(inflateInit2(&z, 31), Z_OK);
    z.next_out = buf_grow(out, room);
    z.avail_out = (unsigned)room;
    assert_int_equal(inflate(&z, Z_FINISH), Z_STREAM_END);
    out->size = z.total_out;
    inflateEnd(&z);
}

struct found {
    uint64_t id, run, length, offset;
};

static size_t directory(const uint8_t *bytes, size_t n, struct found **out)
{
    struct buf b = {0};
    unpack(bytes, n, &b);
    const uint8_t *p = b.data;
    const size_t count = (size_t)varint(&p);
    struct found *d = mem_array(count + 1, sizeof *d);
    for (size_t i = 0; i < count; i++)
        d[i].id = varint(&p) + (i ? d[i - 1].id : 0);
    for (size_t i = 0; i < count; i++)
        d[i].run = varint(&p);
    for (size_t i = 0; i < count; i++)
        d[i].length = varint(&p);
    for (size_t i = 0; i < count; i++) {
        const uint64_t v = varint(&p);
        d[i].offset = v ? v - 1 : d[i - 1].offset + d[i - 1].length;
    }
    assert_ptr_equal(p, b.data + b.size);
    buf_free(&b);
    *out = d;
    return count;
}

/* The last entry at or before id; NULL: none. */
static const struct found *before(const struct found *d, size_t n, uint64_t id)
{
    const struct found *at = NULL;
    for (size_t lo = 0, hi = n; lo < hi;) {
        const size_t mid = lo + (hi - lo) / 2;
        if (d[mid].id <= id)
            at = &d[mid], lo = mid + 1;
        else
            hi = mid;
    }
    return at;
}

/* A tile's bytes, as the specification finds them; NULL: there is none. */
static const uint8_t *tile(const struct buf *file, uint64_t id, size_t *n)
{
    uint64_t at = number(file->data + 8, 8), size = number(file->data + 16, 8);
    for (int depth = 0; depth < 4; depth++) {
        struct found *d;
        const size_t count = directory(file->data + at, (size_t)size, &d);
        const struct found *hit = before(d, count, id);
        const struct found is = hit ? *hit : (struct found){0};
        mem_free(d);
        if (!hit || (is.run && id >= is.id + is.run))
            return NULL;
        if (is.run) {
            *n = (size_t)is.length;
            return file->data + number(file->data + 56, 8) + is.offset;
        }
        at = number(file->data + 40, 8) + is.offset;
        size = is.length;
    }
    fail_msg("directories without an end");
    return NULL;
}

/* ---- ids ---- */

static void test_ids_are_those_of_the_specification(void **state)
{
    static const struct {
        uint8_t z;
        uint32_t x, y;
        uint64_t id;
    } row[] = {{0, 0, 0, 0},
               {1, 0, 0, 1},
               {1, 0, 1, 2},
               {1, 1, 1, 3},
               {1, 1, 0, 4},
               {2, 0, 0, 5},
               {12, 3423, 1763, 19078479}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        assert_int_equal(pmtiles_id(row[i].z, row[i].x, row[i].y), row[i].id);
    /* each place once, and each step along the curve is one tile wide */
    enum { Z = 6, SIDE = 1 << Z };
    static uint32_t place[SIDE * SIDE][2];
    static bool seen[SIDE * SIDE];
    const uint64_t first = pmtiles_id(Z, 0, 0);
    for (uint32_t x = 0; x < SIDE; x++)
        for (uint32_t y = 0; y < SIDE; y++) {
            const uint64_t at = pmtiles_id(Z, x, y) - first;
            assert_true(at < SIDE * SIDE && !seen[at]);
            seen[at] = true;
            place[at][0] = x;
            place[at][1] = y;
        }
    for (size_t i = 1; i < SIDE * SIDE; i++) {
        const int dx = (int)place[i][0] - (int)place[i - 1][0],
                  dy = (int)place[i][1] - (int)place[i - 1][1];
        assert_int_equal(dx * dx + dy * dy, 1);
    }
}

/* ---- files ---- */

/* What lies at an id: one of 8 contents in a quarter of them, often several in a row; its own in
 * the others; nothing at every seventh. */
static size_t content(uint64_t id, char out[64])
{
    if (id % 7 == 3)
        return 0;
    if (id / 16 % 4 == 0)
        return (size_t)snprintf(out, 64, "sea %u", (unsigned)(id / 64 % 8));
    return (size_t)snprintf(out, 64, "tile %llu of its own %.*s", (unsigned long long)id,
                            (int)(id % 23), "#######################");
}

static void write_file(uint64_t ids, struct buf *file)
{
    struct err e = {0};
    struct pmtiles *p;
    uint64_t tiles, contents, bytes, wrote = 0;
    char text[64];
    const struct pmtiles_about about = {.type = PMTILES_WEBP,
                                        .zoom_min = 2,
                                        .zoom_max = 9,
                                        .zoom_center = 5,
                                        .bbox_deg = {-10.5, -20, 30, 40.25},
                                        .metadata = "{\"name\":\"m\"}"};
    kit_ok(pmtiles_begin(path, &p, &e), e);
    for (uint64_t id = 5; id < 5 + ids; id++) {
        const size_t n = content(id, text);
        if (n)
            kit_ok(pmtiles_add(p, id, text, n, &e), e);
        wrote += n > 0;
    }
    pmtiles_count(p, &tiles, &contents, &bytes);
    assert_int_equal(tiles, wrote);
    assert_true(ids < 1000 || contents < tiles);
    assert_false(file_exists(path)); /* beside, until it is whole */
    kit_ok(pmtiles_commit(&p, &about, &e), e);
    assert_null(p);
    kit_ok(file_read(path, 0, file, &e), e);
    assert_int_equal(number(file->data + 64, 8), bytes);
    assert_int_equal(number(file->data + 72, 8), tiles);
    assert_int_equal(number(file->data + 88, 8), contents);
    remove(path);
}

static void check_head(const struct buf *file)
{
    const uint8_t *h = file->data;
    struct buf metadata = {0};
    assert_memory_equal(h, "PMTiles\3", 8);
    assert_int_equal(number(h + 8, 8), 127);
    assert_true(127 + number(h + 16, 8) <= 16384);
    assert_int_equal(file->size, 16384 + number(h + 64, 8) + number(h + 32, 8) + number(h + 48, 8));
    static const uint8_t kinds[] = {1, 2, 1, PMTILES_WEBP, 2, 9};
    assert_memory_equal(h + 96, kinds, sizeof kinds);
    assert_int_equal((int32_t)number(h + 102, 4), -105000000);
    assert_int_equal((int32_t)number(h + 106, 4), -200000000);
    assert_int_equal((int32_t)number(h + 110, 4), 300000000);
    assert_int_equal((int32_t)number(h + 114, 4), 402500000);
    assert_int_equal(h[118], 5);
    assert_int_equal((int32_t)number(h + 119, 4), 97500000);
    unpack(h + number(h + 24, 8), (size_t)number(h + 32, 8), &metadata);
    assert_int_equal(metadata.size, 12);
    assert_memory_equal(metadata.data, "{\"name\":\"m\"}", 12);
    buf_free(&metadata);
}

/* Entries in order of ids, and contents where they are needed first. */
static size_t check_order(const struct buf *file)
{
    const uint8_t *h = file->data;
    struct found *root, *leaf;
    size_t all = 0, n_leaf;
    uint64_t id = 0, end = 0;
    const size_t n = directory(h + 127, (size_t)number(h + 16, 8), &root);
    for (size_t i = 0; i < n; i++) {
        const bool leaves = !root[i].run;
        if (leaves)
            n_leaf =
                directory(h + number(h + 40, 8) + root[i].offset, (size_t)root[i].length, &leaf);
        else
            n_leaf = 1, leaf = NULL;
        for (size_t k = 0; k < n_leaf; k++, all++) {
            const struct found *f = leaves ? &leaf[k] : &root[i];
            assert_true(f->run && f->id >= id);
            assert_true(f->offset <= end);
            end = f->offset == end ? end + f->length : end;
            id = f->id + f->run;
        }
        mem_free(leaf);
    }
    assert_int_equal(end, number(h + 64, 8));
    assert_int_equal(all, number(h + 80, 8));
    mem_free(root);
    return n;
}

static void check_tiles(const struct buf *file, uint64_t ids, uint64_t step)
{
    char text[64];
    size_t n;
    for (uint64_t id = 0; id < 10 + ids; id += step) {
        const size_t want = id >= 5 && id < 5 + ids ? content(id, text) : 0;
        const uint8_t *got = tile(file, id, &n);
        assert_int_equal(got != NULL, want > 0);
        if (!got)
            continue;
        assert_int_equal(n, want);
        assert_memory_equal(got, text, want);
    }
}

static void test_every_tile_is_found_and_the_bytes_come_again(void **state)
{
    static const uint64_t sizes[] = {0, 1, 300, 6000, 120000};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        struct buf file = {0}, again = {0};
        write_file(sizes[i], &file);
        check_head(&file);
        const size_t in_root = check_order(&file);
        if (sizes[i] == 120000)
            assert_true(in_root < 64 && number(file.data + 48, 8)); /* leaves */
        check_tiles(&file, sizes[i], sizes[i] > 1000 ? sizes[i] / 97 : 1);
        write_file(sizes[i], &again);
        assert_int_equal(again.size, file.size);
        assert_memory_equal(again.data, file.data, file.size);
        buf_free(&file);
        buf_free(&again);
    }
}

static void test_tiles_come_in_order_and_have_bytes(void **state)
{
    struct err e = {0};
    struct pmtiles *p;
    kit_ok(pmtiles_begin(path, &p, &e), e);
    kit_fails(pmtiles_add(p, 7, "", 0, &e), ERR_ARG, e, "tile 7");
    kit_ok(pmtiles_add(p, 7, "a", 1, &e), e);
    kit_fails(pmtiles_add(p, 7, "b", 1, &e), ERR_ARG, e, "tile 7");
    kit_fails(pmtiles_add(p, 6, "b", 1, &e), ERR_ARG, e, "tile 6");
    pmtiles_abort(&p);
    assert_null(p);
}

/* No file may be longer than `most`: writing two tiles, or the end, fails. */
static void fail_beyond(size_t most, bool at_end)
{
    static uint8_t big[300000];
    const struct pmtiles_about about = {.type = PMTILES_PNG, .metadata = "{}"};
    struct err e = {0};
    struct rlimit was, small;
    struct pmtiles *p;
    signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &was);
    small = was;
    small.rlim_cur = most;
    setrlimit(RLIMIT_FSIZE, &small);
    kit_ok(pmtiles_begin(path, &p, &e), e);
    kit_ok(pmtiles_add(p, 1, "ab", 2, &e), e);
    if (at_end)
        kit_fails(pmtiles_commit(&p, &about, &e), ERR_IO, e, "map.pmtiles");
    else
        kit_fails(pmtiles_add(p, 2, big, sizeof big, &e), ERR_IO, e, "map.pmtiles");
    pmtiles_abort(&p);
    setrlimit(RLIMIT_FSIZE, &was);
}

static void test_what_fails_leaves_nothing(void **state)
{
    const struct pmtiles_about about = {.type = PMTILES_PNG, .metadata = "{}"};
    struct err e = {0};
    struct pmtiles *p;
    struct arena a = {0};
    char **names;
    size_t n;
    fail_beyond(100000, false);
    fail_beyond(16384 + 2, true);
    kit_ok(pmtiles_begin(path, &p, &e), e);
    close_fails = true;
    kit_fails(pmtiles_commit(&p, &about, &e), ERR_IO, e, "map.pmtiles");
    assert_null(p);
    assert_int_equal(closed_twice, 0); /* another thread may have the number by then */
    kit_fails(pmtiles_begin("/nonexistent/a.pmtiles", &p, &e), ERR_IO, e, "/nonexistent");
    assert_null(p);
    kit_ok(file_list(kit_tmp, NULL, &a, &names, &n, &e), e);
    assert_int_equal(n, 0);
    arena_free(&a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ids_are_those_of_the_specification),
        cmocka_unit_test(test_every_tile_is_found_and_the_bytes_come_again),
        cmocka_unit_test(test_tiles_come_in_order_and_have_bytes),
        cmocka_unit_test(test_what_fails_leaves_nothing),
    };
    return cmocka_run_group_tests(tests, setup, kit_tmp_remove);
}
