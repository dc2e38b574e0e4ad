/* The tile store: writing and reading, hashes, damage that affects only its own tile, no
 * half-written files. It is one long file, because every case needs the small store at its head.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/lod/store_kit.h"

#include <math.h>
#include <signal.h>
#include <sqlite3.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "codec/splat/payload.h"
#include "lod/store/store.h"
#include "lod/store/store_db.h"

/* Half floats carry 11 bits; logs and coefficients here are below 8. */
#define BOUNDS_TOLERANCE 0.004 /* 2^-11 of the logarithm of a sigma, at most 8 here */
#define HALF_TOLERANCE (8.0 / 2048)

static void assert_near(double got, double want, double tolerance)
{
    kit_near_d("value", &got, &want, 1, tolerance, 0);
}

static const struct store_meta meta = {.name = "test-city",
                                       .origin = {8.5, 50.1, 120.25},
                                       .sh_degree = 1,
                                       .attribution = "Survey \"A\" & Co",
                                       .heights = "sea-exif"};

static void tile_gauss(uint64_t seed, size_t n, struct gauss *g)
{
    kit_gauss(seed, n, 20, 1, 0, g);
    g->origin_enu_m[0] = 100.0 * (double)seed;
    g->origin_enu_m[1] = -50.0;
}

/* Three tiles: a parent and two of its children. */
static void make_store(const char *path, uint64_t seed)
{
    struct err e = {0};
    struct store *s;
    kit_ok(store_create(path, &meta, &s, &e), e);
    const struct key keys[] = {{16, 34309, 22253}, {15, 17154, 11126}, {16, 34308, 22252}};
    for (size_t i = 0; i < 3; i++) {
        struct gauss g;
        tile_gauss(seed + i, 40 + 10 * i, &g);
        struct store_entry t = {.tile = {.key = keys[i], .level = (uint8_t)(keys[i].z - 13)}};
        const struct store_shape *x = &t.shape;
        kit_ok(store_put(s, &t, &g, &e), e);
        assert_int_equal(t.tile.count, g.n);
        assert_true(t.tile.bytes > 0 && x->sigma_median_m > 0 &&
                    x->sigma_max_m >= x->sigma_median_m);
        assert_near(x->geometric_error_m, 16 * x->sigma_median_m, 1e-12);
        gauss_free(&g);
    }
    kit_ok(store_put_blob(s, "appearance.json", "{\"a\":1}", 7, &e), e);
    kit_ok(store_put_blob(s, "empty", NULL, 0, &e), e);
    kit_ok(store_commit(&s, &e), e);
    assert_null(s);
}

/* The store of make_store(f->path, 1), opened. */
static struct store *small_store(const struct store_fixture *f)
{
    struct err e = {0};
    struct store *s;
    make_store(f->path, 1);
    kit_ok(store_open(f->path, &s, &e), e);
    return s;
}

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

