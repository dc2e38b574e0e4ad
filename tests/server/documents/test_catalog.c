/* Stores that are replaced while they are served.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/routed.h"

#include <math.h>
#include <stdio.h>
#include <sys/stat.h>
#include <unistd.h>

#include "codec/container/seen.h"
#include "lod/export/clip.h"
#include "server/documents/collection.h"

static void test_reload(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct catalog *first = NULL, *second = NULL, *third = NULL;
    kit_ok(file_join(path, t.dir, "moving.tiles", &e), e);
    const char *paths[] = {path};
    served_city(path, "moving", 10);
    first = served_catalog(paths, 1, &served_stores, NULL);
    second = served_catalog(paths, 1, &served_stores, first);
    assert_int_equal(second->n, 1);
    assert_ptr_equal(second->ds[0], first->ds[0]); /* unchanged: the same one */
    served_city(path, "moving", 11);
    third = served_catalog(paths, 1, &served_stores, second);
    assert_int_equal(third->n, 2);
    struct dataset *now = catalog_find(third, "moving", ""), *old = first->ds[0];
    assert_string_not_equal(now->meta.revision, old->meta.revision);
    assert_ptr_equal(catalog_find(third, "moving", old->meta.revision), old);
    struct buf b = {
        0}; /* the older revision's tiles are read from the file that was renamed over */
    struct store *s = NULL;
    kit_ok(dataset_borrow(old, &s, &e), e);
    const struct form form = {FORMAT_SPZ, QUANT_BALANCED, 3, 0, false};
    kit_ok(encode_tile(s, served_key(17), form, NULL, NULL, &b, &e), e);
    dataset_return(old, s);
    buf_free(&b);
    kit_ok(file_write(path, "not a store", 11, &e), e);
    struct catalog *bad = served_catalog(paths, 1, &served_stores, third);
    assert_int_equal(bad->n_absent, 1); /* what was served stays */
    assert_int_equal(bad->absent[0].code, ERR_FORMAT);
    assert_non_null(strstr(bad->absent[0].why, "moving.tiles"));
    assert_ptr_equal(catalog_find(bad, "moving", ""), now);
    catalog_drop(&bad);
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
    const char *twice[] = {t.path, t.path}; /* is the same as once */
    bad = served_catalog(twice, 2, &served_stores, NULL);
    assert_int_equal(bad->n, 1);
    assert_int_equal(bad->n_absent, 0);
    catalog_drop(&bad);
}

/* ---- what is not whole ---- */

static const struct catalog_absent *absent(const struct catalog *c, const char *path)
{
    for (size_t i = 0; i < c->n_absent; i++)
        if (!strcmp(c->absent[i].path, path))
            return &c->absent[i];
    fail_msg("%s is not among what is absent", path);
    return NULL;
}

/* Rows whose hash is right, with sizes that no document can hold. */
static void test_forged_sizes(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    const struct store_meta meta = {.name = "forged",
                                    .origin = served_origin,
                                    .sh_degree = 1,
                                    .zoom_min = SERVED_ZOOM_MAX,
                                    .zoom_max = SERVED_ZOOM_MAX};
    kit_ok(file_join(path, t.dir, "forged.tiles", &e), e);
    for (int k = 0; k < 6; k++) {
        struct store *s = NULL;
        struct gauss g = {0};
        struct buf payload = {0};
        kit_ok(store_create(path, &meta, &s, &e), e);
        struct store_entry x = served_gauss(served_key(SERVED_ZOOM_MAX), 10, &g);
        kit_ok(store_encode(s, &x, &g, &payload, &e), e);
        double *const sizes[] = {&x.shape.geometric_error_m, &x.shape.geometric_error_m,
                                 &x.shape.max_enu_m[1],      &x.shape.min_enu_m[0],
                                 &x.shape.center_enu_m[2],   &x.shape.sigma_max_m};
        static const double forged[] = {HUGE_VAL, -1, HUGE_VAL, -1e300, 1e9, HUGE_VAL};
        *sizes[k] = forged[k];
        kit_ok(store_add(s, &x, &payload, &e), e);
        kit_ok(store_commit(&s, &e), e);
        kit_fails(store_open(path, &s, &e), ERR_FORMAT, e, "a place or a size is beyond");
        assert_null(s);
        const char *args[] = {path};
        struct catalog *c = served_catalog(args, 1, &served_stores, NULL);
        assert_int_equal(absent(c, path)->code, ERR_FORMAT); /* exit code 65 */
        catalog_drop(&c);
        buf_free(&payload);
        gauss_free(&g);
    }
}

