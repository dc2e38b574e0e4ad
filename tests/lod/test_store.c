/* The tile store: writing and reading, hashes, no half-written files, the index in memory. Damaged
 * and hostile files: test_store_damage.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/lod/small_store.h"

#include <math.h>
#include <signal.h>
#include <sqlite3.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>

#include "lod/store/store.h"
#include "lod/store/store_db.h"

/* Half floats carry 11 bits; logs and coefficients here are below 8. */
#define BOUNDS_TOLERANCE 0.004 /* 2^-11 of the logarithm of a sigma, at most 8 here */
#define HALF_TOLERANCE (8.0 / 2048)

static void round_trip(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf b = {0};
    size_t n;
    s = small_store(f);
    const struct store_meta *m = store_info(s);
    assert_string_equal(m->name, "test-city");
    assert_string_equal(m->attribution, meta.attribution);
    assert_string_equal(m->heights, "sea-exif");
    assert_near(m->origin.lat_deg, 50.1, 0);
    assert_int_equal(m->zoom_min, 15);
    assert_int_equal(m->zoom_max, 16);
    assert_int_equal(strlen(m->revision), 12);
    assert_int_equal(strlen(m->created), 20);
    const struct store_tile *t = store_tiles(s, &n);
    assert_int_equal(n, 3);
    for (size_t i = 1; i < n; i++)
        assert_int_equal(key_compare(t[i - 1].key, t[i].key), -1);
    assert_null(store_find(s, (struct key){16, 1, 1}));
    struct gauss want, got;
    tile_gauss(2, 50, &want);
    kit_ok(store_read_gauss(s, (struct key){15, 17154, 11126}, &got, &e), e);
    assert_int_equal(got.n, want.n);
    assert_memory_equal(got.mean_m, want.mean_m, 3 * want.n * sizeof(float));
    assert_near(got.origin_enu_m[0], 200, 0);
    for (size_t i = 0; i < 12 * want.n; i++)
        assert_near((double)got.sh[i], (double)want.sh[i], HALF_TOLERANCE);
    const struct store_shape x = store_shape(s, store_find(s, (struct key){15, 17154, 11126}));
    double lo[3], hi[3];
    gauss_bounds(&want, 3.33, lo, hi);
    for (size_t k = 0; k < 3; k++) { /* wider only by what rounding to half floats may add */
        assert_true(x.min_enu_m[k] <= lo[k] && x.max_enu_m[k] >= hi[k]);
        assert_near(x.min_enu_m[k], lo[k], BOUNDS_TOLERANCE * (hi[k] - lo[k]));
        assert_near(x.max_enu_m[k], hi[k], BOUNDS_TOLERANCE * (hi[k] - lo[k]));
    }
    gauss_free(&want);
    gauss_free(&got);
    kit_ok(store_get_blob(s, "appearance.json", &b, &e), e);
    assert_int_equal(b.size, 7);
    assert_memory_equal(b.data, "{\"a\":1}", 7);
    kit_ok(store_get_blob(s, "empty", &b, &e), e);
    assert_int_equal(b.size, 0);
    kit_fails(store_get_blob(s, "none", &b, &e), ERR_NOENT, e, "blob 'none'");
    kit_fails(store_read(s, (struct key){3, 1, 1}, &b, &e), ERR_NOENT, e, "tile 3/1/1");
    kit_ok(store_verify(s, &n, &e), e);
    assert_int_equal(n, 0);
    struct arena a = {0};
    char **names;
    kit_ok(store_list_blobs(s, &a, &names, &n, &e), e);
    assert_int_equal(n, 2);
    assert_string_equal(names[0], "appearance.json");
    arena_free(&a);
    buf_free(&b);
    store_close(&s);
    store_close(&s);
}

/* A level is replaced by the finer one where pixels are as fine as three quarters of those it was
 * trained on, or before, if its Gaussians are small. Levels of which that is not known go by their
 * Gaussians alone. */