static void alter(const char *path, const char *sql)
{
    sqlite3 *db = NULL;
    char *why = NULL;
    assert_int_equal(sqlite3_open(path, &db), SQLITE_OK);
    if (sqlite3_exec(db, sql, NULL, NULL, &why) != SQLITE_OK)
        fail_msg("%s: %s", sql, why);
    sqlite3_close(db);
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

/* Change one byte where `bytes` first occurs in the file after `from` (at + offset). Returns where
 * that is. */
static size_t flip_after(const char *path, size_t from, const void *bytes, size_t n, size_t offset)
{
    struct err e = {0};
    struct buf b = {0};
    size_t at = from;
    kit_ok(file_read(path, 0, &b, &e), e);
    for (; at + n <= b.size && memcmp(b.data + at, bytes, n); at++)
        ;
    assert_true(at + n <= b.size);
    b.data[at + offset] ^= 0x10;
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
    return at;
}

static void flip(const char *path, const void *bytes, size_t n, size_t offset)
{
    flip_after(path, 0, bytes, n, offset);
}

static void a_flipped_payload_byte_costs_one_tile(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf b = {0};
    size_t bad;
    s = small_store(f);
    kit_ok(store_read(s, (struct key){16, 34309, 22253}, &b, &e), e);
    store_close(&s);
    flip(f->path, b.data, 64, 60);
    kit_ok(store_open(f->path, &s, &e), e);
    kit_fails(store_read(s, (struct key){16, 34309, 22253}, &b, &e), ERR_FORMAT, e,
              "tile 16/34309/22253");
    assert_int_equal(b.size, 0);
    kit_ok(store_read(s, (struct key){16, 34308, 22252}, &b, &e), e);
    kit_ok(store_read(s, (struct key){15, 17154, 11126}, &b, &e), e);
    kit_fails(store_verify(s, &bad, &e), ERR_FORMAT, e, "tile 16/34309/22253");
    assert_int_equal(bad, 1);
    buf_free(&b);
    store_close(&s);
}

static void a_flipped_index_byte_costs_one_tile(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf b = {0};
    size_t n;
    s = small_store(f);
    const struct store_shape x = store_shape(s, store_find(s, (struct key){16, 34309, 22253}));
    store_close(&s);
    buf_f64(&b, x.sigma_median_m); /* SQLite stores doubles big-endian */
    uint8_t big[8];
    for (size_t i = 0; i < 8; i++)
        big[i] = b.data[7 - i];
    /* beside the payload, which is found by verify alone, and where opening reads it */
    const size_t at = flip_after(f->path, 0, big, 8, 5);
    kit_ok(store_open(f->path, &s, &e), e);
    store_tiles(s, &n);
    assert_int_equal(n, 3);
    kit_fails(store_verify(s, &n, &e), ERR_FORMAT, e, "tiles_index");
    store_close(&s);
    flip_after(f->path, at + 8, big, 8, 5);
    kit_ok(store_open(f->path, &s, &e), e);
    store_tiles(s, &n);
    assert_int_equal(n, 2);
    assert_null(store_find(s, (struct key){16, 34309, 22253}));
    kit_ok(store_read(s, (struct key){16, 34308, 22252}, &b, &e), e);
    kit_fails(store_verify(s, &n, &e), ERR_FORMAT, e, "1 index rows");
    buf_free(&b);
    store_close(&s);
}

/* Any byte anywhere: an error or the right data, never a crash and never wrong data. */
static void any_flipped_byte_is_seen_or_harmless(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf good = {0}, b = {0}, payload[3] = {{0}};
    size_t n, refused = 0, tries = 400;
    s = small_store(f);
    const struct store_tile *first = store_tiles(s, &n);
    const struct key keys[] = {first[0].key, first[1].key, first[2].key};
    for (size_t k = 0; k < 3; k++)
        kit_ok(store_read(s, keys[k], &payload[k], &e), e);
    store_close(&s);
    kit_ok(file_read(f->path, 0, &good, &e), e);
    log_set_level(LOG_ERROR);
    for (uint64_t i = 0; i < tries; i++) {
        size_t at = (size_t)(rng_unit(9, 0, i) * (double)good.size);
        uint8_t bit = (uint8_t)(1u << (rng_u64(9, 1, i) % 8));
        good.data[at] ^= bit;
        kit_ok(file_write(f->path, good.data, good.size, &e), e);
        good.data[at] ^= bit;
        size_t fine = 0;
        if (store_open(f->path, &s, &e) == ERR_OK) {
            for (size_t k = 0; k < 3; k++) {
                if (store_read(s, keys[k], &b, &e))
                    continue;
                assert_int_equal(b.size, payload[k].size);
                assert_memory_equal(b.data, payload[k].data, b.size);
                fine++;
            }
            store_close(&s);
        }
        refused += fine < 3;
    }
    log_set_level(LOG_INFO);
    /* Most of this small file is free space and the text of the schema. */
    assert_in_range(refused, tries / 10, tries);
    buf_free(&good);
    buf_free(&b);
    for (size_t k = 0; k < 3; k++)
        buf_free(&payload[k]);
}

/* Other bytes in place of a tile's, with all hashes as they should be: what a hostile author
 * writes. */
static void forge(const char *path, struct key k, const struct gauss *g)
{
    struct err e = {0};
    struct store *s;
    struct buf b = {0};
    uint8_t hash[STORE_HASH_BYTES], row_hash[STORE_HASH_BYTES];
    sqlite3 *db = NULL;
    sqlite3_stmt *q = NULL;
    kit_ok(store_open(path, &s, &e), e);
    const struct store_tile *found = store_find(s, k);
    struct store_entry t = {*found, store_shape(s, found)};
    store_close(&s);
    kit_ok(payload_encode(g, false, &b, &e), e);
    t.tile.hash = hash_bytes(b.data, b.size);
    store_db_hash_out(t.tile.hash, hash);
    store_db_hash_out(store_db_row_hash(&t), row_hash);
    assert_int_equal(sqlite3_open(path, &db), SQLITE_OK);
    assert_int_equal(
        sqlite3_prepare_v2(db, "UPDATE tiles SET payload=?1,hash=?2,row_hash=?3 WHERE id=?4", -1,
                           &q, NULL),
        SQLITE_OK);
    sqlite3_bind_blob64(q, 1, b.data, b.size, SQLITE_STATIC);
    sqlite3_bind_blob(q, 2, hash, sizeof hash, SQLITE_STATIC);
    sqlite3_bind_blob(q, 3, row_hash, sizeof row_hash, SQLITE_STATIC);
    sqlite3_bind_int64(q, 4, store_db_id(k));
    assert_int_equal(sqlite3_step(q), SQLITE_DONE);
    sqlite3_finalize(q);
    sqlite3_close(db);
    buf_free(&b);
}

static void more_than_the_index_says_is_not_read(void **state)
{
    static const struct {
        size_t n;
        uint32_t sh_degree, embed_len;
    } rows[] = {{40, 1, 0}, {41, 1, 0}, {39, 1, 0}, {40, 3, 0}, {40, 1, 8}, {300000, 1, 0}};
    const struct key k = {16, 34309, 22253};
    struct store_fixture *f = *state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct err e = {0};
        struct store *s;
        struct gauss g, got;
        make_store(f->path, 1);
        kit_gauss(9, rows[i].n, 20, rows[i].sh_degree, rows[i].embed_len, &g);
        forge(f->path, k, &g);
        gauss_free(&g);
        kit_ok(store_open(f->path, &s, &e), e);
        assert_int_equal(store_read_gauss(s, k, &got, &e), i ? ERR_FORMAT : ERR_OK);
        kit_expect_text(e.msg, i ? "tile 16/34309/22253: other harmonics" : "", __FILE__, __LINE__);
        assert_int_equal(got.n, i ? 0 : rows[0].n);
        gauss_free(&got);
        store_close(&s);
    }
}

