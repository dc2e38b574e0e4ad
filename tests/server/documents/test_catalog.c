/* Stores that are replaced while they are served.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/routed.h"

#include <math.h>
#include <stdio.h>
#include <sys/stat.h>

#include "codec/container/seen.h"
#include "lod/export/clip.h"

static void test_reload(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct catalog *first = NULL, *second = NULL, *third = NULL;
    (void)state;
    kit_ok(file_join(path, t.dir, "moving.tiles", &e), e);
    const char *paths[] = {path};
    served_city(path, "moving", 10);
    kit_ok(catalog_open(paths, 1, &served_stores, NULL, &first, &e), e);
    kit_ok(catalog_open(paths, 1, &served_stores, first, &second, &e), e);
    assert_int_equal(second->n, 1);
    assert_ptr_equal(second->ds[0], first->ds[0]); /* unchanged: the same one */
    served_city(path, "moving", 11);
    kit_ok(catalog_open(paths, 1, &served_stores, second, &third, &e), e);
    assert_int_equal(third->n, 2);
    struct dataset *now = catalog_find(third, "moving", ""), *old = first->ds[0];
    assert_string_not_equal(now->meta.revision, old->meta.revision);
    assert_ptr_equal(catalog_find(third, "moving", old->meta.revision), old);
    struct buf b = {
        0}; /* the older revision's tiles are read from the file that was renamed over */
    struct store *s = dataset_borrow(old);
    const struct form form = {FORMAT_SPZ, QUANT_BALANCED, 3, 0, false};
    kit_ok(encode_tile(s, served_key(17), form, NULL, NULL, &b, &e), e);
    dataset_return(old, s);
    buf_free(&b);
    struct catalog *bad = NULL;
    kit_ok(file_write(path, "not a store", 11, &e), e);
    kit_fails(catalog_open(paths, 1, &served_stores, third, &bad, &e), ERR_FORMAT, e,
              "moving.tiles");
    assert_null(bad);
    struct catalog *later = NULL; /* a day has passed for the older one */
    kit_ok(catalog_expire(third, &served_stores, clock_s() + 86390, &later, &e), e);
    assert_null(later);
    kit_ok(catalog_expire(third, &served_stores, clock_s() + 86410, &later, &e), e);
    assert_int_equal(later->n, 1);
    assert_ptr_equal(catalog_find(later, "moving", ""), now);
    assert_null(catalog_find(later, "moving", old->meta.revision));
    catalog_drop(&later);
    catalog_drop(&third);
    catalog_drop(&second);
    catalog_drop(&first);
    const char *twice[] = {t.path, t.path};
    kit_fails(catalog_open(twice, 2, &served_stores, NULL, &bad, &e), ERR_ARG, e, "toy");
}

/* Bytes that this process has read so far; 0: the kernel does not count them. */
static uint64_t bytes_read(void)
{
    unsigned long long n = 0;
    FILE *f = fopen("/proc/self/io", "r");
    if (f && fscanf(f, "rchar: %llu", &n) != 1)
        n = 0;
    if (f)
        fclose(f);
    return n;
}

/* A start takes no longer for tiles being large: none is read. A store of the same tiles with two
 * hundred times as much in them takes the same few pages. */
static void test_a_start_reads_no_tiles(void **state)
{
    static const size_t gaussians[] = {100, 20000};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    uint64_t took[2];
    (void)state;
    if (!bytes_read())
        skip();
    for (int i = 0; i < 2; i++) {
        struct catalog *c = NULL;
        struct stat st;
        const char *paths[] = {path};
        kit_ok(file_join(path, t.dir, i ? "large.tiles" : "small.tiles", &e), e);
        served_city(path, "start", gaussians[i]);
        uint64_t before = bytes_read();
        kit_ok(catalog_open(paths, 1, &served_stores, NULL, &c, &e), e);
        took[i] = bytes_read() - before;
        assert_int_equal(c->ds[0]->n_tiles, 4);
        catalog_drop(&c);
        assert_int_equal(stat(path, &st), 0);
        print_message("a store of %lld kB: %llu kB read before it is served\n",
                      (long long)st.st_size / 1000, (unsigned long long)took[i] / 1000);
        assert_true(i == 0 || (uint64_t)st.st_size > 8 * took[i]);
    }
    assert_true(took[1] < 2 * took[0] + 65536);
}

