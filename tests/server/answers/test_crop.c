/* A polygon in the query of tiles, tilesets and prefetch lists: answers have what lies inside, all
 * spellings give the same result, and all that is listed exists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/routed.h"

#include <math.h>
#include <stdlib.h>

#include "core/splat/gauss.h"
#include "lod/export/crop.h"
#include "server/route/param_clip.h"

/* About the finest tile's centre, 1e-5 degrees: a triangle that leaves a part of what is there, one
 * in a gap, one far away, and a square around all of the city. */
enum { TRIANGLE, GAP, FAR, ALL, SHAPES };
static const int shapes[SHAPES][4][2] = {
    [TRIANGLE] = {{-20, -15}, {30, -10}, {-5, 25}},
    [FAR] = {{9000, 0}, {9100, 0}, {9000, 100}},
    [ALL] = {{-5000, -5000}, {5000, -5000}, {5000, 5000}, {-5000, 5000}},
};
static double gap_at[2]; /* a place that no mean is near to; found by setup_gap */

static void corner_of(int shape, int i, double out[2])
{
    double lon, lat;
    key_center(served_key(SERVED_ZOOM_MAX), &lon, &lat);
    const int gap[3][2] = {{0, 0}, {1, 0}, {0, 1}};
    const int *at = shape == GAP ? gap[i % 3] : shapes[shape][i];
    const double unit = shape == GAP ? 1e-6 : 1e-5;
    out[0] = round(1e7 * ((shape == GAP ? gap_at[0] : lon) + unit * at[0])) / 1e7;
    out[1] = round(1e7 * ((shape == GAP ? gap_at[1] : lat) + unit * at[1])) / 1e7;
}

/* As text that begins with this corner; back: the other way round. */
static const char *clip_text(int shape, int first, bool back, char out[200])
{
    const int n = shape == ALL ? 4 : 3;
    size_t size = 0;
    for (int i = 0; i < n; i++) {
        double at[2];
        corner_of(shape, ((back ? -i : i) + first + n) % n, at);
        size += (size_t)snprintf(out + size, 200 - size, "%s%.7f,%.7f", i ? "," : "", at[0], at[1]);
    }
    return out;
}

/* By half-planes, which shares nothing with the code: are these degrees in the triangle? */
static bool in_triangle(int shape, double lon, double lat)
{
    for (int i = 0; i < 3; i++) {
        double a[2], b[2];
        corner_of(shape, i, a);
        corner_of(shape, (i + 1) % 3, b);
        if ((b[0] - a[0]) * (lat - a[1]) - (b[1] - a[1]) * (lon - a[0]) < 0)
            return false;
    }
    return true;
}

/* How many means of a tile lie in the triangle. */
static size_t expected(int shape, struct key k)
{
    struct err e = {0};
    struct gauss g = {0};
    size_t n = 0;
    kit_ok(store_read_gauss(t.s.catalog->ds[0]->stores[0], k, &g, &e), e);
    for (size_t i = 0; i < g.n; i++) {
        double enu[3], lon, lat, h;
        for (int c = 0; c < 3; c++)
            enu[c] = (double)g.mean_m[3 * i + (size_t)c] + g.origin_enu_m[c];
        kit_ok(geo_from_enu(&served_origin, enu, &lon, &lat, &h, &e), e);
        n += in_triangle(shape, lon, lat);
    }
    gauss_free(&g);
    return n;
}

static size_t ply_count(const struct response *r)
{
    char head[400];
    snprintf(head, sizeof head, "%.*s", (int)(r->size < 399 ? r->size : 399),
             (const char *)r->data);
    const char *at = strstr(head, "element vertex ");
    assert_non_null(at);
    return (size_t)atol(at + 15);
}

static struct response get_clipped(const char *path, const char *more, int shape)
{
    char target[700], clip[200];
    snprintf(target, sizeof target, "%s?%sclip=%s", path, more, clip_text(shape, 0, false, clip));
    return get(target);
}

static int setup_gap(void **state)
{
    if (setup(state))
        return 1;
    double lon, lat;
    key_center(served_key(SERVED_ZOOM_MAX), &lon, &lat);
    for (int i = 0; i < 1000; i++) { /* in the middle, where boxes are */
        gap_at[0] = lon + 1e-5 * (i % 30 - 15);
        gap_at[1] = lat + 1e-5 * (i / 30 - 15);
        size_t n = 0;
        for (uint8_t z = SERVED_ZOOM_MIN; z <= SERVED_ZOOM_MAX; z++)
            n += expected(GAP, served_key(z));
        if (!n)
            return 0;
    }
    return 1;
}

/* ---- tiles ---- */

