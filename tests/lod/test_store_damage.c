/* Files of stores that are damaged, cut off, no stores, or made to do harm: what is wrong with a
 * tile costs that tile.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/lod/small_store.h"

#include <sqlite3.h>
#include <stdio.h>
#include <string.h>

#include "codec/splat/payload.h"
#include "lod/store/store.h"
#include "lod/store/store_db.h"

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

/* Tiles, blobs and values that are gone or others, where all that is left is whole by itself. */
static void a_changed_store_is_not_whole(void **state)
{
    static const struct {
        const char *sql, *why; /* NULL: it is whole */
    } changes[] = {
        {"DELETE FROM tiles WHERE x=34309", "2 tiles, but meta says that there are 3"},
        {"DELETE FROM tiles WHERE z=16; UPDATE meta SET value=1 WHERE key='tiles'",
         "tiles of zooms 15 to 15, but meta says 15 to 16"},
        {"DELETE FROM tiles WHERE x=34309; UPDATE meta SET value=2 WHERE key='tiles'", "revision "},
        {"UPDATE meta SET value=14 WHERE key='zoom_min'", "meta says 14 to 16"},
        {"UPDATE meta SET value='9.25' WHERE key='origin_lon_deg'", "revision "},
        {"UPDATE meta SET value='sea' WHERE key='heights'", "revision "},
        {"UPDATE meta SET value='0123456789ab' WHERE key='revision'", "revision 0123456789ab"},
        {"DELETE FROM blobs WHERE name='empty'", "revision "},
        {"DELETE FROM meta WHERE key='tiles'", NULL}, /* older stores */
    };
    struct store_fixture *f = *state;
    for (size_t i = 0; i < sizeof changes / sizeof *changes; i++) {
        struct err e = {0};
        struct store *s;
        sqlite3 *db = NULL;
        size_t bad;
        make_store(f->path, 1);
        assert_int_equal(sqlite3_open(f->path, &db), SQLITE_OK);
        assert_int_equal(sqlite3_exec(db, changes[i].sql, NULL, NULL, NULL), SQLITE_OK);
        sqlite3_close(db);
        kit_ok(store_open(f->path, &s, &e), e);
        if (changes[i].why)
            kit_fails(store_verify(s, &bad, &e), ERR_FORMAT, e, changes[i].why);
        else
            kit_ok(store_verify(s, &bad, &e), e);
        assert_int_equal(bad, changes[i].why != NULL);
        store_close(&s);
    }
}

int main(void)
{
#define CASE(name)                                                                                 \
    cmocka_unit_test_setup_teardown(name, store_fixture_setup, store_fixture_teardown)
    const struct CMUnitTest tests[] = {
        CASE(a_flipped_payload_byte_costs_one_tile),
        CASE(a_flipped_index_byte_costs_one_tile),
        CASE(any_flipped_byte_is_seen_or_harmless),
        CASE(more_than_the_index_says_is_not_read),
        CASE(a_changed_store_is_not_whole),
        CASE(truncated_files),
        CASE(files_that_are_no_stores),
        CASE(what_is_read_is_bounded_by_the_file),
        CASE(a_level_that_there_is_not_costs_one_tile),
        CASE(gaussians_of_no_size_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