static void truncated_files(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf b = {0};
    make_store(f->path, 1);
    kit_ok(file_read(f->path, 0, &b, &e), e);
    for (size_t n = 0; n < b.size; n += 1777) {
        kit_ok(file_write(f->path, b.data, n, &e), e);
        kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e,
                  n < 100 ? "not a tile store" : "truncated");
        assert_null(s);
    }
    buf_free(&b);
}

static void files_that_are_no_stores(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct buf b = {0};
    char text[200];
    memset(text, 'x', sizeof text);
    kit_fails(store_open(f->path, &s, &e), ERR_NOENT, e, "city.tiles");
    kit_fails(store_open(f->dir, &s, &e), ERR_FORMAT, e, "a folder, not a tile store");
    kit_ok(file_write(f->path, text, sizeof text, &e), e);
    kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "not a tile store");
    make_store(f->path, 1);
    kit_ok(file_read(f->path, 0, &b, &e), e);
    b.data[63] = 3; /* user_version, big-endian at 60 */
    kit_ok(file_write(f->path, b.data, b.size, &e), e);
    kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "schema 3");
    b.data[63] = 2;
    b.data[68] ^= 1; /* application_id: another program's database */
    kit_ok(file_write(f->path, b.data, b.size, &e), e);
    kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "not a tile store");
    buf_free(&b);
    /* Names go into addresses and documents as they are: also a file's own name is checked. */
    make_store(f->path, 1);
    flip(f->path, "nametest-city", 13, 8); /* "test=city" */
    kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "name is 'test=city'");
    s = small_store(f);
    char row[32];
    int n_row = snprintf(row, sizeof row, "revision%s", store_info(s)->revision);
    store_close(&s);
    flip(f->path, row, (size_t)n_row, 8); /* no hex digit stays one */
    kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "revision is");
    struct store_meta bad = meta;
    snprintf(bad.name, sizeof bad.name, "Bad Name");
    kit_fails(store_create(f->path, &bad, &s, &e), ERR_ARG, e, "Bad Name");
    bad = meta;
    bad.origin.lat_deg = 95;
    kit_fails(store_create(f->path, &bad, &s, &e), ERR_ARG, e, "origin");
    char nowhere[FILE_PATH_MAX];
    kit_ok(file_join(nowhere, f->dir, "no/such/folder.tiles", &e), e);
    kit_fails(store_create(nowhere, &meta, &s, &e), ERR_IO, e, "folder.tiles");
}

