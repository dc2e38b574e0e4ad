/* Tiles and lists of tiles as pure calls: bytes, tags, ranges, presets, damage.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/routed.h"

static void test_tiles(void **state)
{
    static const struct {
        const char *ext, *type, *magic;
    } rows[] = {
        {"glb", "model/gltf-binary", "glTF"},
        {"plain.glb", "model/gltf-binary", "glTF"},
        {"spz", "application/octet-stream", "\x1f\x8b"},
        {"drc", "application/octet-stream", "DRACO"},
        {"ply", "application/octet-stream", "ply\n"},
        {"sog", "application/zip", "PK\3\4"},
    };
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char target[128];
        snprintf(target, sizeof target, "/d/toy/r/REV+/t/KEY17.%s", rows[i].ext);
        struct response r = get(target);
        assert_int_equal(r.status, 200);
        expect("cache", r.cache, "miss");
        expect("type", r.type, rows[i].type);
        expect("Cache-Control", r.cache_control, IMMUTABLE);
        expect("Vary", r.vary, NULL);
        assert_true(r.accept_ranges);
        assert_true(r.size > 100);
        assert_memory_equal(r.data, rows[i].magic, strlen(rows[i].magic));
        char surrogate[128];
        expect("Surrogate-Key", r.surrogate,
               expand("ds-toy rev-REV z-17", surrogate, sizeof surrogate));
        struct response again = get(target);
        expect("cache", again.cache, "hit");
        assert_ptr_equal(again.body, r.body);
        assert_string_equal(again.etag, r.etag);
        /* 304 repeats what a cache must know */
        struct response same = answer(&(struct ask){.target = target, .if_none_match = r.etag});
        assert_int_equal(same.status, 304);
        expect("ETag", same.etag, r.etag);
        expect("Cache-Control", same.cache_control, IMMUTABLE);
        response_free(&same);
        response_free(&again);
        response_free(&r);
    }
    /* a name of the bytes decides 304 without the bytes: this tile was never made */
    struct response cold = get("/d/toy/r/REV/t/KEY15.spz");
    char etag[BODY_ETAG_SIZE], weak[BODY_ETAG_SIZE + 2];
    memcpy(etag, cold.etag, sizeof etag);
    snprintf(weak, sizeof weak, "W/%s", etag);
    response_free(&cold);
    cache_close(&t.s.cache);
    struct err e = {0};
    kit_ok(cache_open((size_t)64 << 20, &t.s.cache, &e), e);
    const char *target = expand("/d/toy/r/REV/t/KEY15.spz", last_target, sizeof last_target);
    struct request q = {.target = target, .target_size = strlen(target), .if_none_match = weak};
    struct response r;
    route_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 304);
    assert_null(r.work);
    response_free(&r);
}

static void test_ranges(void **state)
{
    const char *target = "/d/toy/r/REV/t/KEY17.ply";
    struct response whole = get(target);
    (void)state;
    assert_int_equal(whole.status, 200);
    struct buf sum = {0};
    size_t step = whole.size / 7 + 1;
    for (size_t at = 0; at < whole.size;
         at += step) { /* the parts, one after the other, are the whole */
        char range[64];
        snprintf(range, sizeof range, "bytes=%zu-%zu", at, at + step - 1);
        struct response part =
            answer(&(struct ask){.target = target, .range = range, .if_range = whole.etag});
        assert_int_equal(part.status, 206);
        assert_int_equal(part.range_first, at);
        assert_int_equal(part.range_total, whole.size);
        assert_string_equal(part.etag, whole.etag);
        buf_add(&sum, part.data, part.size);
        response_free(&part);
    }
    assert_int_equal(sum.size, whole.size);
    assert_memory_equal(sum.data, whole.data, whole.size);
    buf_free(&sum);
    struct response r = answer(&(struct ask){.target = target, .range = "bytes=99999999-"});
    assert_int_equal(r.status, 416);
    assert_int_equal(r.range_total, whole.size);
    response_free(&r);
    r = answer(&(struct ask){.target = target, .range = "bytes=0-9", .if_range = "\"another\""});
    assert_int_equal(r.status, 200);
    response_free(&r);
    r = answer(&(struct ask){.method = METHOD_HEAD, .target = target, .range = "bytes=0-9"});
    assert_int_equal(r.status, 200); /* Range is defined for GET alone */
    response_free(&r);
    response_free(&whole);
}

