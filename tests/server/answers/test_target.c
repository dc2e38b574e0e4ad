/* Request targets and conditional headers: foreign text in, integers and enums out.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/quant.h"
#include "server/answers/routes.h"
#include "server/base/condition.h"
#include "server/route/router.h"
#include "tests/kit.h"

#include <stdio.h>
#include <string.h>

/* ---- targets ---- */

static struct router *routes;

static int setup_routes(void **state)
{
    struct err e = {0};
    kit_ok(router_open(ROUTES, ROUTES_COUNT, &routes, &e), e);
    return 0;
}

static int teardown_routes(void **state)
{
    router_close(&routes);
    return 0;
}

static void test_targets(void **state)
{
    static const struct {
        const char *text;
        enum err_code code;
        const char *route; /* NULL: not looked at */
    } rows[] = {
        {"/", ERR_OK, "landing"},
        {"/?x=1", ERR_OK, "landing"},
        {"/conformance", ERR_OK, "conformance"},
        {"/api", ERR_OK, "api"},
        {"/api.html", ERR_OK, "api_page"},
        {"/collections", ERR_OK, "collections"},
        {"/collections/toy", ERR_OK, "collection"},
        {"/collections/toy/tiles.json", ERR_OK, "tilejson"},
        {"/collections/toy/map/tiles", ERR_NOENT, NULL},
        {"/collections/Toy", ERR_NOENT, NULL},
        {"/collections/-toy", ERR_NOENT, NULL},
        {"/collections/", ERR_NOENT, NULL},
        {"/d/toy/tileset.json", ERR_OK, "tileset_moving"},
        {"/d/toy/r/0123456789ab/tileset.json", ERR_OK, "tileset"},
        {"/d/toy/r/0123456789ab/appearance.json", ERR_OK, "model"},
        {"/d/toy/r/0123456789ab/appearances.json", ERR_OK, "photographs"},
        {"/d/toy/r/0123456789ab/appearances/12.jpg", ERR_OK, "thumbnail"},
        {"/d/toy/r/0123456789ab/appearances/012.jpg", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/appearances/1.png", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/appearances/1.jpg/", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/appearances/", ERR_NOENT, NULL},
        {"/d/toy/appearance.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789aB/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab-0123cdef/tileset.json", ERR_OK, "tileset"},
        {"/d/toy/r/0123456789ab-0123cdef/map/1/0/0.jpg", ERR_OK, "map"},
        {"/d/toy/r/0123456789ab-0123cde/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab-0123cdef0/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab-/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab-0123cdeF/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789a/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789abc/tileset.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/0/1.glb", ERR_OK, "tile"},
        {"/d/toy/r/0123456789ab/t/0/0/0.plain.glb", ERR_OK, "tile"},
        {"/d/toy/r/0123456789ab/t/0/0/0.sog", ERR_OK, "tile"},
        {"/d/toy/r/0123456789ab/t/0/0/0.compressed.ply", ERR_OK, "tile"},
        {"/d/toy/r/0123456789ab/t/0/0/0.compressed", ERR_NOENT, "tile"},
        {"/d/toy/r/0123456789ab/t/24/16777215/16777215.ply", ERR_OK, "tile"},
        {"/d/toy/r/0123456789ab/t/24/16777216/0.ply", ERR_NOENT, "tile"},
        {"/d/toy/r/0123456789ab/t/25/0/0.ply", ERR_NOENT, "tile"},
        {"/d/toy/r/0123456789ab/t/256/0/0.ply", ERR_NOENT, "tile"},
        {"/d/toy/r/0123456789ab/t/1/00/0.glb", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/-0/0.glb", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/4294967296/0.glb", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/0/0.gltf", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/0/0.jpg", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb/", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/t/1/0/0", ERR_NOENT, NULL},
        {"/d/toy/t/1/0/0.drc", ERR_OK, "tile_moving"},
        {"/d/toy/t/1/0/0.drc?preset=preview&sh=0", ERR_OK, "tile_moving"},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb?v=0123456789ab&x", ERR_OK, "tile"},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb?preset=", ERR_FORMAT, "tile"},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb?preset=balance", ERR_FORMAT, "tile"},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb?preset=spz&preset=spz", ERR_FORMAT, "tile"},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb?sh=4", ERR_FORMAT, "tile"},
        {"/d/toy/r/0123456789ab/t/1/0/0.glb?sh=1a", ERR_FORMAT, "tile"},
        {"/d/toy/seed.ndjson?preset=balanced&sh=2&f=drc", ERR_OK, "seed_moving"},
        {"/d/toy/seed.ndjson?preset=best", ERR_FORMAT, "seed_moving"},
        {"/d/toy/r/0123456789ab/static/13.4,52.5,120@0,-90/64x64.jpg", ERR_OK, "view"},
        {"/d/toy/static/-13.4,-52.5,-1.5@359.9,-89.25,75/640x480.webp", ERR_OK, "view_moving"},
        {"/d/toy/static/1e3,0,0@0,0/64x64.jpg", ERR_FORMAT, NULL},
        {"/d/toy/static/nan,0,0@0,0/64x64.jpg", ERR_FORMAT, NULL},
        {"/d/toy/static/.5,0,0@0,0/64x64.jpg", ERR_FORMAT, NULL},
        {"/d/toy/static/1.,0,0@0,0/64x64.jpg", ERR_FORMAT, NULL},
        {"/d/toy/static/+1,0,0@0,0/64x64.jpg", ERR_FORMAT, NULL},
        {"/d/toy/static/0,0,0@0,0/64x64.glb", ERR_FORMAT, NULL},
        {"/d/toy/static/0,0,0@0,0/64x9999999999.jpg", ERR_FORMAT, NULL},
        {"/d/toy/static/181,0,0@0,0/64x64.jpg", ERR_DATA, NULL},
        {"/d/toy/static/0,90.1,0@0,0/64x64.jpg", ERR_DATA, NULL},
        {"/d/toy/static/0,0,0@361,0/64x64.jpg", ERR_DATA, NULL},
        {"/d/toy/static/0,0,0@0,91/64x64.jpg", ERR_DATA, NULL},
        {"/d/toy/static/0,0,0@0,0,151/64x64.jpg", ERR_DATA, NULL},
        {"/d/toy/static/0,0,999999999@0,0/64x64.jpg", ERR_DATA, NULL},
        {"/d/toy/render", ERR_OK, "render"},
        {"/d/toy/seed.ndjson", ERR_OK, "seed_moving"},
        {"/d/toy/seed.ndjson?bbox=13,52,14,53&z=15-17&f=spz", ERR_OK, "seed_moving"},
        {"/d/toy/seed.ndjson?bbox=13%2C52%2c14%2C53", ERR_OK, "seed_moving"},
        {"/d/toy/seed.ndjson?bbox=13,52,14", ERR_FORMAT, "seed_moving"},
        {"/d/toy/seed.ndjson?z=17-15", ERR_FORMAT, "seed_moving"},
        {"/d/toy/seed.ndjson?z=1&z=2", ERR_FORMAT, "seed_moving"},
        {"/d/toy/seed.ndjson?lod=2", ERR_FORMAT, "seed_moving"},
        {"/d/toy/r/0123456789ab-0123cdef/seed.ndjson?limit=5&after=10", ERR_OK, "seed"},
        {"/d/toy/seed.ndjson?limit=0", ERR_FORMAT, "seed_moving"},
        {"/d/toy/seed.ndjson?limit=100001", ERR_FORMAT, "seed_moving"},
        {"/d/toy/seed.ndjson?after=-1", ERR_FORMAT, "seed_moving"},
        {"/d/toy/seed.ndjson?path=1,2,3@4,5", ERR_FORMAT, "seed_moving"},
        {"/d/toy/r/0123456789ab/tileset/3/4/5.json", ERR_OK, "tileset_part"},
        {"/d/toy/r/0123456789ab/tileset/3/4/5.json?sh=0", ERR_OK, "tileset_part"},
        {"/d/toy/r/0123456789ab/tileset/3/4/8.json", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/tileset/3/4/5.glb", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/tileset/3/4/5.json/", ERR_NOENT, NULL},
        {"/d/toy/tileset/3/4/5.json", ERR_NOENT, NULL},
        {"/d/toy", ERR_NOENT, NULL},
        {"/d/toy/", ERR_NOENT, NULL},
        {"/d/toy/r/0123456789ab/render", ERR_NOENT, NULL},
        {"/d/", ERR_NOENT, NULL},
        {"/healthz", ERR_OK, "healthz"},
        {"/readyz", ERR_OK, "readyz"},
        {"/version", ERR_OK, "version"},
        {"/metrics", ERR_OK, "metrics"},
        {"/anything.js", ERR_OK, "file"},
        /* what no path of ours holds */
        {"", ERR_FORMAT, NULL},
        {"*", ERR_FORMAT, NULL},
        {"http://host/", ERR_FORMAT, NULL},
        {"/../etc/passwd", ERR_FORMAT, NULL},
        {"/..", ERR_FORMAT, NULL},
        {"/a/../b", ERR_FORMAT, NULL},
        {"/./a", ERR_FORMAT, NULL},
        {"/.git/config", ERR_FORMAT, NULL},
        {"//etc/passwd", ERR_FORMAT, NULL},
        {"/a//b", ERR_FORMAT, NULL},
        {"/%2e%2e/etc/passwd", ERR_FORMAT, NULL},
        {"/%252e%252e/", ERR_FORMAT, NULL},
        {"/a%00b", ERR_FORMAT, NULL},
        {"/a\\b", ERR_FORMAT, NULL},
        {"/\xc0\xae\xc0\xae/", ERR_FORMAT, NULL},
        {"/a b", ERR_FORMAT, NULL},
        {"/a\tb", ERR_FORMAT, NULL},
        {"/a;b", ERR_FORMAT, NULL},
        {"/a#b", ERR_FORMAT, NULL},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct err e = {0};
        union target_any got;
        enum err_code rc = router_read(routes, rows[i].text, strlen(rows[i].text), &got, &e);
        const char *name = got.all.route ? got.all.route->name : "-";
        if (rc != rows[i].code || (!rc && strcmp(name, rows[i].route) != 0))
            fail_msg("'%s': got %s %s (%s), want %s %s", rows[i].text, kit_err(rc), name, e.msg,
                     kit_err(rows[i].code), rows[i].route ? rows[i].route : "-");
    }
}

