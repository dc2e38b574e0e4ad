/* Tiles and lists of tiles as pure calls: bytes, tags, ranges, presets, damage.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/routed.h"

#include <sqlite3.h>
#include <stdlib.h>

static void test_tiles(void **state)
{
    static const struct {
        const char *ext, *type, *magic;
    } rows[] = {
        {"glb", "model/gltf-binary", "glTF"},
        {"plain.glb", "model/gltf-binary", "glTF"},
        {"lowpass.glb", "model/gltf-binary", "glTF"},
        {"spz", "application/octet-stream", "\x1f\x8b"},
        {"drc", "application/octet-stream", "DRACO"},
        {"ply", "application/octet-stream", "ply\n"},
        {"compressed.ply", "application/octet-stream", "ply\n"},
        {"sog", "application/zip", "PK\3\4"},
    };
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
    dispatch_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 304);
    assert_null(r.work);
    response_free(&r);
}

static void test_ranges(void **state)
{
    const char *target = "/d/toy/r/REV/t/KEY17.ply";
    struct response whole = get(target);
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

/* ---- pages of prefetch lists ---- */

struct row { /* of a list */
    unsigned z;
    long long bytes;
};

/* The rows of a list, and how many; *next: the address of the next page, "" for none. */
static size_t list_rows(const char *target, struct row *out, size_t room, char next[600])
{
    struct response r = get(target);
    size_t n = 0;
    char *text = mem_array(r.size + 1, 1), *rest = NULL;
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.size, (const char *)r.data);
    memcpy(text, r.data, r.size);
    next[0] = '\0';
    for (char *line = strtok_r(text, "\n", &rest); line; line = strtok_r(NULL, "\n", &rest)) {
        json_t *o = json_loads(line, 0, NULL);
        const char *url = json_string_value(json_object_get(o, "url")), *t_at;
        const char *more = json_string_value(json_object_get(o, "next"));
        assert_non_null(o);
        if (more) {
            snprintf(next, 600, "%s", more);
            assert_null(strtok_r(NULL, "\n", &rest)); /* the last line */
            json_decref(o);
            break;
        }
        assert_true(n < room);
        t_at = strstr(url, "t/1");
        assert_non_null(t_at);
        out[n++] =
            (struct row){(unsigned)atoi(t_at + 2), json_integer_value(json_object_get(o, "bytes"))};
        json_decref(o);
    }
    mem_free(text);
    response_free(&r);
    return n;
}

/* Pages: together they are the whole list, in order, each at an address of the revision. */
static void test_seed_pages(void **state)
{
    static const char *const queries[] = {"", "f=drc&preset=spz&sh=1&bbox=-1.5,50,14,53&"};
    for (size_t q = 0; q < sizeof queries / sizeof *queries; q++) {
        struct row all[8], page[8];
        char target[900], next[600];
        size_t n_pages = 0, n = 0;
        snprintf(target, sizeof target, "/d/toy/seed.ndjson?%s", queries[q]);
        target[strlen(target) - 1] = '\0'; /* ? or & */
        size_t n_all = list_rows(target, all, 8, next);
        expect("next", next, "");
        snprintf(target, sizeof target, "/d/toy/seed.ndjson?%slimit=1", queries[q]);
        for (;; n_pages++) {
            size_t got = list_rows(target, page, 8, next);
            assert_int_equal(got, 1);
            assert_true(page[0].z == all[n].z && page[0].bytes == all[n].bytes);
            n++;
            if (!next[0])
                break;
            const char *base = n_pages ? "/d/toy/r/REV+/" : "/d/toy/";
            assert_int_equal(!strncmp(next, "r/", 2), !n_pages);
            snprintf(target, sizeof target, "%s%s", base, next);
            struct response r = get(target);
            expect("Cache-Control", r.cache_control, IMMUTABLE);
            response_free(&r);
        }
        assert_int_equal(n, n_all);
        assert_true(n_pages >= 2);
    }
    struct response r = get("/d/toy/r/REV+/seed.ndjson");
    char want[64];
    expect("Cache-Control", r.cache_control, IMMUTABLE);
    assert_true(says(&r, expand("{\"url\":\"t/KEY15.glb\"", want, sizeof want)));
    response_free(&r);
    r = get("/d/toy/r/REV/seed.ndjson");
    expect("Cache-Control", r.cache_control, MOVING);
    response_free(&r);
    r = get("/d/toy/seed.ndjson?after=999");
    assert_int_equal(r.size, 0);
    response_free(&r);
}