static void test_seed(void **state)
{
    struct response r = get("/d/toy/seed.ndjson");
    size_t lines = 0, last_z = 0;
    char *text = mem_array(r.size + 1, 1), *rest = NULL;
    (void)state;
    assert_int_equal(r.status, 200);
    expect("type", r.type, "application/x-ndjson");
    memcpy(text, r.data, r.size);
    for (char *line = strtok_r(text, "\n", &rest); line;
         line = strtok_r(NULL, "\n", &rest), lines++) {
        json_t *o = json_loads(line, 0, NULL);
        assert_non_null(o);
        char target[256];
        unsigned z;
        const char *url = json_string_value(json_object_get(o, "url"));
        assert_int_equal(sscanf(url, "r/%*12[0-9a-f]-%*8[0-9a-f]/t/%u/", &z), 1);
        assert_true(z >= last_z);
        last_z = z;
        snprintf(target, sizeof target, "/d/toy/%s", url);
        struct response tile = get(target);
        assert_int_equal(tile.status, 200);
        expect("Cache-Control", tile.cache_control, IMMUTABLE);
        expect("etag", json_string_value(json_object_get(o, "etag")), tile.etag);
        response_free(&tile);
        json_decref(o);
    }
    assert_int_equal(lines, 4);
    mem_free(text);
    response_free(&r);
    r = get("/d/toy/seed.ndjson?z=17&f=drc");
    assert_true(says(&r, ".drc"));
    assert_false(says(&r, "/t/15/"));
    response_free(&r);
    r = get("/d/toy/seed.ndjson?bbox=0,0,1,1");
    assert_int_equal(r.status, 200);
    assert_int_equal(r.size, 0);
    response_free(&r);
}

/* Presets and degrees are bytes of their own, each with a tag of its own; what is not said is the
 * server's; what a format does not know makes no other bytes. */
static void test_presets(void **state)
{
    static const struct {
        const char *a, *b;
        bool same;
    } rows[] = {
        {"drc", "drc?preset=balanced", true},
        {"drc", "drc?preset=spz", false},
        {"drc?preset=preview", "drc?preset=near-lossless", false},
        {"glb", "glb?preset=preview", false},
        {"spz", "spz?v=17", true},
        {"spz?sh=0", "spz?sh=1", false},
        {"spz?sh=3", "spz", true},
        {"ply", "ply?preset=preview&sh=0", true},
        {"plain.glb", "plain.glb?preset=preview", true},
        {"sog", "sog?preset=preview", true},
        {"sog", "sog?sh=0", false},
    };
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char target[128];
        snprintf(target, sizeof target, "/d/toy/r/REV/t/KEY17.%s", rows[i].a);
        struct response a = get(target);
        snprintf(target, sizeof target, "/d/toy/r/REV/t/KEY17.%s", rows[i].b);
        struct response b = get(target);
        assert_int_equal(a.status, 200);
        assert_int_equal(b.status, 200);
        bool same = a.size == b.size && !memcmp(a.data, b.data, a.size);
        if (same != rows[i].same || !strcmp(a.etag, b.etag) != rows[i].same)
            fail_msg("%s and %s: bytes %s, tags %s and %s", rows[i].a, rows[i].b,
                     same ? "equal" : "differ", a.etag, b.etag);
        response_free(&a);
        response_free(&b);
    }
    struct response r = get("/d/toy/t/KEY17.drc?preset=preview&sh=0");
    assert_int_equal(r.status, 307);
    assert_non_null(strstr(r.location, ".drc?preset=preview&sh=0"));
    response_free(&r);
    r = get("/d/toy/r/REV/t/KEY17.drc?preset=best");
    assert_int_equal(r.status, 400);
    response_free(&r);
    r = get("/d/toy/seed.ndjson?z=17&f=drc&preset=spz&sh=1");
    assert_true(says(&r, ".drc?preset=spz&sh=1\","));
    response_free(&r);
}

/* A damaged tile is that tile's problem alone. */
static void test_damaged_tile(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct catalog *damaged = NULL, *sound = t.s.catalog;
    (void)state;
    kit_ok(file_join(path, t.dir, "damaged.tiles", &e), e);
    served_city(path, "damaged", 20);
    store_fixture_damage(path, served_key(17), path);
    const char *paths[] = {path};
    kit_ok(catalog_open(paths, 1, &served_stores, NULL, &damaged, &e), e);
    t.s.catalog = damaged;
    char target[256], where[64];
    snprintf(target, sizeof target, "/d/damaged/r/%s/t/%s.glb", damaged->ds[0]->meta.revision,
             expand("KEY17", where, sizeof where));
    struct response r = get(target);
    assert_int_equal(r.status, 500);
    assert_false(says(&r, path)); /* no file name for the client */
    expect("type", r.type, "application/problem+json");
    expect("cache", r.cache_control, "no-store");
    json_t *o = json_of(&r);
    const struct key k = served_key(17);
    unsigned z, x, y;
    const char *dataset, *detail;
    assert_int_equal(json_unpack(o, "{s:s,s:s,s:{s:i,s:i,s:i}}", "detail", &detail, "dataset",
                                 &dataset, "tile", "z", &z, "x", &x, "y", &y),
                     0);
    assert_true(z == k.z && x == k.x && y == k.y);
    expect("dataset", dataset, "damaged");
    snprintf(where, sizeof where, "tile %u/%u/%u of dataset damaged is damaged", k.z, k.x, k.y);
    assert_non_null(strstr(detail, where));
    json_decref(o);
    response_free(&r);
    snprintf(target, sizeof target, "/d/damaged/r/%s/t/%s.glb", damaged->ds[0]->meta.revision,
             expand("KEY16", where, sizeof where));
    r = get(target);
    assert_int_equal(r.status, 200);
    response_free(&r);
    t.s.catalog = sound;
    catalog_drop(&damaged);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_tiles),        cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_seed),         cmocka_unit_test(test_presets),
        cmocka_unit_test(test_damaged_tile),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