/* Nor does it read how many photographs see each place: only heights need it. */
static void test_a_start_reads_no_counts(void **state)
{
    enum { COUNTS = 1 << 20 };
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct store *s = NULL;
    struct buf counts = {0};
    const struct store_meta meta = {.name = "seen",
                                    .origin = served_origin,
                                    .sh_degree = 1,
                                    .zoom_min = SERVED_ZOOM_MIN,
                                    .zoom_max = SERVED_ZOOM_MAX};
    (void)state;
    if (!bytes_read())
        skip();
    kit_ok(file_join(path, t.dir, "seen.tiles", &e), e);
    kit_ok(store_create(path, &meta, &s, &e), e);
    served_put(s, served_key(SERVED_ZOOM_MIN), 10);
    uint8_t *bytes = mem_array(COUNTS, 1);
    assert_non_null(bytes);
    for (size_t i = 0; i < COUNTS; i++)
        bytes[i] = (uint8_t)(i * 2654435761u >> 13);
    kit_ok(store_put_blob(s, SEEN_BLOB, bytes, COUNTS, &e), e);
    kit_ok(store_commit(&s, &e), e);
    const uint64_t before = bytes_read();
    kit_ok(store_open(path, &s, &e), e);
    assert_true(bytes_read() - before < COUNTS / 4);
    kit_ok(store_get_blob(s, SEEN_BLOB, &counts, &e), e);
    assert_true(bytes_read() - before > COUNTS);
    assert_memory_equal(counts.data, bytes, COUNTS);
    store_close(&s);
    buf_free(&counts);
    mem_free(bytes);
}

/* A revision has one index, however many handles: each reads tiles by itself. */
static void test_handles_share_the_index(void **state)
{
    enum { READERS = 5 };
    struct err e = {0};
    struct dataset *d = NULL;
    struct store *s[READERS];
    size_t n, n_first;
    (void)state;
    kit_ok(dataset_open(t.path, READERS, NULL, NULL, NULL, &d, &e), e);
    const struct store_tile *first = store_tiles(d->index, &n_first);
    for (int i = 0; i < READERS; i++) {
        struct gauss g;
        assert_non_null(s[i] = dataset_borrow(d));
        assert_ptr_equal(store_tiles(s[i], &n), first);
        assert_int_equal(n, n_first);
        kit_ok(store_read_gauss(s[i], served_key(17), &g, &e), e);
        assert_int_equal(g.n, 50);
        gauss_free(&g);
    }
    assert_null(dataset_borrow(d));
    for (int i = 0; i < READERS; i++)
        dataset_return(d, s[i]);
    dataset_drop(&d);
}

/* With a geoid at hand heights above the sea are served as ellipsoidal ones, as a revision of their
 * own: clients of 3D Tiles read them so. Others stay, and say what they count from. */
static void test_a_geoid_makes_heights_ellipsoidal(void **state)
{
    const double above_m = 45.4; /* of kit_gtx at the origin */
    struct err e = {0};
    char path[FILE_PATH_MAX], grid[FILE_PATH_MAX];
    struct geoid *geoid = NULL;
    struct store *s = NULL;
    (void)state;
    kit_ok(file_join(grid, t.dir, "geoid.gtx", &e), e);
    kit_gtx(grid, 52, 13);
    kit_ok(geoid_open(grid, NULL, &geoid, &e), e);
    kit_ok(file_join(path, t.dir, "sea.tiles", &e), e);
    static const char *const kinds[] = {"sea-exif", "sea", "ellipsoid", "takeoff", "EPSG:7837"};
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        struct store_meta meta = {.name = "sea",
                                  .origin = served_origin,
                                  .sh_degree = 1,
                                  .zoom_min = SERVED_ZOOM_MIN,
                                  .zoom_max = SERVED_ZOOM_MAX};
        snprintf(meta.heights, sizeof meta.heights, "%s", kinds[i]);
        kit_ok(store_create(path, &meta, &s, &e), e);
        served_put(s, served_key(SERVED_ZOOM_MIN), 10);
        kit_ok(store_commit(&s, &e), e);
        struct catalog *with = NULL, *without = NULL, *again = NULL;
        struct catalog_options options = served_stores;
        const char *paths[] = {path};
        kit_ok(catalog_open(paths, 1, &options, NULL, &without, &e), e);
        options.geoid = geoid;
        kit_ok(catalog_open(paths, 1, &options, NULL, &with, &e), e);
        const struct dataset *plain = without->ds[0], *d = with->ds[0];
        const bool raised = i < 2;
        assert_true(fabs(d->meta.origin.h_m - served_origin.h_m - (raised ? above_m : 0)) < 1e-6);
        assert_true(fabs(d->bbox[2] - plain->bbox[2] - (raised ? above_m : 0)) < 1e-3);
        assert_string_equal(d->meta.heights, raised ? "ellipsoid" : kinds[i]);
        assert_int_equal(!strcmp(d->meta.revision, plain->meta.revision), !raised);
        assert_string_equal(d->source, plain->meta.revision);
        const char *text = (const char *)d->tileset->data;
        assert_true(!raised || strstr(text, "\"verticalDatum\":\"WGS 84 ellipsoid\""));
        text = (const char *)plain->tileset->data;
        char datum[HEIGHTS_WORDS_MAX];
        heights_datum(kinds[i], datum);
        assert_non_null(strstr(text, datum));
        assert_int_equal(memcmp(plain->tileset->data, d->tileset->data, d->tileset->size) == 0,
                         !raised);
        kit_ok(catalog_open(paths, 1, &options, with, &again, &e), e); /* nothing has changed */
        assert_ptr_equal(again->ds[0], d);
        catalog_drop(&again);
        catalog_drop(&with);
        catalog_drop(&without);
    }
    geoid_close(&geoid);
}