/* Link: the coarsest tile of a tileset, what follows a tile; in the form that was asked for. */
static void test_links(void **state)
{
    static const struct {
        const char *target, *want;
    } rows[] = {
        {"/d/toy/tileset.json", "<r/REV+/t/KEY15.glb>; rel=preload; as=fetch; crossorigin"},
        {"/d/toy/r/REV+/tileset.json", "<t/KEY15.glb>; rel=preload; as=fetch; crossorigin"},
        {"/d/toy/r/REV/tileset.json?preset=spz&sh=0",
         "<t/KEY15.glb?preset=spz&sh=0>; rel=preload; as=fetch; crossorigin"},
        {"/d/toy/r/REV+/t/KEY15.drc", "<../../KEY16.drc>; rel=prefetch"},
        {"/d/toy/r/REV+/t/KEY15.plain.glb?v=1", "<../../KEY16.plain.glb>; rel=prefetch"},
        {"/d/toy/r/REV+/t/KEY16.spz?sh=1", NULL}, /* two */
        {"/d/toy/r/REV+/t/KEY17.drc", ""},
        {"/d/toy/r/REV+/t/17/0/0.drc", ""},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char want[400];
        struct response r = get(rows[i].target);
        if (rows[i].want) {
            expect("Link", r.hints, expand(rows[i].want, want, sizeof want));
        } else {
            assert_non_null(
                strstr(r.hints, expand("<../../KEY17.spz?sh=1>; rel=prefetch", want, sizeof want)));
            assert_int_equal(strlen(r.hints), 2 * strlen(want) + 2);
        }
        response_free(&r);
    }
    static const char access[] = "{\"public\": []}";
    struct err e = {0};
    assert_int_equal(auth_parse(access, sizeof access - 1, "access.json", &t.s.auth, &e), 0);
    struct response r = get("/d/toy/tileset.json");
    expect("Link", r.hints, "");
    response_free(&r);
    auth_close(&t.s.auth);
    t.s.auth = NULL;
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
        {"drc?part=1", "drc", true}, /* a small tile is one part */
        {"glb?part=2", "glb", true},
        {"ply", "ply?preset=preview&sh=0", true},
        {"plain.glb", "plain.glb?preset=preview", true},
        {"compressed.ply", "compressed.ply?preset=preview", true},
        {"compressed.ply", "compressed.ply?sh=0", false},
        {"compressed.ply", "ply", false},
        {"sog", "sog?preset=preview", true},
        {"sog", "sog?sh=0", false},
    };
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
    r = get("/d/toy/t/KEY17.drc?part=2&sh=0");
    assert_int_equal(r.status, 307);
    assert_non_null(strstr(r.location, ".drc?part=2&sh=0"));
    response_free(&r);
    r = get("/d/toy/r/REV/t/KEY17.drc?part=2");
    assert_int_equal(r.status, 404);
    response_free(&r);
    r = get("/d/toy/r/REV/t/KEY17.drc?part=3");
    assert_int_equal(r.status, 400);
    response_free(&r);
    r = get("/d/toy/r/REV/tileset.json?part=2"); /* it is no tile */
    assert_false(says(&r, "part="));
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
    kit_ok(file_join(path, t.dir, "damaged.tiles", &e), e);
    served_city(path, "damaged", 20);
    store_fixture_damage(path, served_key(17), path);
    const char *paths[] = {path};
    damaged = served_catalog(paths, 1, &served_stores, NULL);
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

/* SQLite has no memory for a tile's bytes: that is no damage, and the client may come again. */
static void test_no_memory_for_a_tile(void **state)
{
    const sqlite3_int64 before = sqlite3_hard_heap_limit64(-1);
    (void)sqlite3_hard_heap_limit64(sqlite3_memory_used() + 512);
    struct response r = get("/d/toy/r/REV+/t/KEY16.ply?sh=0");
    (void)sqlite3_hard_heap_limit64(before);
    assert_int_equal(r.status, 503);
    assert_true(r.retry_after_s > 0);
    assert_true(says(&r, "out of memory"));
    assert_false(says(&r, "damaged") || says(&r, "toy.tiles"));
    response_free(&r);
    r = get("/d/toy/r/REV+/t/KEY16.ply?sh=0");
    assert_int_equal(r.status, 200);
    response_free(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_tiles),        cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_seed),         cmocka_unit_test(test_presets),
        cmocka_unit_test(test_seed_pages),   cmocka_unit_test(test_links),
        cmocka_unit_test(test_damaged_tile), cmocka_unit_test(test_no_memory_for_a_tile),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
