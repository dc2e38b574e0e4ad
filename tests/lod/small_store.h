/* A store of three tiles, for tests of what a store is on disk.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_SMALL_STORE_H
#define TESTS_SMALL_STORE_H

#include "tests/lod/store_kit.h"

#include <sqlite3.h>

static inline void assert_near(double got, double want, double tolerance)
{
    kit_near_d("value", &got, &want, 1, tolerance, 0);
}

static const struct store_meta meta = {.name = "test-city",
                                       .origin = {8.5, 50.1, 120.25},
                                       .sh_degree = 1,
                                       .attribution = "Survey \"A\" & Co",
                                       .heights = "sea-exif"};

static inline void tile_gauss(uint64_t seed, size_t n, struct gauss *g)
{
    kit_gauss(seed, n, 20, 1, 0, g);
    g->origin_enu_m[0] = 100.0 * (double)seed;
    g->origin_enu_m[1] = -50.0;
}

/* Three tiles: a parent and two of its children. */
static inline void make_store(const char *path, uint64_t seed)
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
static inline struct store *small_store(const struct store_fixture *f)
{
    struct err e = {0};
    struct store *s;
    make_store(f->path, 1);
    kit_ok(store_open(f->path, &s, &e), e);
    return s;
}

/* Runs SQL on the file of a store. */
static inline void alter(const char *path, const char *sql)
{
    sqlite3 *db = NULL;
    char *why = NULL;
    assert_int_equal(sqlite3_open(path, &db), SQLITE_OK);
    if (sqlite3_exec(db, sql, NULL, NULL, &why) != SQLITE_OK)
        fail_msg("%s: %s", sql, why);
    sqlite3_close(db);
}

#endif