static void test_tile_is_cropped(void **state)
{
    const size_t n = expected(TRIANGLE, served_key(17));
    assert_true(n > 5 && n < 45); /* of 50 */
    struct response r = get_clipped("/d/toy/r/REV+/t/KEY17.ply", "", TRIANGLE);
    assert_int_equal(r.status, 200);
    assert_int_equal(ply_count(&r), n);
    response_free(&r);
    static const char *const exts[] = {"glb", "plain.glb",      "spz", "drc",
                                       "sog", "compressed.ply", "ply"};
    for (size_t i = 0; i < sizeof exts / sizeof *exts; i++) {
        char path[100], surrogate[100];
        snprintf(path, sizeof path, "/d/toy/r/REV+/t/KEY17.%s", exts[i]);
        struct response whole = get(path), part = get_clipped(path, "", TRIANGLE);
        struct response again = get_clipped(path, "v=1&", TRIANGLE);
        assert_int_equal(part.status, 200);
        assert_true(part.size < whole.size);
        assert_string_not_equal(part.etag, whole.etag);
        expect("cache", again.cache, "hit");
        expect("ETag", again.etag, part.etag);
        expect("Cache-Control", part.cache_control, IMMUTABLE);
        expect("Vary", part.vary, whole.vary);
        expect("Surrogate-Key", part.surrogate,
               expand("ds-toy rev-REV z-17", surrogate, sizeof surrogate));
        expect("Link", part.hints, "");
        response_free(&whole);
        response_free(&part);
        response_free(&again);
    }
}

/* Where it begins, which way round, closed or not, commas escaped, zeros: one tag. */
static void test_spellings(void **state)
{
    char clip[200], target[800], comma[600] = "";
    struct response first = get_clipped("/d/toy/r/REV/t/KEY17.drc", "", TRIANGLE);
    assert_int_equal(first.status, 200);
    for (int i = 0; i < 8; i++) {
        clip_text(TRIANGLE, i % 3, i & 1, clip);
        comma[0] = '\0';
        for (const char *p = clip; *p; p++)
            snprintf(comma + strlen(comma), 8, *p == ',' ? "%%2C" : "%c", *p);
        size_t end = (size_t)(strchr(strchr(clip, ',') + 1, ',') - clip);
        snprintf(target, sizeof target, "/d/toy/r/REV/t/KEY17.drc?clip=%s%s%.*s%s",
                 i > 5 ? comma : clip, i > 3 ? "," : "", i > 3 ? (int)end : 0, clip,
                 i == 5 ? "00" : "");
        struct response r = get(target);
        expect("ETag", r.etag, first.etag);
        expect("cache", r.cache, "hit");
        response_free(&r);
    }
    response_free(&first);
}

/* What lies wholly within is the tile itself: the same bytes, tag and place in the cache. */
static void test_inside_and_outside(void **state)
{
    struct response whole = get("/d/toy/r/REV/t/KEY16.spz");
    struct response all = get_clipped("/d/toy/r/REV/t/KEY16.spz", "", ALL);
    expect("ETag", all.etag, whole.etag);
    expect("cache", all.cache, "hit");
    assert_ptr_equal(all.body, whole.body);
    response_free(&whole);
    response_free(&all);
    const int empty[] = {GAP, FAR};
    for (int i = 0; i < 2; i++) {
        struct response r = get_clipped("/d/toy/r/REV/t/KEY17.glb", "", empty[i]);
        assert_int_equal(r.status, 404);
        expect("type", r.type, "application/problem+json");
        assert_true(says(&r, "no Gaussians of this tile lie within clip"));
        response_free(&r);
    }
    /* an appearance or a preset is another thing */
    struct response a = get_clipped("/d/toy/r/REV/t/KEY17.drc", "preset=preview&", TRIANGLE);
    struct response b = get_clipped("/d/toy/r/REV/t/KEY17.drc", "preset=spz&", TRIANGLE);
    assert_string_not_equal(a.etag, b.etag);
    response_free(&a);
    response_free(&b);
    struct response moved = get_clipped("/d/toy/t/KEY17.drc", "", TRIANGLE);
    assert_int_equal(moved.status, 307);
    assert_non_null(strstr(moved.location, ".drc?clip="));
    response_free(&moved);
}

/* ---- what lists tiles ---- */

struct listed {
    unsigned n_tiles, n_missing;
    bool bare; /* a node without content and without children */
};