/* Change a store behind the back of its writer. */
/* Files that are small and would give rows without end, or of any length. */
static void what_is_read_is_bounded_by_the_file(void **state)
{
    static const char *const views[] = {
        "ALTER TABLE tiles RENAME TO kept; CREATE VIEW tiles AS WITH RECURSIVE r(i) AS (SELECT 1 "
        "UNION ALL SELECT i+1 FROM r WHERE i<5000) SELECT r.i AS "
        "id,z,x,y,level,count,bytes,version,"
        "center_e,center_n,center_u,min_e,min_n,min_u,max_e,max_n,max_u,core_min_e,core_min_n,"
        "core_min_u,core_max_e,core_max_n,core_max_u,sigma_median_m,sigma_max_m,geometric_error_m,"
        "hash,row_hash,payload FROM kept,r",
        "ALTER TABLE blobs RENAME TO kept; CREATE VIEW blobs AS SELECT * FROM kept",
        "ALTER TABLE meta RENAME TO kept; CREATE VIEW meta AS SELECT * FROM kept"};
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s = NULL;
    struct buf b = {0};
    log_set_level(LOG_ERROR);
    for (size_t i = 0; i < sizeof views / sizeof *views; i++) {
        make_store(f->path, 1);
        alter(f->path, views[i]);
        kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "not all tables");
    }
    make_store(f->path, 1); /* more rows than any of its own could be */
    alter(f->path,
          "DROP TABLE tiles; CREATE TABLE tiles(id INTEGER PRIMARY KEY,z,x,y,level,count,bytes,"
          "version,center_e,center_n,center_u,min_e,min_n,min_u,max_e,max_n,max_u,core_min_e,"
          "core_min_n,core_min_u,core_max_e,core_max_n,core_max_u,sigma_median_m,sigma_max_m,"
          "geometric_error_m,hash,row_hash,payload); WITH RECURSIVE r(i) AS (SELECT 1 UNION ALL "
          "SELECT i+1 FROM r WHERE i<9000) INSERT INTO tiles(id) SELECT i FROM r; VACUUM");
    kit_fails(store_open(f->path, &s, &e), ERR_FORMAT, e, "more index rows than fit");
    make_store(f->path, 1); /* bytes that are made up while they are read */
    alter(f->path,
          "DROP TABLE blobs; CREATE TABLE blobs(name TEXT PRIMARY KEY, hash BLOB, bytes BLOB "
          "AS (zeroblob(400000000))); INSERT INTO blobs(name) VALUES('huge')");
    kit_ok(store_open(f->path, &s, &e), e);
    kit_fails(store_get_blob(s, "huge", &b, &e), ERR_LIMIT, e, "huge");
    store_close(&s);
    log_set_level(LOG_INFO);
}

/* Levels are indices in what reads them. */
static void a_level_that_there_is_not_costs_one_tile(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    size_t n;
    kit_ok(store_create(f->path, &meta, &s, &e), e);
    for (uint32_t i = 0; i < 2; i++) {
        struct gauss g;
        tile_gauss(i, 40, &g);
        struct store_entry t = {
            .tile = {.key = {16, 34308 + i, 22252},
                     .level = (uint8_t)(i ? STORE_LEVEL_MAX + 1 : STORE_LEVEL_MAX)}};
        kit_ok(store_put(s, &t, &g, &e), e);
        gauss_free(&g);
    }
    kit_ok(store_commit(&s, &e), e);
    kit_ok(store_open(f->path, &s, &e), e);
    assert_int_equal(store_tiles(s, &n)[0].level, STORE_LEVEL_MAX);
    assert_int_equal(n, 1);
    kit_fails(store_verify(s, &n, &e), ERR_FORMAT, e, "1 index rows");
    store_close(&s);
}

static void gaussians_of_no_size_are_refused(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct gauss g;
    struct store_entry t = {.tile = {.key = {15, 17154, 11126}, .level = 1}};
    tile_gauss(1, 20, &g);
    for (size_t i = 0; i < 3 * g.n; i++)
        g.scale_log[i] = -1000; /* finite, and exp makes 0 of it */
    kit_ok(store_create(f->path, &meta, &s, &e), e);
    kit_fails(store_put(s, &t, &g, &e), ERR_DATA, e, "of size 0");
    store_close(&s);
    gauss_free(&g);
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
        CASE(a_flipped_payload_byte_costs_one_tile),
        CASE(a_flipped_index_byte_costs_one_tile),
        CASE(any_flipped_byte_is_seen_or_harmless),
        CASE(more_than_the_index_says_is_not_read),
        CASE(truncated_files),
        CASE(files_that_are_no_stores),
        CASE(what_is_read_is_bounded_by_the_file),
        CASE(a_level_that_there_is_not_costs_one_tile),
        CASE(gaussians_of_no_size_are_refused),
        CASE(names_with_odd_characters),
        cmocka_unit_test(shapes_come_out_as_they_went_in),
        CASE(halves_are_the_whole),
        CASE(odd_rows_are_not_read_in_halves),
        CASE(out_of_memory_everywhere),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