static void errors_are_of_the_levels_pixels(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct store_meta m = meta;
    enum { LEVELS = 4 };
    const struct key keys[LEVELS] = {
        {15, 17154, 11126}, {16, 34308, 22252}, {17, 68616, 44504}, {18, 137232, 89008}};
    double error_m[LEVELS];
    m.pixel_m[0] = 0.1; /* level 1: its sigmas are larger */
    m.pixel_m[1] = 1e5; /* level 2: much smaller */
    kit_ok(store_create(f->path, &m, &s, &e), e);
    for (uint32_t l = 0; l < LEVELS; l++) { /* an overview, 1, 2, and a level without */
        struct gauss g;
        tile_gauss(1 + l, 40, &g);
        struct store_entry t = {.tile = {.key = keys[l], .level = l & 0xff}};
        kit_ok(store_put(s, &t, &g, &e), e);
        error_m[l] = t.shape.geometric_error_m;
        const double of_sigma_m = 16.0 * t.shape.sigma_median_m;
        if (l == 1) {
            assert_near(error_m[l], 16.0 * 0.75 * 0.1, 1e-12);
            assert_true(error_m[l] < 0.9 * of_sigma_m);
        } else {
            assert_near(error_m[l], of_sigma_m, 1e-12);
        }
        gauss_free(&g);
    }
    kit_ok(store_commit(&s, &e), e);
    kit_ok(store_open(f->path, &s, &e), e);
    assert_memory_equal(store_info(s)->pixel_m, m.pixel_m, sizeof m.pixel_m);
    for (size_t l = 0; l < LEVELS; l++)
        assert_near(store_shape(s, store_find(s, keys[l])).geometric_error_m, error_m[l], 0.0);
    store_close(&s);
    alter(f->path, "DELETE FROM meta WHERE key='level_pixel_m'"); /* as stores of before */
    kit_ok(store_open(f->path, &s, &e), e);
    assert_near(store_info(s)->pixel_m[0], 0.0, 0.0);
    store_close(&s);
    static const char *const no_lists[] = {"1 x", "-1", "nan", "1e9", "1 2 3 4 5 6 7 8", "1,2"};
    for (size_t i = 0; i < sizeof no_lists / sizeof *no_lists; i++) {
        char sql[128];
        snprintf(sql, sizeof sql, "INSERT OR REPLACE INTO meta VALUES('level_pixel_m','%s')",
                 no_lists[i]);
        alter(f->path, sql);
        kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "level_pixel_m");
    }
}

static void revision_and_versions_follow_the_content(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    char first[13];
    size_t n;
    s = small_store(f);
    memcpy(first, store_info(s)->revision, sizeof first);
    store_close(&s);
    s = small_store(f); /* the same again */
    assert_string_equal(store_info(s)->revision, first);
    for (size_t i = 0; i < 3; i++)
        assert_int_equal(store_tiles(s, &n)[i].version, 1);
    store_close(&s);
    make_store(f->path, 2); /* other tiles */
    kit_ok(store_open(f->path, &s, &e), e);
    assert_string_not_equal(store_info(s)->revision, first);
    for (size_t i = 0; i < 3; i++)
        assert_int_equal(store_tiles(s, &n)[i].version, 2);
    store_close(&s);
}

static void nothing_is_left_of_an_unfinished_store(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf before = {0}, after = {0}, ls = {0};
    make_store(f->path, 1);
    kit_ok(file_read(f->path, 0, &before, &e), e);
    kit_ok(store_create(f->path, &meta, &s, &e), e);
    store_close(&s);
    kit_ok(store_create(f->path, &meta, &s, &e), e);
    kit_fails(store_commit(&s, &e), ERR_DATA, e, "no tiles");
    assert_null(s);
    kit_ok(file_read(f->path, 0, &after, &e), e);
    assert_int_equal(before.size, after.size);
    assert_memory_equal(before.data, after.data, after.size);
    assert_int_equal(kit_run(&ls, "ls '%s'", f->dir), 0);
    assert_string_equal((const char *)ls.data, "city.tiles\n");
    buf_free(&ls);
    buf_free(&before);
    buf_free(&after);
}

/* A disk that is full after 64 KiB, by the process's own limit on file size. */
static void full_disk(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct rlimit old, small;
    struct gauss g;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
    small = old;
    small.rlim_cur = 65536;
    signal(SIGXFSZ, SIG_IGN);
    kit_gauss(5, 20000, 20, 1, 0, &g);
    kit_ok(store_create(f->path, &meta, &s, &e), e);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
    struct store_entry t = {.tile = {.key = {15, 17154, 11126}, .level = 1}};
    enum err_code rc = store_put(s, &t, &g, &e);
    if (!rc)
        rc = store_commit(&s, &e);
    setrlimit(RLIMIT_FSIZE, &old);
    store_close(&s);
    gauss_free(&g);
    assert_int_equal(rc, ERR_IO);
    kit_expect_text(e.msg, "city.tiles", __FILE__, __LINE__);
    struct buf ls = {0};
    assert_int_equal(kit_run(&ls, "ls '%s'", f->dir), 0);
    assert_int_equal(ls.size, 0);
    buf_free(&ls);
}