/* Every address of a node and of those below is a tile that is there. base: of the document. */
static void walk(const json_t *node, const char *base, struct listed *l)
{
    const char *uri = json_string_value(json_object_get(json_object_get(node, "content"), "uri"));
    const json_t *children = json_object_get(node, "children");
    if (uri) {
        char target[900];
        assert_non_null(strstr(uri, "?preset=spz&clip=13."));
        snprintf(target, sizeof target, "%s%s", base, uri);
        struct response r = get(target);
        l->n_tiles++;
        l->n_missing += r.status != 200;
        response_free(&r);
    }
    l->bare = l->bare || (!uri && !json_array_size(children));
    assert_null(json_object_get(json_object_get(node, "extras"), "extent")); /* of the whole */
    for (size_t i = 0; i < json_array_size(children); i++)
        walk(json_array_get(children, i), base, l);
}

static struct listed list_of(const char *path, const char *base, int shape, const char *caching)
{
    struct listed l = {0};
    struct response r = get_clipped(path, "preset=spz&", shape);
    assert_int_equal(r.status, 200);
    expect("Cache-Control", r.cache_control, caching);
    expect("Link", r.hints, "");
    json_t *o = json_of(&r);
    walk(json_object_get(o, "root"), base, &l);
    json_decref(o);
    response_free(&r);
    return l;
}

static void test_tileset(void **state)
{
    struct key sibling = served_key(17);
    sibling.x ^= 1;
    assert_true(expected(TRIANGLE, served_key(15)) == 0 && expected(TRIANGLE, sibling) == 0);
    unsigned want = 0;
    for (uint8_t z = SERVED_ZOOM_MIN; z <= SERVED_ZOOM_MAX; z++)
        want += expected(TRIANGLE, served_key(z)) > 0;
    struct listed l = list_of("/d/toy/r/REV+/tileset.json", "/d/toy/r/REV+/", TRIANGLE, IMMUTABLE);
    assert_true(l.n_tiles == want && !l.n_missing && !l.bare);
    l = list_of("/d/toy/tileset.json", "/d/toy/", TRIANGLE, MOVING);
    assert_true(l.n_tiles == want && !l.n_missing && !l.bare);
    l = list_of("/d/toy/tileset.json", "/d/toy/", ALL, MOVING);
    assert_true(l.n_tiles == 4 && !l.n_missing && !l.bare);
    for (int shape = GAP; shape <= FAR; shape++) {
        struct response r = get_clipped("/d/toy/tileset.json", "", shape);
        assert_int_equal(r.status, 404);
        assert_true(says(&r, "nothing of this dataset lies within clip"));
        response_free(&r);
    }
}

static void test_seed(void **state)
{
    char *rest = NULL;
    size_t lines = 0;
    struct response r = get_clipped("/d/toy/seed.ndjson", "f=ply&", TRIANGLE);
    assert_int_equal(r.status, 200);
    char *text = mem_array(r.size + 1, 1);
    memcpy(text, r.data, r.size);
    for (char *p = strtok_r(text, "\n", &rest); p; p = strtok_r(NULL, "\n", &rest), lines++) {
        char target[600];
        json_t *o = json_loads(p, 0, NULL);
        snprintf(target, sizeof target, "/d/toy/%s", json_string_value(json_object_get(o, "url")));
        struct response tile = get(target);
        assert_int_equal(tile.status, 200);
        expect("etag", json_string_value(json_object_get(o, "etag")), tile.etag);
        assert_int_equal(json_integer_value(json_object_get(o, "gaussians")), ply_count(&tile));
        response_free(&tile);
        json_decref(o);
    }
    assert_true(lines >= 1 && lines < 4);
    mem_free(text);
    response_free(&r);
    r = get_clipped("/d/toy/seed.ndjson", "limit=1&", ALL); /* the next page has it as well */
    assert_true(says(&r, "{\"next\":\"r/") && says(&r, "seed.ndjson?clip=13."));
    response_free(&r);
}

/* ---- texts ---- */

static void test_bad_polygons(void **state)
{
    static const struct {
        const char *target;
        int status;
    } rows[] = {
        {"/d/toy/r/REV/t/KEY17.glb?clip=", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=1", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=1,2,3", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=1,2,3,4,", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,nan", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,inf", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,1e1", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0;1,0;0,1", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,1%00", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,1&clip=0,0,1,0,0,1", 400},
        {"/d/toy/r/REV/static/13.4,52.5,90@0,-30/64x64.png?clip=0,0,1,0,0,1", 400},
        {"/d/toy/r/REV/map/17/0/0.png?clip=0,0,1,0,0,1", 400},
        {"/d/toy/map.json?clip=0,0,1,0,0,1", 400},
        {"/d/toy/appearances?clip=0,0,1,0,0,1", 400},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0", 422},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,1", 422},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,1,0,0", 422},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,1,2,2", 422},     /* no area */
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,1,1,0,0,1", 422}, /* crosses itself */
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,181,0,0,1", 422},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,90.0000001", 422},
        {"/d/toy/r/REV/t/KEY17.glb?clip=0,0,1,0,0,-999999999", 422},
        {"/d/toy/tileset.json?clip=0,0,1,1,1,0,0,1", 422},
        {"/d/toy/seed.ndjson?clip=0,0,1,1,1,0,0,1", 422},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = get(rows[i].target);
        if (r.status != rows[i].status)
            fail_msg("%s: %d, want %d: %.*s", rows[i].target, r.status, rows[i].status, (int)r.size,
                     (const char *)r.data);
        response_free(&r);
    }
}