/* A folder with everything that may lie in it. */
enum { PLACES = 8 };
static struct {
    char dir[FILE_PATH_MAX], at[PLACES][FILE_PATH_MAX];
    struct catalog_options o;
} folder;

static struct catalog *folder_served(const struct catalog *older)
{
    const char *args[] = {folder.dir};
    return served_catalog(args, 1, &folder.o, older);
}

static void folder_fill(void)
{
    static const char *const names[PLACES] = {"a.tiles",    "b.tiles",   "broken.tiles",
                                              "fifo.tiles", "dir.tiles", "secret.tiles",
                                              "twin.tiles", "notes.txt"};
    struct err e = {0};
    for (size_t i = 0; i < PLACES; i++)
        kit_ok(file_join(folder.at[i], folder.dir, names[i], &e), e);
    served_city(folder.at[0], "a", 10);
    served_city(folder.at[1], "b", 10);
    kit_ok(file_write(folder.at[2], "cut off", 7, &e), e);
    assert_int_equal(mkfifo(folder.at[3], 0600), 0);
    kit_ok(file_mkdir(folder.at[4], &e), e);
    served_city(folder.at[5], "secret", 10);
    assert_int_equal(chmod(folder.at[5], 0), 0);
    served_city(folder.at[6], "a", 12);
    kit_ok(file_write(folder.at[7], "", 0, &e), e);
}

/* What is whole is served, the rest is named. */
static void folder_is_served(const struct catalog *c)
{
    const bool all = geteuid() == 0; /* root reads what nobody may read */
    assert_int_equal(c->n_current, all ? 3 : 2);
    assert_int_equal(c->n_absent, all ? 4 : 5);
    assert_string_equal(catalog_find(c, "a", "")->path, folder.at[0]); /* the first of two */
    assert_non_null(catalog_find(c, "b", ""));
    assert_int_equal(absent(c, folder.at[2])->code, ERR_FORMAT);
    assert_non_null(strstr(absent(c, folder.at[3])->why, "no file"));
    assert_non_null(strstr(absent(c, folder.at[4])->why, "a folder"));
    if (!all)
        assert_int_equal(absent(c, folder.at[5])->code, ERR_IO);
    assert_non_null(strstr(absent(c, folder.at[6])->why, "serve one of them"));
    assert_true(absent(c, folder.at[2])->pause_s == 10);
    assert_true(absent(c, folder.at[2])->again_s > clock_s() + 5);
    json_t *changes = catalog_changes(NULL, c);
    assert_int_equal(json_array_size(json_object_get(changes, "added")), c->n_current);
    assert_int_equal(json_array_size(json_object_get(changes, "failed")), c->n_absent);
    json_decref(changes);
}

/* Stores are mended, replaced and removed, and the first twin goes. Drops c. */
static struct catalog *folder_changes(struct catalog *c)
{
    char was[13];
    memcpy(was, catalog_find(c, "b", "")->meta.revision, sizeof was);
    served_city(folder.at[2], "mended", 10);
    served_city(folder.at[1], "b", 11);
    assert_int_equal(unlink(folder.at[0]), 0);
    struct catalog *later = folder_served(c);
    assert_non_null(catalog_find(later, "mended", ""));
    assert_string_equal(catalog_find(later, "a", "")->path, folder.at[6]);
    assert_non_null(catalog_find(later, "b", was)); /* for a day */
    assert_true(absent(later, folder.at[3])->pause_s == 20);
    json_t *changes = catalog_changes(c, later);
    const json_t *b = json_array_get(json_object_get(changes, "replaced"), 1);
    assert_string_equal(json_string_value(json_object_get(b, "name")), "b");
    assert_string_equal(json_string_value(json_object_get(b, "from")), was);
    assert_int_equal(json_array_size(json_object_get(changes, "added")), 1);
    assert_int_equal(json_array_size(json_object_get(changes, "removed")), 0);
    json_decref(changes);
    catalog_drop(&c);
    assert_int_equal(unlink(folder.at[2]), 0);
    c = folder_served(later);
    assert_null(catalog_find(c, "mended", ""));
    catalog_drop(&later);
    return c;
}