static void names_with_odd_characters(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, f->dir, "a b?c#d%41&\xc3\xbc.tiles", &e), e);
    make_store(path, 1);
    kit_ok(store_open(path, &s, &e), e);
    store_close(&s);
    kit_ok(store_open(path, &s, &e), e);
    struct store_entry t = {.tile = {.key = {1, 0, 0}}};
    const struct gauss none = {.n = 1};
    kit_fails(store_put(s, &t, &none, &e), ERR_INTERNAL, e, "never changed");
    store_close(&s);
}

/* A shape as the tiler makes it; odd: one value is as no tiler would make it. */
static struct store_shape shape_of(size_t i, size_t odd)
{
    struct store_shape x;
    for (size_t k = 0; k < 3; k++) {
        x.center_enu_m[k] = round(1e4 * rng_normal(1, k, i));
        x.core_min_enu_m[k] = x.center_enu_m[k] + (double)(float)(-20 * rng_unit(2, k, i));
        x.core_max_enu_m[k] = x.center_enu_m[k] + (double)(float)(20 * rng_unit(3, k, i));
        x.min_enu_m[k] = x.core_min_enu_m[k] - rng_unit(4, k, i);
        x.max_enu_m[k] = x.core_max_enu_m[k] + rng_unit(5, k, i);
    }
    x.sigma_median_m = exp((double)(float)rng_normal(6, 0, i));
    x.sigma_max_m = x.sigma_median_m * (1 + rng_unit(7, 0, i));
    x.geometric_error_m = 16 * x.sigma_median_m;
    double *const where[] = {&x.center_enu_m[1], &x.core_min_enu_m[0], &x.core_max_enu_m[2],
                             &x.sigma_median_m, &x.geometric_error_m};
    const double what[] = {0.25, -0.0, 1e300, (double)INFINITY, -1};
    if (odd)
        *where[odd % 5] = what[odd / 5 % 5];
    return x;
}

/* Packed or whole, every bit comes back, and goes with its tile when they are sorted: by counting
 * (a row of `far` 0), or by comparing where rows are far apart. */
static void shapes_come_out(uint32_t far)
{
    struct err e = {0};
    struct index x = {0};
    enum { N = 500 };
    for (uint32_t i = 0; i < N; i++) {
        const struct key key = {(uint8_t)(23 + i % 2), i * 7 % N, i % 11 ? i % 11 : far};
        struct store_entry t = {.tile = {.key = key, .count = i},
                                .shape = shape_of(i, i % 4 ? 0 : i / 4)};
        kit_ok(index_add(&x, &t, 0, &e), e);
    }
    /* Most are packed, and only what cannot be is kept whole. */
    assert_in_range(x.n_whole, N / 6, N / 4);
    kit_ok(index_sort(&x, &e), e);
    for (size_t i = 0; i < N; i++) {
        const uint32_t was = x.tiles[i].count;
        const struct store_shape want = shape_of(was, was % 4 ? 0 : was / 4),
                                 got = index_shape(&x, i), box = index_bounds(&x, i);
        assert_true(i == 0 || key_compare(x.tiles[i - 1].key, x.tiles[i].key) < 0);
        assert_memory_equal(&got, &want, sizeof want);
        assert_memory_equal(box.min_enu_m, want.min_enu_m, sizeof want.min_enu_m);
        assert_memory_equal(box.core_max_enu_m, want.core_max_enu_m, sizeof want.core_max_enu_m);
        assert_true(box.sigma_max_m == want.sigma_max_m);
        const double sigma_m = index_sigma_median_m(&x, i);
        assert_memory_equal(&sigma_m, &want.sigma_median_m, sizeof sigma_m);
        assert_int_equal(index_find(&x, x.tiles[i].key), i);
    }
    assert_int_equal(index_find(&x, (struct key){23, N, 0}), INDEX_NONE);
    index_free(&x);
}

static void shapes_come_out_as_they_went_in(void **state)
{
    shapes_come_out(0);
    shapes_come_out((UINT32_C(1) << 23) - 1);
}

enum { HALVES_SIDE = 16 };

/* The index of a file in two halves; false: it is to be read as a whole. */
static bool read_halves(const char *path, const struct store *whole, struct index *out)
{
    struct err e = {0};
    struct store s = {.path = whole->path, .size_bytes = whole->size_bytes, .meta = whole->meta};
    kit_ok(store_db_connect(&s, path, NULL, &e), e);
    const bool done = store_read_halves(&s, path, NULL);
    sqlite3_close(s.db);
    *out = s.index;
    return done;
}