static void test_target_unescaped(void **state)
{
    static const char *const rows[][2] = {
        {"/d/demo/map/17/68293/45802%402x.png", "/d/demo/map/17/68293/45802@2x.png"},
        {"/static/7.5%2C47.5%2c420@10,%2d45/160x120.jpg?a=%2C",
         "/static/7.5,47.5,420@10,-45/160x120.jpg?a=%2C"},
        {"/%61%2e%2e", "/a.."},
        {"/a%2Fb%00%20%25", "/a%2Fb%00%20%25"}, /* no byte of a path */
        {"/a%2", "/a%2"},
        {"/a%", "/a%"},
        {"/%%34", "/%4"},
        {"", ""},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char text[80];
        snprintf(text, sizeof text, "%s", rows[i][0]);
        assert_int_equal(router_unescape(text), strlen(rows[i][1]));
        assert_string_equal(text, rows[i][1]);
    }
}

static void test_target_numbers(void **state)
{
    struct err e = {0};
    union target_any g;
    const char *view =
        "/d/toy/r/0123456789ab/static/-13.40000004,52.12345678,-1.0005@-90,-45.5,60.25/640x480.png";
    kit_ok(router_read(routes, view, strlen(view), &g, &e), e);
    assert_int_equal(g.of_view.view.pose.lon_e7, -134000000);
    assert_int_equal(g.of_view.view.pose.lat_e7, 521234568);
    assert_int_equal(g.of_view.view.pose.h_mm, -1001);
    assert_int_equal(g.of_view.view.pose.heading_e3, 270000);
    assert_int_equal(g.of_view.view.pose.pitch_e3, -45500);
    assert_int_equal(g.of_view.view.pose.fov_e3, 60250);
    assert_int_equal(g.of_view.view.width_px, 640);
    assert_int_equal(g.of_view.view.height_px, 480);
    assert_int_equal(g.of_view.view.format, FORMAT_PNG);
    assert_string_equal(g.all.names.rev, "0123456789ab");
    const char *same = "/d/toy/static/-0,0.0,0.000@360,-0.0,60/1x1.png";
    kit_ok(router_read(routes, same, strlen(same), &g, &e), e);
    assert_int_equal(g.of_view_moving.view.pose.heading_e3, 0);
    assert_int_equal(g.of_view_moving.view.pose.fov_e3, 60000);
    const char *tile = "/d/old_town-2/r/ffffffffffff/t/17/70406/42987.spz";
    kit_ok(router_read(routes, tile, strlen(tile), &g, &e), e);
    assert_string_equal(g.all.names.ds, "old_town-2");
    assert_int_equal(g.of_tile.cell.key.z, 17);
    assert_int_equal(g.of_tile.cell.key.x, 70406);
    assert_int_equal(g.of_tile.cell.key.y, 42987);
    assert_int_equal(g.of_tile.tiles.form.format, FORMAT_SPZ);
    assert_int_equal(g.of_tile.tiles.form.preset, QUANT_PRESETS);
    assert_int_equal(g.of_tile.tiles.form.sh_degree, FORM_UNSAID);
    tile = "/d/toy/t/17/70406/42987.drc?sh=1&v=2&preset=near-lossless";
    kit_ok(router_read(routes, tile, strlen(tile), &g, &e), e);
    assert_int_equal(g.of_tile_moving.tiles.form.preset, QUANT_NEAR_LOSSLESS);
    assert_int_equal(g.of_tile_moving.tiles.form.sh_degree, 1);
    assert_int_equal(g.of_tile_moving.tiles.form.part, 0);
    tile = "/d/toy/t/17/70406/42987.drc?part=2";
    kit_ok(router_read(routes, tile, strlen(tile), &g, &e), e);
    assert_int_equal(g.of_tile_moving.tiles.form.part, 2);
    const char *seed = "/d/toy/seed.ndjson?z=16&bbox=-1.5,2,3.25,4";
    kit_ok(router_read(routes, seed, strlen(seed), &g, &e), e);
    assert_int_equal(g.of_seed_moving.zooms.z_min, 16);
    assert_int_equal(g.of_seed_moving.zooms.z_max, 16);
    assert_int_equal(g.of_seed_moving.page.bbox_e7[0], -15000000);
    assert_int_equal(g.of_seed_moving.page.bbox_e7[2], 32500000);
}