/* A reload that fails at its last step has not touched what is served: its revisions are still
 * current, and the next reload that succeeds keeps them. */
static void test_a_reload_that_fails_late(void **state)
{
    struct err e = {0};
    char a[FILE_PATH_MAX], b[FILE_PATH_MAX];
    struct catalog *first = NULL, *bad = NULL, *second = NULL;
    (void)state;
    kit_ok(file_join(a, t.dir, "a.tiles", &e), e);
    kit_ok(file_join(b, t.dir, "b.tiles", &e), e);
    const char *paths[] = {a, b};
    served_city(a, "a", 10);
    served_city(b, "b", 10);
    kit_ok(catalog_open(paths, 2, &served_stores, NULL, &first, &e), e);
    served_city(a, "a", 11);
    served_city(b, "a", 12);
    kit_fails(catalog_open(paths, 2, &served_stores, first, &bad, &e), ERR_ARG, e, "'a'");
    assert_null(bad);
    assert_int_equal(first->n_current, 2);
    assert_true(first->replaced_s[0] == 0 && first->replaced_s[1] == 0);
    struct dataset *old_a = catalog_find(first, "a", ""), *old_b = catalog_find(first, "b", "");
    served_city(b, "b", 10); /* as it was */
    kit_ok(catalog_open(paths, 2, &served_stores, first, &second, &e), e);
    assert_int_equal(second->n, 3);
    assert_ptr_equal(catalog_find(second, "b", ""), old_b);
    assert_ptr_equal(catalog_find(second, "a", old_a->meta.revision), old_a);
    assert_ptr_not_equal(catalog_find(second, "a", ""), old_a);
    catalog_drop(&first);
    catalog_drop(&second);
}

/* --clip: the part has a revision of its own, the same each time, and a reload of the same file
 * keeps it. */
static void test_a_part_is_served(void **state)
{
    struct err e = {0};
    const char *paths[] = {t.path};
    const struct clip below = {.low_m = -HUGE_VAL, .high_m = 40};
    struct catalog_options o = served_stores;
    struct catalog *whole = NULL, *part = NULL, *again = NULL, *anew = NULL;
    (void)state;
    o.clip = &below;
    o.clip_dir = t.dir;
    kit_ok(catalog_open(paths, 1, &served_stores, NULL, &whole, &e), e);
    kit_ok(catalog_open(paths, 1, &o, NULL, &part, &e), e);
    kit_ok(catalog_open(paths, 1, &o, part, &again, &e), e);
    kit_ok(catalog_open(paths, 1, &o, NULL, &anew, &e), e);
    assert_ptr_equal(again->ds[0], part->ds[0]);
    assert_string_equal(anew->ds[0]->meta.revision, part->ds[0]->meta.revision);
    assert_string_not_equal(whole->ds[0]->meta.revision, part->ds[0]->meta.revision);
    assert_string_equal(part->ds[0]->meta.name, whole->ds[0]->meta.name);
    assert_true(part->ds[0]->n_tiles > 0);
    assert_true(part->ds[0]->tiles[0].count < whole->ds[0]->tiles[0].count);
    catalog_drop(&whole);
    catalog_drop(&part);
    catalog_drop(&again);
    catalog_drop(&anew);
    const struct clip nowhere = {.low_m = 5000, .high_m = 6000};
    o.clip = &nowhere;
    kit_fails(catalog_open(paths, 1, &o, NULL, &part, &e), ERR_DATA, e, "the store lies within");
    assert_int_equal(kit_run(NULL, "ls '%s' | grep -q citysplat-clip", t.dir), 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_reload),
        cmocka_unit_test(test_a_part_is_served),
        cmocka_unit_test(test_a_start_reads_no_tiles),
        cmocka_unit_test(test_a_start_reads_no_counts),
        cmocka_unit_test(test_handles_share_the_index),
        cmocka_unit_test(test_a_geoid_makes_heights_ellipsoidal),
        cmocka_unit_test(test_a_reload_that_fails_late),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