static void make_square(const char *path)
{
    struct err e = {0};
    struct store *s;
    struct gauss g;
    struct store_meta of_levels = meta;
    of_levels.pixel_m[0] = 1e-3; /* finer than the Gaussians, which limits errors */
    tile_gauss(1, 20, &g);
    kit_ok(store_create(path, &of_levels, &s, &e), e);
    for (uint32_t at = 0; at < HALVES_SIDE * HALVES_SIDE; at++)
        for (uint32_t up = 0; up < 2; up++) {
            const struct key key = {(uint8_t)(16 - up), 17000 + at % HALVES_SIDE,
                                    11000 + at / HALVES_SIDE};
            struct store_entry t = {.tile = {.key = key, .level = 1}};
            kit_ok(store_put(s, &t, &g, &e), e);
        }
    kit_ok(store_commit(&s, &e), e);
    gauss_free(&g);
}

/* Two threads read what one reads. */
static void halves_are_the_whole(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct index x;
    make_square(f->path);
    kit_ok(store_open(f->path, &s, &e), e);
    assert_int_equal(s->index.n_whole, 0);
    assert_near(index_shape(&s->index, 0).geometric_error_m, 16 * 0.75 * 1e-3, 1e-15);
    assert_true(read_halves(f->path, s, &x));
    kit_ok(index_sort(&x, &e), e);
    assert_int_equal(x.n, 2 * HALVES_SIDE * HALVES_SIDE);
    assert_int_equal(x.n, s->index.n);
    assert_memory_equal(x.tiles, s->index.tiles, x.n * sizeof *x.tiles);
    assert_memory_equal(x.shapes, s->index.shapes, x.n * sizeof *x.shapes);
    index_free(&x);
    store_close(&s);
}

/* What is odd is left to one thread, which says what it is. */
static void odd_rows_are_not_read_in_halves(void **state)
{
    static const char *const odd[] = {
        "UPDATE meta SET value=value-1 WHERE key='tiles'",
        "UPDATE meta SET value=value+1 WHERE key='tiles'",
        "UPDATE tiles SET count=count+1 WHERE id=(SELECT max(id) FROM tiles)",
        "DROP INDEX tiles_index"};
    struct store_fixture *f = *state;
    log_set_level(LOG_ERROR);
    for (size_t i = 0; i < sizeof odd / sizeof *odd; i++) {
        struct err e = {0};
        struct store *s;
        struct index x;
        make_square(f->path);
        alter(f->path, odd[i]);
        kit_ok(store_open(f->path, &s, &e), e);
        assert_false(read_halves(f->path, s, &x));
        assert_null(x.tiles);
        assert_int_equal(s->index.n, 2 * HALVES_SIDE * HALVES_SIDE - (i == 2));
        store_close(&s);
    }
    log_set_level(LOG_INFO);
}

/* Fail the k-th allocation of writing and reading, for every k: ERR_MEM, nothing leaked
 * (LeakSanitizer sees). */
static void out_of_memory_everywhere(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    tile_gauss(1, 20, &g);
    bool done = false;
    for (size_t k = 1; !done && k < 500; k++) {
        struct store *s = NULL;
        struct gauss back = {0};
        struct store_entry t = {.tile = {.key = {15, 17154, 11126}, .level = 1}};
        mem_fail_at(k);
        enum err_code rc = store_create(f->path, &meta, &s, &e);
        if (!rc)
            rc = store_put(s, &t, &g, &e);
        if (!rc)
            rc = store_commit(&s, &e);
        if (!rc)
            rc = store_open(f->path, &s, &e);
        if (!rc)
            rc = store_read_gauss(s, t.tile.key, &back, &e);
        mem_fail_at(0);
        store_close(&s);
        gauss_free(&back);
        done = !rc;
        if (rc && rc != ERR_MEM)
            fail_msg("allocation %zu: %s (%s)", k, kit_err(rc), e.msg);
    }
    assert_true(done);
    gauss_free(&g);
}

int main(void)
{
#define CASE(name)                                                                                 \
    cmocka_unit_test_setup_teardown(name, store_fixture_setup, store_fixture_teardown)
    const struct CMUnitTest tests[] = {
        CASE(round_trip),
        CASE(errors_are_of_the_levels_pixels),
        CASE(revision_and_versions_follow_the_content),
        CASE(nothing_is_left_of_an_unfinished_store),
        CASE(full_disk),
        CASE(names_with_odd_characters),
        cmocka_unit_test(shapes_come_out_as_they_went_in),
        CASE(halves_are_the_whole),
        CASE(odd_rows_are_not_read_in_halves),
        CASE(out_of_memory_everywhere),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