/* The same box as programs write it: by hand, as a form or URLSearchParams does, and a number with
 * all digits of a double, which documents of the server have, too. */
static void test_target_spellings(void **state)
{
    static const int32_t want[] = {-15000000, 475568840, 32500000, 480000000};
    static const char *const same[] = {
        "-1.5,47.556884,3.25,48",
        "-1.5%2C47.556884%2C3.25%2C48",
        "%2D1%2E5%2c%347.556884%2C3.25%2c48",
        "-1.5,47.5568840235976123,3.25,48.00000000000000000001",
        "-1.5,+47.556884,+3.25,%2B48",
        "-1.5%2C+47.556884%2C+3.25%2C+48", /* "-1.5, 47.556884, 3.25, 48" of a form */
    };
    static const char *const none[] = {"-1.5%2C47.556884%2C3.25",
                                       "-1.5%247.556884,3.25,48",
                                       "-1.5%2C47.556884%2C3.25%2C48%2",
                                       "-1.5%2C47.556884%2C3.25%2C4%00",
                                       "--1.5,47,3,48",
                                       "+-1.5,47,3,48"};
    static const char *const lists[] = {"/collections?bbox=", "/d/toy/seed.ndjson?bbox="};
    for (size_t k = 0; k < sizeof lists / sizeof *lists; k++) {
        char text[200];
        union target_any g;
        for (size_t i = 0; i < sizeof same / sizeof *same; i++) {
            struct err e = {0};
            snprintf(text, sizeof text, "%s%s", lists[k], same[i]);
            if (router_read(routes, text, strlen(text), &g, &e) ||
                memcmp(k ? g.of_seed_moving.page.bbox_e7 : g.of_collections.box.bbox_e7, want,
                       sizeof want) != 0)
                fail_msg("'%s': %s", text, e.msg[0] ? e.msg : "another box");
        }
        for (size_t i = 0; i < sizeof none / sizeof *none; i++) {
            snprintf(text, sizeof text, "%s%s", lists[k], none[i]);
            if (router_read(routes, text, strlen(text), &g, NULL) != ERR_FORMAT)
                fail_msg("'%s' is read", text);
        }
    }
    struct err e = {0};
    union target_any g;
    const char *place = "/d/toy/height?lon=%2D7%2E5&lat=+47.5&gsd_m=0%2E25";
    kit_ok(router_read(routes, place, strlen(place), &g, &e), e);
    assert_int_equal(g.of_height.place.lon_e7, -75000000);
    assert_int_equal(g.of_height.place.lat_e7, 475000000);
    assert_int_equal(g.of_height.place.gsd_mm, 250);
    const char *tile =
        "/d/toy/t/17/70406/42987.drc?sh=%31&preset=near%2Dlossless&clip=1%2C2%2C3%2C2%2C2%2C4";
    kit_ok(router_read(routes, tile, strlen(tile), &g, &e), e);
    assert_int_equal(g.of_tile_moving.tiles.form.preset, QUANT_NEAR_LOSSLESS);
    assert_int_equal(g.of_tile_moving.tiles.form.sh_degree, 1);
    assert_int_equal(g.of_tile_moving.tiles.clip.n, 3);
}