/* A spiral of n corners; 40 are taken and one more is not, and a closing one counts for nothing. */
static void test_many_corners(void **state)
{
    union target_any a, b;
    const struct target_clip *one = &a.of_tileset_moving.tiles.clip,
                             *other = &b.of_tileset_moving.tiles.clip;
    struct router *routes = NULL;
    char text[1400], clip[TARGET_CLIP_TEXT];
    struct err none = {0};
    kit_ok(router_open(ROUTES, ROUTES_COUNT, &routes, &none), none);
    for (int n = 38; n <= 41; n++) {
        size_t size = (size_t)snprintf(text, sizeof text, "/d/toy/tileset.json?clip=");
        for (int i = 0; i < n; i++)
            size += (size_t)snprintf(text + size, sizeof text - size, "%s%.7f,%.7f", i ? "," : "",
                                     -100 - cos(0.15 * i), -50 + sin(0.15 * i));
        struct err e = {0};
        assert_int_equal(router_read(routes, text, size, &a, &e), n <= 40 ? ERR_OK : ERR_DATA);
        if (n > 40)
            continue;
        size += (size_t)snprintf(text + size, sizeof text - size, ",-101,-50.0000000");
        kit_ok(router_read(routes, text, size, &a, &e), e);
        assert_int_equal(one->n, n);
        /* what it writes is read as the same */
        param_clip_text(one, clip);
        size = (size_t)snprintf(text, sizeof text, "/d/toy/tileset.json?clip=%s", clip);
        kit_ok(router_read(routes, text, size, &b, &e), e);
        assert_memory_equal(one, other, sizeof *one);
    }
    struct err e = {0};
    const char *least = "/d/toy/tileset.json?clip=-179.0000001,-0.5,0,-89.9999999,1.50,20";
    kit_ok(router_read(routes, least, strlen(least), &a, &e), e);
    param_clip_text(one, clip);
    assert_string_equal(clip, "-179.0000001,-0.5,0,-89.9999999,1.5,20");
    router_close(&routes);
}

/* Boxes against places: what is inside has no corner outside, and the other way round. */
static void test_boxes(void **state)
{
    static const double ring[5][2] = {
        {13.399, 52.499}, {13.402, 52.4995}, {13.4005, 52.5}, {13.401, 52.501}, {13.399, 52.5005}};
    struct clip c;
    struct err e = {0};
    size_t n[3] = {0};
    kit_ok(clip_of_ring(ring, 5, &c, &e), e);
    for (uint64_t i = 0; i < 3000; i++) {
        double low[3], high[3];
        for (uint64_t k = 0; k < 3; k++) {
            low[k] = k < 2 ? 400 * rng_unit(5, k, i) - 200 : 0;
            high[k] = low[k] + 60 * rng_unit(5, 3 + k, i);
        }
        enum crop_side side;
        kit_ok(crop_box(&c, &served_origin, low, high, &side, &e), e);
        n[side]++;
        for (uint64_t j = 0; j < 20 && side != CROP_ACROSS; j++) {
            double at[3], lon, lat, h;
            for (uint64_t k = 0; k < 3; k++)
                at[k] = low[k] + (high[k] - low[k]) * rng_unit(6, 3 * j + k, i);
            kit_ok(geo_from_enu(&served_origin, at, &lon, &lat, &h, &e), e);
            assert_int_equal(clip_holds(&c, lon, lat, h), side == CROP_INSIDE);
        }
    }
    assert_true(n[CROP_INSIDE] > 100 && n[CROP_OUTSIDE] > 100 && n[CROP_ACROSS] > 100);
    clip_free(&c);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_tile_is_cropped),
        cmocka_unit_test(test_spellings),
        cmocka_unit_test(test_inside_and_outside),
        cmocka_unit_test(test_tileset),
        cmocka_unit_test(test_seed),
        cmocka_unit_test(test_bad_polygons),
        cmocka_unit_test(test_many_corners),
        cmocka_unit_test(test_boxes),
    };
    return cmocka_run_group_tests(tests, setup_gap, teardown);
}