/* A folder that goes takes nothing with it, and what is in it is found when it is back. Drops c. */
static void folder_goes(struct catalog *c)
{
    struct err e = {0};
    char away[FILE_PATH_MAX];
    kit_ok(file_join(away, t.dir, "away", &e), e);
    assert_int_equal(rename(folder.dir, away), 0);
    struct catalog *later = folder_served(c);
    assert_int_equal(later->n_current, c->n_current);
    assert_int_equal(absent(later, folder.dir)->code, ERR_NOENT);
    assert_non_null(absent(later, folder.at[1]));
    assert_non_null(catalog_find(later, "b", ""));
    catalog_drop(&c);
    assert_int_equal(rename(away, folder.dir), 0);
    c = folder_served(later);
    assert_int_equal(c->n_current, later->n_current);
    assert_ptr_equal(catalog_find(c, "b", ""), catalog_find(later, "b", ""));
    catalog_drop(&later);
    catalog_drop(&c);
}

static void test_a_folder_of_stores(void **state)
{
    struct err e = {0};
    const char *args[] = {folder.dir};
    struct arena arena = {0};
    struct catalog_place *place;
    size_t n, folders;
    char scene[FILE_PATH_MAX];
    folder.o = served_stores;
    folder.o.again_s = 10;
    kit_ok(file_join(folder.dir, t.dir, "stores", &e), e);
    kit_ok(file_mkdir(folder.dir, &e), e);
    struct catalog *c = folder_served(NULL); /* empty yet */
    assert_int_equal(c->n + c->n_absent, 0);
    catalog_drop(&c);
    folder_fill();
    c = folder_served(NULL);
    folder_is_served(c);
    folder_goes(folder_changes(c));
    assert_int_equal(chmod(folder.at[5], 0600), 0);
    /* a scene is no folder of stores */
    kit_ok(file_join(scene, folder.dir, "scene.json", &e), e);
    kit_ok(file_write(scene, "{}", 2, &e), e);
    kit_fails(catalog_list(args, 1, NULL, &arena, &place, &n, &folders, &e), ERR_FORMAT, e,
              "citysplat tile");
    arena_free(&arena);
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
    if (!bytes_read())
        skip();
    for (int i = 0; i < 2; i++) {
        struct catalog *c = NULL;
        struct stat st;
        const char *paths[] = {path};
        kit_ok(file_join(path, t.dir, i ? "large.tiles" : "small.tiles", &e), e);
        served_city(path, "start", gaussians[i]);
        uint64_t before = bytes_read();
        c = served_catalog(paths, 1, &served_stores, NULL);
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
    kit_ok(dataset_open(t.path, READERS, NULL, &d, &e), e);
    const struct store_tile *first = store_tiles(d->index, &n_first);
    for (int i = 0; i < READERS; i++) {
        struct gauss g;
        kit_ok(dataset_borrow(d, &s[i], &e), e);
        assert_ptr_equal(store_tiles(s[i], &n), first);
        assert_int_equal(n, n_first);
        kit_ok(store_read_gauss(s[i], served_key(17), &g, &e), e);
        assert_int_equal(g.n, 50);
        gauss_free(&g);
    }
    struct store *none;
    kit_fails(dataset_borrow(d, &none, &e), ERR_INTERNAL, e, "handles");
    assert_null(none);
    for (int i = 0; i < READERS; i++)
        dataset_return(d, s[i]);
    dataset_drop(&d);
}

/* Of many datasets, documents are made when they are asked for: the same bytes, of the same time,
 * once. */
static void test_documents_wait_where_there_are_many(void **state)
{
    const struct collection_options none = {0};
    const char *paths[] = {t.path};
    struct catalog_options options = served_stores;
    struct catalog *at_once = served_catalog(paths, 1, &options, NULL);
    options.lazy = true;
    struct catalog *lazy = served_catalog(paths, 1, &options, NULL);
    for (int i = 0; i < DATASET_DOCUMENTS; i++) {
        const enum dataset_document which = (enum dataset_document)i;
        assert_non_null(atomic_load(&at_once->ds[0]->document[i]));
        assert_null(atomic_load(&lazy->ds[0]->document[i]));
        struct body *want = catalog_document(at_once->ds[0], which, &none),
                    *got = catalog_document(lazy->ds[0], which, &none),
                    *again = catalog_document(lazy->ds[0], which, &none);
        assert_ptr_equal(got, again);
        assert_string_equal(got->etag, want->etag);
        assert_true(got->size == want->size && !memcmp(got->data, want->data, got->size));
        assert_true(got->modified_s == lazy->ds[0]->opened_s);
        body_drop(&want);
        body_drop(&got);
        body_drop(&again);
    }
    catalog_drop(&lazy);
    catalog_drop(&at_once);
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
    kit_ok(file_join(grid, t.dir, "geoid.gtx", &e), e);
    kit_gtx(grid, 52, 13);
    kit_ok(geoid_open(grid, &geoid, &e), e);
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
        struct catalog_options options = served_stores;
        const char *paths[] = {path};
        struct catalog *without = served_catalog(paths, 1, &options, NULL);
        options.geoid = geoid;
        struct catalog *with = served_catalog(paths, 1, &options, NULL);
        struct dataset *plain = without->ds[0], *d = with->ds[0];
        const bool raised = i < 2;
        assert_true(fabs(d->meta.origin.h_m - served_origin.h_m - (raised ? above_m : 0)) < 1e-6);
        assert_true(fabs(d->bbox[2] - plain->bbox[2] - (raised ? above_m : 0)) < 1e-3);
        assert_string_equal(d->meta.heights, raised ? "ellipsoid" : kinds[i]);
        assert_int_equal(!strcmp(d->meta.revision, plain->meta.revision), !raised);
        assert_string_equal(d->source, plain->meta.revision);
        struct body *raised_set = atomic_load(&d->document[DATASET_TILESET]),
                    *plain_set = atomic_load(&plain->document[DATASET_TILESET]);
        const char *text = (const char *)raised_set->data;
        assert_true(!raised || strstr(text, "\"verticalDatum\":\"WGS 84 ellipsoid\""));
        text = (const char *)plain_set->data;
        char datum[HEIGHTS_WORDS_MAX];
        heights_datum(kinds[i], datum);
        assert_non_null(strstr(text, datum));
        assert_int_equal(memcmp(plain_set->data, raised_set->data, raised_set->size) == 0, !raised);
        struct catalog *again = served_catalog(paths, 1, &options, with); /* nothing has changed */
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
    kit_ok(file_join(a, t.dir, "a.tiles", &e), e);
    kit_ok(file_join(b, t.dir, "b.tiles", &e), e);
    const char *paths[] = {a, b};
    served_city(a, "a", 10);
    served_city(b, "b", 10);
    first = served_catalog(paths, 2, &served_stores, NULL);
    served_city(a, "a", 11);
    served_city(b, "a", 12);
    bad = served_catalog(paths, 2, &served_stores, first);
    assert_non_null(strstr(absent(bad, b)->why, "'a'")); /* and the dataset b, which is gone, too */
    assert_int_equal(bad->n_current, 1);
    catalog_drop(&bad);
    assert_int_equal(first->n_current, 2);
    assert_true(first->replaced_s[0] == 0 && first->replaced_s[1] == 0);
    struct dataset *old_a = catalog_find(first, "a", ""), *old_b = catalog_find(first, "b", "");
    served_city(b, "b", 10); /* as it was */
    second = served_catalog(paths, 2, &served_stores, first);
    assert_int_equal(second->n, 3);
    assert_ptr_equal(catalog_find(second, "b", ""), old_b);
    assert_ptr_equal(catalog_find(second, "a", old_a->meta.revision), old_a);
    assert_ptr_not_equal(catalog_find(second, "a", ""), old_a);
    catalog_drop(&first);
    catalog_drop(&second);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_reload),
        cmocka_unit_test(test_a_folder_of_stores),
        cmocka_unit_test(test_forged_sizes),
        cmocka_unit_test(test_a_start_reads_no_tiles),
        cmocka_unit_test(test_a_start_reads_no_counts),
        cmocka_unit_test(test_handles_share_the_index),
        cmocka_unit_test(test_documents_wait_where_there_are_many),
        cmocka_unit_test(test_a_geoid_makes_heights_ellipsoidal),
        cmocka_unit_test(test_a_reload_that_fails_late),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