/* Any bytes: no crash, no reading past the end (the copy is exactly as long as the text). */
static void test_target_any_bytes(void **state)
{
    static const char *const words[] = {
        "/d/", "toy",       "/r/", "0123456789ab", "/t/", "/static/", "1", "-",  ".",     ",",
        "@",   "x",         "/",   "glb",          "%",   "\xff",     "?", "z=", "bbox=", "&",
        "f=",  "999999999", "0",   "render"};
    for (uint64_t i = 0; i < 20000; i++) {
        char text[400] = "";
        size_t n = 0, m = 1 + rng_u64(9, 0, i) % 14;
        for (size_t k = 0; k < m; k++) {
            const char *w = words[rng_u64(9, k + 1, i) % (sizeof words / sizeof *words)];
            memcpy(text + n, w, strlen(w));
            n += strlen(w);
        }
        char *exact = mem_array(n, 1);
        union target_any g;
        memcpy(exact, text, n);
        enum err_code rc = router_read(routes, exact, n, &g, NULL);
        assert_true(!rc || rc == ERR_FORMAT || rc == ERR_NOENT || rc == ERR_DATA);
        assert_true(rc || g.all.route);
        mem_free(exact);
    }
}

static void test_conditions(void **state)
{
    static const struct {
        const char *header, *etag;
        bool match;
    } tags[] = {
        {NULL, "\"a\"", false},
        {"\"a\"", "\"a\"", true},
        {"W/\"a\"", "\"a\"", true},
        {"\"b\", \"a\"", "\"a\"", true},
        {"\"b\" ,W/\"a\" ", "\"a\"", true},
        {"*", "\"a\"", true},
        {"\"b\"", "\"a\"", false},
        {"a", "\"a\"", false},
        {"\"a", "\"a\"", false},
        {"\"aa\"", "\"a\"", false},
        {"\"x,y\", \"a\"", "\"a\"", true},
        {"", "\"a\"", false},
        {"*, \"b\"", "\"a\"", false},
        {"\"b\"\"a\"", "\"a\"", false},
        {",\"a\"", "\"a\"", true},
        {", ,\"b\",,W/\"a\"", "\"a\"", true},
    };
    static const struct {
        const char *header;
        uint64_t size;
        enum condition_range want;
        uint64_t first, length;
    } ranges[] = {
        {NULL, 100, RANGE_ALL, 0, 100},
        {"bytes=0-9", 100, RANGE_PART, 0, 10},
        {"bytes=90-", 100, RANGE_PART, 90, 10},
        {"bytes=-10", 100, RANGE_PART, 90, 10},
        {"bytes=-1000", 100, RANGE_PART, 0, 100},
        {"bytes=99-200", 100, RANGE_PART, 99, 1},
        {"bytes=100-", 100, RANGE_BAD, 0, 0},
        {"bytes=-0", 100, RANGE_BAD, 0, 0},
        {"bytes=0-", 0, RANGE_BAD, 0, 0},
        {"bytes=5-4", 100, RANGE_ALL, 0, 100},
        {"bytes=0-1,5-6", 100, RANGE_ALL, 0, 100},
        {"bytes=", 100, RANGE_ALL, 0, 100},
        {"bytes=-", 100, RANGE_ALL, 0, 100},
        {"bytes=a-b", 100, RANGE_ALL, 0, 100},
        {"items=0-1", 100, RANGE_ALL, 0, 100},
        {"Bytes= 1-2 ", 100, RANGE_PART, 1, 2},
        {"bytes=0-18446744073709551616", 100, RANGE_PART, 0, 100},
        {"bytes=18446744073709551616-", 100, RANGE_BAD, 0, 0},
    };
    static const struct {
        const char *header;
        bool gzip, brotli;
    } codings[] = {
        {NULL, false, false},
        {"gzip", true, false},
        {"GZIP", true, false},
        {"br, gzip;q=0.5", true, true},
        {"br;q=0.5, gzip", true, false},
        {"gzip, deflate, br, zstd", true, true},
        {"br;q=0, gzip", true, false},
        {"br", false, true},
        {"gzip;q=0", false, false},
        {"gzip; q=0.000", false, false},
        {"*", true, true},
        {"*;q=0", false, false},
        {"*;q=0.5, gzip;q=0.8", true, false},
        {"gzip;q=0, *", false, true},
        {"identity", false, false},
        {"xgzip", false, false},
        {"gzip;q=1.0", true, false},
        {"", false, false},
        {",,gzip", true, false},
        {"gzip;q=0.001", true, false},
    };
    static const struct {
        const char *header;
        bool html;
    } accepts[] = {
        {NULL, false},
        {"*/*", false},
        {"text/html", true},
        {"text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", true},
        {"application/json", false},
        {"text/html;q=0.5, application/json", false},
        {"text/html;q=0", false},
        {"application/json;q=0.1, text/html;q=0.2", true},
    };
    for (size_t i = 0; i < sizeof tags / sizeof *tags; i++)
        if (condition_none_match(tags[i].header, tags[i].etag) != tags[i].match)
            fail_msg("If-None-Match: %s", tags[i].header);
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++) {
        uint64_t first, length;
        enum condition_range got =
            condition_range(ranges[i].header, ranges[i].size, &first, &length);
        if (got != ranges[i].want ||
            (got != RANGE_BAD && (first != ranges[i].first || length != ranges[i].length)))
            fail_msg("Range: %s of %d: got %d %d+%d", ranges[i].header, (int)ranges[i].size, got,
                     (int)first, (int)length);
    }
    for (size_t i = 0; i < sizeof codings / sizeof *codings; i++)
        if (condition_gzip(codings[i].header) != codings[i].gzip ||
            condition_brotli(codings[i].header) != codings[i].brotli)
            fail_msg("Accept-Encoding: %s", codings[i].header);
    for (size_t i = 0; i < sizeof accepts / sizeof *accepts; i++)
        if (condition_html(accepts[i].header) != accepts[i].html)
            fail_msg("Accept: %s", accepts[i].header);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_targets),          cmocka_unit_test(test_target_unescaped),
        cmocka_unit_test(test_target_numbers),   cmocka_unit_test(test_target_spellings),
        cmocka_unit_test(test_target_any_bytes), cmocka_unit_test(test_conditions),
    };
    return cmocka_run_group_tests(tests, setup_routes, teardown_routes);
}
