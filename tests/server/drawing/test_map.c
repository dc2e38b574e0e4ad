/* Map and terrain tiles over HTTP: their content against the procedural city, caching, places
 * without tiles, and their documents as xmllint and GDAL read them. It is one long file, because
 * all of it asks one server that draws one survey.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access/auth.h"
#include "tests/server/client.h"
#include "tests/survey/survey_kit.h"

#include <jansson.h>
#include <sys/stat.h>

#include "codec/image/image.h"
#include "core/device/dev.h"
#include "lod/export/clip.h"
#include "lod/surface/raster.h"
#include "server/answers/dispatch.h"
#include "server/answers/services.h"
#include "server/base/body.h"
#include "server/documents/map_document.h"
#include "server/drawing/map_tile.h"

static const char IMMUTABLE[] = "public, max-age=31536000, immutable";
static uint8_t zoom;     /* of most tests: pixels of 0.19 m */
static struct key there; /* a tile in the middle of the city */

static int map_setup_all(void **state)
{
    struct err e = {0};
    log_set_level(LOG_ERROR);
    survey_make(NULL);
    survey_open();
    zoom = (uint8_t)(raster_zoom_max(nadir_area(f.nadir)) - 2);
    there = key_at(origin.lon_deg + 1e-5, origin.lat_deg + 1e-5, zoom);
    kit_ok(file_join(t.dir, f.dir, "web", &e), e);
    snprintf(t.path, sizeof t.path, "%s", f.path);
    t.paths[0] = t.path;
    return 0;
}

static int map_teardown_all(void **state)
{
    survey_drop();
    return 0;
}

static const char *map_target(const char *what, struct key k, const char *rest, char out[256])
{
    snprintf(out, 256, "/d/survey/r/%s/%s/%u/%u/%u%s", revision_of(EDITION_PICTURES), what, k.z,
             k.x, k.y, rest);
    return out;
}

static void needs_gdal(const char *program)
{
    struct buf out = {0};
    bool found = kit_run(&out, "command -v %s", program) == 0;
    buf_free(&out);
    if (found)
        return;
    print_message("skipped: no %s (Debian's package gdal-bin has it)\n", program);
    skip();
}

/* prefix: what stands before each path; "" where the survey is public. */
static bool start_drawing_below(const char *prefix)
{
    if (!t.server)
        t.cfg.deadline_s = 60; /* on a busy machine a question takes longer than people wait */
    if (!start_with_device())
        return false;
    char tile[256], target[900]; /* tags are those of the device, known once one was drawn */
    snprintf(target, sizeof target, "%s%s", prefix,
             map_target("terrain", key_at(0, 0, 5), ".png", tile));
    assert_int_equal(status_of("GET", target, ""), 200);
    return true;
}

static bool start_drawing(void)
{
    return start_drawing_below("");
}

/* Body -> a file -> pixels as OpenImageIO reads them. */
static void read_picture(const struct reply *r, const char *name, struct image *img)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, f.dir, name, &e), e);
    kit_ok(file_write(path, r->body, r->body_size, &e), e);
    kit_ok(image_read(path, NULL, img, &e), e);
}

static void fetch_picture(const char *target, const char *type, const char *name, struct image *img)
{
    struct reply r;
    ask("GET", target, "", &r);
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.body_size, (const char *)r.body);
    assert_string_equal(header(&r, "Content-Type"), type);
    assert_string_equal(header(&r, "Cache-Control"), strstr(target, "/signed/")
                                                         ? "private, max-age=31536000, immutable"
                                                         : IMMUTABLE);
    read_picture(&r, name, img);
    buf_free(&r.raw);
}

/* ENU of a pixel of a tile. */
static void pixel_enu(struct key k, uint32_t size, uint32_t x, uint32_t y, double enu[3])
{
    struct err e = {0};
    double n = pow(2, k.z), u = (k.x + (x + 0.5) / size) / n, v = (k.y + (y + 0.5) / size) / n;
    kit_ok(geo_to_enu(&origin, 360 * u - 180,
                      360 / SURVEY_PI * atan(exp(SURVEY_PI * (1 - 2 * v))) - 90, origin.h_m, enu,
                      &e),
           e);
}

/* Of all formats and both sizes: red grows to the east and green to the north, to a pixel. */
static void tiles_show_the_city(void **state)
{
    static const struct {
        const char *rest, *type, *name;
        uint32_t size;
    } kinds[] = {{".png", "image/png", "a.png", 256},
                 {".webp", "image/webp", "a.webp", 256},
                 {".jpg", "image/jpeg", "a.jpg", 256},
                 {"@2x.png", "image/png", "b.png", 512}};
    char target[256];
    if (!start_drawing())
        skip();
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        struct image img;
        struct shown sum = {0};
        size_t n = 0;
        fetch_picture(map_target("map", there, kinds[i].rest, target), kinds[i].type, kinds[i].name,
                      &img);
        assert_int_equal(img.width_px, kinds[i].size);
        assert_int_equal(img.height_px, kinds[i].size);
        for (uint32_t y = 0; y < img.height_px; y++)
            for (uint32_t x = 0; x < img.width_px; x++) {
                double enu[3];
                pixel_enu(there, img.width_px, x, y, enu);
                if (fabs(enu[0]) > 28 || fabs(enu[1]) > 28)
                    continue;
                const uint8_t *px = img.px + 3 * ((size_t)y * img.width_px + x);
                shown_add(&sum, px[0], px[1], enu);
                n++;
            }
        assert_true(n > 20000);
        printf("map %s: shift %.3f east %.3f north m\n", kinds[i].rest, shown_shift(&sum, 0),
               shown_shift(&sum, 1));
        for (size_t k = 0; k < 2; k++)
            assert_true(fabs(shown_shift(&sum, k)) < 0.2); /* metres */
        image_free(&img);
    }
}

static double decode(const uint8_t *px, bool terrarium)
{
    return terrarium ? px[0] * 256.0 + px[1] + px[2] / 256.0 - 32768
                     : -10000 + 0.1 * (65536 * px[0] + 256 * px[1] + px[2]);
}

static void terrain_is_the_citys(void **state)
{
    char target[256];
    if (!start_drawing())
        skip();
    for (int terrarium = 0; terrarium < 2; terrarium++) {
        struct image img;
        size_t n = 0, off = 0;
        fetch_picture(
            map_target("terrain", there, terrarium ? ".png?encoding=terrarium" : ".png", target),
            "image/png", "t.png", &img);
        for (uint32_t y = 0; y < 256; y += 4)
            for (uint32_t x = 0; x < 256; x += 4) {
                double enu[3];
                pixel_enu(there, 256, x, y, enu);
                if (fabs(enu[0]) > 28 || fabs(enu[1]) > 28)
                    continue;
                if (!level_at(enu[0], enu[1], 0.5))
                    continue;
                n++;
                off += fabs(decode(img.px + 3 * (256 * y + x), terrarium) - origin.h_m -
                            truth_z(enu[0], enu[1])) > 0.3;
            }
        printf("terrain %s: %zu of %zu heights beyond 0.3 m\n", terrarium ? "terrarium" : "mapbox",
               off, n);
        assert_true(n > 700 && off < n / 50);
        image_free(&img);
    }
}

/* Far from the survey: a map tile is nothing, a terrain tile is flat, and all of these are one. */
static void outside_is_empty(void **state)
{
    struct reply r;
    struct image img;
    char target[256], etag[64];
    struct key far = key_at(9.5, 50.5, zoom), farther = key_at(2, 48, 12);
    if (!start_drawing())
        skip();
    ask("GET", map_target("map", far, ".png", target), "", &r);
    assert_int_equal(r.status, 204);
    assert_string_equal(header(&r, "Cache-Control"), IMMUTABLE);
    buf_free(&r.raw);
    ask("GET", map_target("terrain", far, ".png", target), "", &r);
    assert_int_equal(r.status, 200);
    snprintf(etag, sizeof etag, "%s", header(&r, "ETag"));
    read_picture(&r, "far.png", &img);
    buf_free(&r.raw);
    for (size_t i = 0; i < 256 * 256; i++)
        assert_true(fabs(decode(img.px + 3 * i, false) -
                         (double)raster_base_m(nadir_area(f.nadir))) < 0.051);
    image_free(&img);
    ask("GET", map_target("terrain", farther, ".png", target), "", &r);
    assert_string_equal(header(&r, "ETag"), etag);
    buf_free(&r.raw);
    /* At the border: transparent in PNG, white in JPEG. */
    const struct area *a = nadir_area(f.nadir);
    struct key edge = key_at(a->west_deg, a->north_deg, (uint8_t)(zoom - 3));
    ask("GET", map_target("map", edge, ".jpg", target), "", &r);
    read_picture(&r, "edge.jpg", &img);
    buf_free(&r.raw);
    assert_true(img.px[0] > 250 && img.px[1] > 250 && img.px[2] > 250);
    image_free(&img);
    ask("GET", map_target("map", edge, ".png", target), "", &r);
    read_picture(&r, "edge.png", &img); /* alpha is dropped: what it hides is black */
    buf_free(&r.raw);
    assert_int_equal(img.px[0] + img.px[1] + img.px[2], 0);
    image_free(&img);
    struct buf out = {0};
    needs_gdal("gdalinfo");
    assert_int_equal(kit_run(&out, "gdalinfo '%s/edge.png'", f.dir), 0);
    kit_expect_text((const char *)out.data, "ColorInterp=Alpha", __FILE__, __LINE__);
    buf_free(&out);
}

/* A tile that touches no ground of the survey, with a margin that does: `far` of its edges away. */
static bool find_beside(double far, struct key *out)
{
    const struct area *a = nadir_area(f.nadir);
    double mid[2] = {0.5 * (a->west_deg + a->east_deg), 0.5 * (a->south_deg + a->north_deg)};
    for (uint8_t z = 8; z <= raster_zoom_max(a) + RASTER_ZOOM_OVER && z <= KEY_ZOOM_MAX; z++)
        for (int side = 0; side < 4; side++) {
            struct key k = key_at(side == 0   ? a->west_deg
                                  : side == 1 ? a->east_deg
                                              : mid[0],
                                  side == 2   ? a->north_deg
                                  : side == 3 ? a->south_deg
                                              : mid[1],
                                  z);
            k.x += side == 1 ? 1 : side == 0 ? UINT32_MAX : 0;
            k.y += side == 3 ? 1 : side == 2 ? UINT32_MAX : 0;
            *out = k;
            if (!area_touches(a, k) && area_is_near(a, k, far))
                return true;
        }
    return false;
}

/* Holes of such a tile are filled from the survey, so it is no flat one. */
static void beside_the_survey_is_not_flat(void **state)
{
    struct reply r;
    struct key k = {0}, far = key_at(2, 48, 12);
    struct area a = *nadir_area(f.nadir);
    char target[256], etag[64];
    double west, south, east, north;
    key_bounds(far, &west, &south, &east, &north);
    struct map_tile tile = {.key = far, .size_px = 256, .encoding = ENCODING_MAPBOX};
    const struct {
        double away; /* edges of the tile */
        uint32_t size_px;
        bool flat;
    } rows[] = {{-0.1, 256, false}, {0.05, 256, false}, {0.05, 512, true},
                {0.02, 512, false}, {0.07, 256, true},  {1.01, 256, true}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        a.west_deg = east + rows[i].away * (east - west);
        a.east_deg = a.west_deg + 1;
        a.south_deg = south;
        a.north_deg = north;
        tile.size_px = rows[i].size_px;
        assert_int_equal(map_tile_is_flat(&a, &tile), rows[i].flat);
        tile.encoding = ENCODING_UNSAID; /* colours */
        assert_false(map_tile_is_flat(&a, &tile));
        tile.encoding = ENCODING_MAPBOX;
    }
    if (!start_drawing())
        skip();
    assert_true(find_beside((double)MAP_TILE_REACH_PX / 256, &k));
    ask("GET", map_target("terrain", far, ".png", target), "", &r);
    snprintf(etag, sizeof etag, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    ask("GET", map_target("terrain", k, ".png", target), "", &r);
    assert_int_equal(r.status, 200);
    assert_string_not_equal(header(&r, "ETag"), etag);
    buf_free(&r.raw);
}

static void tiles_are_cached(void **state)
{
    struct reply r;
    char target[256], line[128], want[256];
    if (!start_drawing())
        skip();
    ask("GET", map_target("map", there, ".webp", target), "", &r);
    assert_int_equal(r.status, 200);
    snprintf(line, sizeof line, "If-None-Match: %s\r\n", header(&r, "ETag"));
    assert_true(strlen(line) > 20);
    snprintf(want, sizeof want, "ds-survey rev-%s map", t.rev);
    assert_string_equal(header(&r, "Surrogate-Key"), want);
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", target, line), 304);
    /* without a revision: to the current one, with the query */
    snprintf(target, sizeof target, "/d/survey/terrain/%u/%u/%u.png?encoding=terrarium", there.z,
             there.x, there.y);
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 307);
    snprintf(want, sizeof want, "../../../r/%s/terrain/%u/%u/%u.png?encoding=terrarium",
             revision_of(EDITION_PICTURES), there.z, there.x, there.y);
    assert_string_equal(header(&r, "Location"), want);
    buf_free(&r.raw);
    snprintf(target, sizeof target, "/d/survey/map/%u/%u/%u@2x.jpg", there.z, there.x, there.y);
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 307);
    snprintf(want, sizeof want, "../../../r/%s/map/%u/%u/%u@2x.jpg", revision_of(EDITION_PICTURES),
             there.z, there.x, there.y);
    assert_string_equal(header(&r, "Location"), want);
    buf_free(&r.raw);
}

static void nonsense_is_refused(void **state)
{
    char target[256];
    struct key deep = key_at(origin.lon_deg, origin.lat_deg, KEY_ZOOM_MAX), none = {3, 8, 0};
    if (!start_drawing())
        skip();
    const struct {
        const char *what, *rest;
        struct key k;
        int status;
    } cases[] = {
        {"map", ".png", deep, 404},
        {"map", ".png", none, 404},
        {"map", ".gif", there, 404},
        {"map", "", there, 404},
        {"map", "@3x.png", there, 404},
        {"terrain", ".webp", there, 404},
        {"map", ".png?appearance=noon", there, 404},
        {"terrain", ".png?encoding=feet", there, 400},
        {"terrain", ".png?encoding=mapbox&encoding=mapbox", there, 400},
        {"terrain", ".png?encoding=mapboxx", there, 400},
        {"map", ".png?encoding=feet&v=7", there, 200},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        int got =
            status_of("GET", map_target(cases[i].what, cases[i].k, cases[i].rest, target), "");
        if (got != cases[i].status)
            fail_msg("%s: %d, want %d", target, got, cases[i].status);
    }
    assert_int_equal(status_of("POST", map_target("map", there, ".png", target), ""), 405);
}

static json_t *document(const char *target)
{
    struct reply r;
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 200);
    json_t *o = json_loadb((const char *)r.body, r.body_size, 0, NULL);
    assert_non_null(o);
    buf_free(&r.raw);
    return o;
}

static void tilejson_leads_to_tiles(void **state)
{
    const struct area *a = nadir_area(f.nadir);
    char want[256];
    start(); /* without a device: documents do not need one */
    json_t *o = document("/d/survey/map.json");
    assert_string_equal(json_string_value(json_object_get(o, "tilejson")), "3.0.0");
    snprintf(want, sizeof want, "http://localhost/d/survey/r/%s/map/{z}/{x}/{y}.webp", t.rev);
    assert_string_equal(json_string_value(json_array_get(json_object_get(o, "tiles"), 0)), want);
    assert_int_equal(json_integer_value(json_object_get(o, "maxzoom")), raster_zoom_max(a));
    assert_int_equal(json_integer_value(json_object_get(o, "minzoom")), raster_zoom_min(a));
    assert_true(fabs(json_number_value(json_array_get(json_object_get(o, "bounds"), 2)) -
                     a->east_deg) < 1e-9);
    json_decref(o);
    o = document("/d/survey/terrain.json?encoding=terrarium");
    snprintf(want, sizeof want,
             "http://localhost/d/survey/r/%s/terrain/{z}/{x}/{y}.png?encoding=terrarium", t.rev);
    assert_string_equal(json_string_value(json_array_get(json_object_get(o, "tiles"), 0)), want);
    assert_string_equal(json_string_value(json_object_get(o, "encoding")), "terrarium");
    json_decref(o);
    assert_int_equal(status_of("GET", "/d/survey/map.json?appearance=noon", ""), 404);
    o = document("/collections/survey");
    char *dump = json_dumps(o, JSON_COMPACT);
    for (int i = 0; i < 4; i++) {
        static const char *const links[] = {"../d/survey/map.json", "../d/survey/terrain.json",
                                            "../d/survey/style.json", "../d/survey/wmts.xml"};
        assert_non_null(strstr(dump, links[i]));
    }
    free(dump);
    json_decref(o);
    char target[256]; /* and without a device tiles say so */
    assert_int_equal(status_of("GET", map_target("map", there, ".png", target), ""), 503);
    server_stop(&t.server);
    t.cfg.public_url = "https://maps.example/city/";
    start();
    o = document("/d/survey/map.json");
    snprintf(want, sizeof want, "https://maps.example/city/d/survey/r/%s/map/{z}/{x}/{y}.webp",
             t.rev);
    assert_string_equal(json_string_value(json_array_get(json_object_get(o, "tiles"), 0)), want);
    json_decref(o);
}

/* A style names the tiles that TileJSON names, and looks at the middle of the survey from where it
 * is 480 of 512 * 2^zoom pixels. */
static void style_leads_to_tiles(void **state)
{
    const struct area *a = nadir_area(f.nadir);
    char want[256];
    start();
    json_t *o = document("/d/survey/style.json"), *center = json_object_get(o, "center");
    const char *source, *kind;
    json_t *sources = json_object_get(o, "sources");
    static const char *const names[] = {"city", "terrain", "hillshade"};
    assert_int_equal(json_integer_value(json_object_get(o, "version")), 8);
    for (size_t i = 0; i < 3; i++) {
        const json_t *one = json_object_get(sources, names[i]);
        snprintf(want, sizeof want, "http://localhost/d/survey/r/%s/%s/{z}/{x}/{y}.%s", t.rev,
                 i ? "terrain" : "map", i ? "png?ground=true" : "webp");
        source = json_string_value(json_array_get(json_object_get(one, "tiles"), 0));
        assert_string_equal(source, want);
        kind = json_string_value(json_object_get(one, "type"));
        assert_string_equal(kind, i ? "raster-dem" : "raster");
        assert_int_equal(json_integer_value(json_object_get(one, "maxzoom")),
                         i ? raster_ground_zoom(a) : raster_zoom_max(a));
        assert_int_equal(json_integer_value(json_object_get(one, "tileSize")), RASTER_PX);
        assert_true(!json_object_get(one, "bounds") == (i > 0));
    }
    const json_t *coarse = json_object_get(sources, "coarse");
    assert_int_equal(json_integer_value(json_object_get(coarse, "maxzoom")),
                     raster_zoom_min(a) + 2);
    const json_t *layers = json_object_get(o, "layers");
    for (size_t i = 1; i < 3; i++) /* above the background, and below what is finer */
        assert_string_equal(json_string_value(json_object_get(json_array_get(layers, i), "source")),
                            i == 1 ? "coarse" : "city");
    assert_true(fabs(json_number_value(json_array_get(center, 1)) -
                     0.5 * (a->south_deg + a->north_deg)) < 1e-9);
    double low[2], high[2];
    key_place(a->west_deg, a->north_deg, low);
    key_place(a->east_deg, a->south_deg, high);
    const double edge = fmax(high[0] - low[0], high[1] - low[1]),
                 px = 512 * edge * exp2(json_number_value(json_object_get(o, "zoom")));
    assert_true(fabs(px - 480) < 1e-6);
    json_decref(o);
    assert_int_equal(status_of("GET", "/d/survey/style.json?appearance=noon", ""), 404);
}

/* The survey becomes private; out is what stands before each path of a signed address. */
static void make_private(char out[300])
{
    static const char text[] = "{\"keys\": {\"k\": \"0123456789abcdef0123456789abcdef\"}}";
    static char path[FILE_PATH_MAX];
    const int64_t now_s = (int64_t)time(NULL);
    char seal[AUTH_SEAL_MAX];
    struct err e = {0};
    struct auth *a = NULL;
    kit_ok(file_join(path, f.dir, "auth.jsonc", &e), e);
    kit_ok(file_write(path, text, sizeof text - 1, &e), e);
    assert_int_equal(chmod(path, 0600), 0);
    kit_ok(auth_open(path, &a, &e), e);
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "survey", now_s + 3600, now_s, seal, &e), e);
    auth_close(&a);
    t.cfg.auth = path;
    snprintf(out, 300, "/signed/%s", seal);
}

/* GDAL goes all the way: capabilities, tiles, pixels; and by the address of the tiles alone. */
static void gdal_opens_the_map(void **state)
{
    struct buf out = {0};
    struct err e = {0};
    struct reply r;
    char path[FILE_PATH_MAX], prefix[300], target[900];
    needs_gdal("gdal_translate");
    make_private(prefix);
    if (!start_drawing_below(prefix))
        skip();
    assert_int_equal(status_of("GET", "/d/survey/wmts.xml", ""), 401);
    snprintf(target, sizeof target, "%s/d/survey/wmts.xml", prefix);
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Content-Type"), "application/xml");
    kit_ok(file_join(path, f.dir, "wmts.xml", &e), e);
    kit_ok(file_write(path, r.body, r.body_size, &e), e);
    buf_free(&r.raw);
    assert_int_equal(kit_run(&out, "xmllint --noout '%s'", path), 0);
    buf_free(&out);
    struct buf xyz = {0}; /* the same pixels by both ways */
    double n = pow(2, there.z), edge = 2 * 20037508.342789244 / n,
           west = -20037508.342789244 + there.x * edge, north = 20037508.342789244 - there.y * edge;
    if (kit_run(&out,
                "cd '%s' && gdal_translate -q -of PNG -projwin %.6f %.6f %.6f %.6f "
                "-outsize 256 256 'WMTS:http://127.0.0.1:%u%s/d/survey/wmts.xml' w.png",
                f.dir, west, north, west + edge, north - edge, t.port, prefix))
        fail_msg("%s", (const char *)out.data);
    buf_free(&out);
    buf_printf(&xyz,
               "<GDAL_WMS><Service name=\"TMS\"><ServerUrl>http://127.0.0.1:%u%s/d/survey/r/%s/map/"
               "${z}/${x}/${y}.png</ServerUrl></Service><DataWindow><UpperLeftX>-20037508.342789244"
               "</UpperLeftX><UpperLeftY>20037508.342789244</UpperLeftY><LowerRightX>"
               "20037508.342789244</LowerRightX><LowerRightY>-20037508.342789244</LowerRightY>"
               "<TileLevel>%u</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>"
               "<YOrigin>top</YOrigin></DataWindow><Projection>EPSG:3857</Projection>"
               "<BandsCount>4</BandsCount><BlockSizeX>256</BlockSizeX><BlockSizeY>256</"
               "BlockSizeY></GDAL_WMS>",
               t.port, prefix, t.rev, there.z);
    kit_ok(file_join(path, f.dir, "xyz.xml", &e), e);
    kit_ok(file_write(path, xyz.data, xyz.size, &e), e);
    buf_free(&xyz);
    if (kit_run(&out,
                "cd '%s' && gdal_translate -q -of PNG -projwin %.6f %.6f %.6f %.6f xyz.xml x.png",
                f.dir, west, north, west + edge, north - edge))
        fail_msg("%s", (const char *)out.data);
    buf_free(&out);
    struct image img, same, own;
    char tile[256];
    kit_ok(file_join(path, f.dir, "w.png", &e), e);
    kit_ok(image_read(path, NULL, &img, &e), e);
    kit_ok(file_join(path, f.dir, "x.png", &e), e);
    kit_ok(image_read(path, NULL, &same, &e), e);
    snprintf(target, sizeof target, "%s%s", prefix, map_target("map", there, ".png", tile));
    fetch_picture(target, "image/png", "own.png", &own);
    assert_int_equal(same.width_px, 256);
    assert_memory_equal(own.px, same.px, 256 * 256 * 3);
    size_t off = 0;
    for (size_t i = 0; i < 256 * 256 * 3; i++)
        off += abs(own.px[i] - img.px[i]) > 3;
    assert_true(off < 256 * 256 * 3 / 50);
    image_free(&img);
    image_free(&same);
    image_free(&own);
}

static const char *href_of(const json_t *o, const char *rel)
{
    size_t i;
    json_t *link;
    json_array_foreach(json_object_get(o, "links"), i, link)
    {
        if (!strcmp(json_string_value(json_object_get(link, "rel")), rel))
            return json_string_value(json_object_get(link, "href"));
    }
    fail_msg("no link %s", rel);
    return NULL;
}

/* What a request names as its host is in no link. */
static void collections_have_boxes_and_themselves(void **state)
{
    static const char *const bases[] = {NULL, "/splats/", "https://maps.example/city/"};
    for (size_t i = 0; i < 3; i++) {
        char want[256];
        t.cfg.base_path = i == 1 ? "/splats" : "";
        t.cfg.public_url = i == 2 ? bases[i] : "";
        start();
        json_t *o = document("/collections/survey"),
               *box = json_object_get(json_object_get(o, "extent"), "spatial");
        assert_int_equal(json_array_size(json_array_get(json_object_get(box, "bbox"), 0)), 4);
        box = json_object_get(json_object_get(o, "contentExtent"), "spatial");
        assert_int_equal(json_array_size(json_array_get(json_object_get(box, "bbox"), 0)), 6);
        snprintf(want, sizeof want, "%scollections/survey", i == 2 ? bases[i] : "../");
        assert_string_equal(href_of(o, "self"), want);
        json_decref(o);
        server_stop(&t.server);
    }
    start();
}

/* The address that clients see is the one that they ask. Behind a proxy that is not trusted, a
 * server that listens on every address does not know it. */
static void wmts_needs_an_address(void **state)
{
    struct reply r;
    t.cfg.address = "0.0.0.0";
    start();
    ask("GET", "/d/survey/wmts.xml", "", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "\"http://localhost/d/survey/r/"));
    assert_non_null(strstr(header(&r, "Vary"), "Host"));
    buf_free(&r.raw);
    ask("GET", "/d/survey/wmts.xml", "Via: 1.1 proxy\r\n", &r);
    assert_int_equal(r.status, 404);
    assert_non_null(strstr((const char *)r.body, "--public-url"));
    buf_free(&r.raw);
}

static void wmts_names_itself(void **state)
{
    struct err e = {0};
    struct body *b = NULL;
    const struct dataset *d;
    start();
    struct catalog *c = services_catalog(server_services(t.server));
    d = catalog_find(c, "survey", "");
    kit_ok(map_document_wmts(d, "", "a b", "https://maps.example", &b, &e), e);
    assert_non_null(strstr((const char *)b->data,
                           "https://maps.example/d/survey/wmts.xml?appearance=a%20b\"/>"));
    body_drop(&b);
    catalog_drop(&c);
}

static int post(const char *path, const char *body, struct reply *r)
{
    char target[128];
    snprintf(target, sizeof target, "/d/survey/%s", path);
    return post_text(target, body, r);
}

static void nobody_is_woken(struct job_waiter *w)
{
    (void)w;
    fail_msg("who has left is woken");
}

/* A question of 256 pictures, whose client goes after the first. */
static void questions_end_with_their_client(void **state)
{
    struct job_stats st = {0};
    struct job_waiter waiter = {.wake = nobody_is_woken};
    if (!start_drawing())
        skip();
    struct services *s = server_services(t.server);
    struct buf body = {0};
    buf_printf(&body, "{\"gsd_m\":0.001,\"places\":[");
    for (int i = 0; i < 256; i++)
        buf_printf(&body, "%s[%.7f,%.7f]", i ? "," : "", origin.lon_deg + (i % 16 - 8) * 2e-5,
                   origin.lat_deg + (i / 16 - 8) * 2e-5);
    buf_printf(&body, "]}");
    const char *target = "/d/survey/height";
    const struct request ask = {.method = METHOD_POST,
                                .target = target,
                                .target_size = strlen(target),
                                .body = body.data,
                                .body_size = body.size};
    struct response asked;
    dispatch_answer(s, &ask, &asked);
    struct work *w = asked.work;
    assert_non_null(w);
    asked.work = NULL;
    response_free(&asked);
    buf_free(&body);
    job_count(s->jobs, &st);
    uint64_t cancelled = st.ended[JOB_MAP][JOB_CANCELLED]; /* of the tests before */
    assert_int_equal(job_submit(s->jobs, JOB_MAP, w->id, w, 1, 60, &waiter), ERR_OK);
    kit_await((job_count(s->jobs, &st), st.running[JOB_MAP]));
    assert_true(job_leave(s->jobs, &waiter));
    kit_await(job_idle(s->jobs));
    job_count(s->jobs, &st);
    assert_int_equal(st.ended[JOB_MAP][JOB_CANCELLED], cancelled + 1);
}

/* What is answered is test_query's; here: how it is asked, and what is said to nonsense. */
static void questions_are_answered(void **state)
{
    static const struct {
        const char *path, *body, *says;
        int status;
    } cases[] = {
        {"height", "{\"places\": [[8.6821, 50.1109], [9, 50]]}", "\"height_m\":null", 200},
        {"profile", "{\"line\": [[8.6820, 50.1109], [8.6822, 50.1109]]}", "\"climb_m\"", 200},
        {"measure", "{\"polygon\": [[8.682, 50.1108], [8.6822, 50.1108], [8.6821, 50.111]]}",
         "\"volume_above_m3\"", 200},
        {"measure", "{\"line\": [[8.682, 50.1108], [8.6822, 50.1108]]}", "\"rise_m\"", 200},
        {"visible",
         "{\"from\": {\"lon\": 8.682, \"lat\": 50.1108, \"above\": 50}, \"to\": {\"lon\": "
         "8.6822, \"lat\": 50.1109, \"above\": 0}}",
         "\"visible\":true", 200},
        {"pick",
         "{\"pose\": {\"lon\": 8.6821, \"lat\": 50.1109, \"height\": 260, \"heading\": 0, "
         "\"pitch\": -90}, \"width\": 200, \"height\": 100, \"x\": 100, \"y\": 50}",
         "\"found\":true", 200},
        {"height?v=1", "{\"places\": [[8.6821, 50.1109]]}", "\"height_m\"", 200},
        {"height?v=1&gsd_m=5", "{\"places\": [[8.6821, 50.1109]]}", "gsd_m stands in the address",
         400},
        {"height?lon=8&lat=50", "{\"places\": [[8.6821, 50.1109]]}", "as {\\\"places", 400},
        {"profile?step_m=1", "{\"line\": [[8.6820, 50.1109], [8.6822, 50.1109]]}", "step_m stands",
         400},
        {"height", "{\"places\": [[8, 91]]}", "place 1 must be", 422},
        {"height", "{\"places\": []}", "1 to 256 places", 422},
        {"height", "{", "body", 400},
        {"height", "", "JSON", 400},
        {"profile", "{\"line\": [[8.6, 50], [8.7, 50]], \"step_m\": 0.1}", "steps of at least",
         422},
        {"measure", "{\"polygon\": [[8.68, 50.11], [8.69, 50.12], [8.69, 50.11], [8.68, 50.12]]}",
         "crosses itself", 422},
        {"measure", "{\"polygon\": [[8.68, 50.11], [8.69, 50.11], [8.69, 50.12]]}", "gsd_m", 422},
        {"measure",
         "{\"polygon\": [[8.68, 50.11], [8.69, 50.11], [8.69, 50.12]], \"base\": \"sea\"}", "rim",
         422},
        {"measure",
         "{\"gsd_m\": 0.001, \"polygon\": [[8.68, 50.11], [8.73, 50.11], [8.73, 50.11000001], "
         "[8.68, 50.11000001]]}",
         "from gsd_m", 422},
        {"measure", "{\"line\": [[8.682, 50.1108], [8.682, 51.1]]}", "100 km", 422},
        {"measure", "{}", "one of the two", 422},
        {"visible", "{\"from\": {\"lon\": 8, \"lat\": 50}}", "above", 422},
        {"visible",
         "{\"from\": {\"lon\": 8, \"lat\": 50, \"above\": 1}, \"to\": {\"lon\": 8.6822, "
         "\"lat\": 50.1109, \"above\": 0}}",
         "no surface", 422},
        {"pick", "{\"x\": 1, \"y\": 1}", "one of the two", 422},
    };
    struct reply r, coarse, posted;
    if (!start_drawing())
        skip();
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        int got = post(cases[i].path, cases[i].body, &r);
        const char *text = (const char *)r.body;
        if (got != cases[i].status || !strstr(text, cases[i].says))
            fail_msg("%s %s: %d, want %d and %s: %s", cases[i].path, cases[i].body, got,
                     cases[i].status, cases[i].says, text);
        assert_string_equal(header(&r, "Cache-Control"), "no-store");
        buf_free(&r.raw);
    }
    ask("GET", "/d/survey/height?lon=8.6821&lat=50.1109", "", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Content-Type"), "application/json");
    assert_non_null(strstr((const char *)r.body, "WGS 84 ellipsoid"));
    assert_true(strlen(header(&r, "ETag")) > 2);
    ask("GET", "/d/survey/height?lon=8.6821&lat=50.1109&gsd_m=5", "", &coarse);
    assert_int_equal(post("height", "{\"places\": [[8.6821, 50.1109]], \"gsd_m\": 5}", &posted),
                     200);
    assert_string_equal((const char *)coarse.body, (const char *)posted.body);
    assert_string_not_equal((const char *)coarse.body, (const char *)r.body);
    buf_free(&posted.raw);
    buf_free(&coarse.raw);
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", "/d/survey/height?lon=8&lat=50&gsd_m=0", ""), 422);
    assert_int_equal(status_of("GET", "/d/survey/height?lon=8&lat=50&gsd_m=1m", ""), 400);
    assert_int_equal(status_of("GET", "/d/survey/height", ""), 400);
    assert_int_equal(status_of("GET", "/d/survey/height?lon=8", ""), 400);
    assert_int_equal(status_of("GET", "/d/survey/height?lon=8&lat=86", ""), 422);
    assert_int_equal(status_of("GET", "/d/survey/height?lon=8&lon=8&lat=50", ""), 400);
    assert_int_equal(status_of("GET", "/d/survey/measure", ""), 405);
}

/* A store that was clipped to what lies beside its footprint has Gaussians and no ground. */
static void no_ground_no_file(void **state)
{
    static const char west[] =
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"MultiPolygon\",\"coordinates\":[[["
        "[8.6817,50.1107],[8.6820,50.1107],[8.6820,50.1111],[8.6817,50.1111],[8.6817,50.1107]]]]}}";
    static const double east[4][2] = {
        {8.6822, 50.1107}, {8.6825, 50.1107}, {8.6825, 50.1111}, {8.6822, 50.1111}};
    const struct pyramid_config cfg = {.tile_edge_m = 30, .name = "halves"};
    const struct store_blob blob = {STORE_FOOTPRINT, west, strlen(west)};
    const char *bin = kit_program();
    struct err e = {0};
    struct gauss g;
    struct clip c;
    struct clip_report report;
    struct buf out = {0};
    struct dev dev;
    char whole[FILE_PATH_MAX], part[FILE_PATH_MAX], map[FILE_PATH_MAX];
    if (dev_open("cpu", &dev, &e) != ERR_OK) {
        print_message("skipped: %s\n", e.msg);
        skip();
    }
    dev_close(&dev);
    kit_ok(file_join(whole, f.dir, "halves.tiles", &e), e);
    kit_ok(file_join(part, f.dir, "east.tiles", &e), e);
    kit_ok(file_join(map, f.dir, "east.pmtiles", &e), e);
    kit_gauss(3, 400, 25, 0, 0, &g);
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(&origin, &level, 1, &cfg, &blob, 1, whole, NULL, &e), e);
    kit_ok(clip_of_ring(east, 4, &c, &e), e);
    kit_ok(clip_store(&c, whole, NULL, part, &report, &e), e);
    assert_true(report.n_kept > 0 && report.n_dropped > 0);
    static const char *const zooms[] = {"", "--zooms 0-15"};
    for (size_t i = 0; i < sizeof zooms / sizeof *zooms; i++) {
        assert_int_equal(
            kit_run(&out, "'%s' export -q '%s' -o '%s' --device cpu %s", bin, part, map, zooms[i]),
            1);
        kit_expect_text((const char *)out.data, "no ground", __FILE__, __LINE__);
        buf_free(&out);
        assert_false(file_exists(map));
    }
    clip_free(&c);
    gauss_free(&g);
}

int main(int argc, char **argv)
{
    if (worker_asked(argc, argv))
        return draw_main();
    const struct CMUnitTest tests[] = {
        SHARED_TEST(tiles_show_the_city),    SHARED_TEST(terrain_is_the_citys),
        SHARED_TEST(outside_is_empty),       SHARED_TEST(beside_the_survey_is_not_flat),
        SHARED_TEST(tiles_are_cached),       SHARED_TEST(nonsense_is_refused),
        SHARED_TEST(questions_are_answered), SHARED_LAST(questions_end_with_their_client),
        SHARED_LAST(gdal_opens_the_map),     HTTP_TEST(tilejson_leads_to_tiles),
        HTTP_TEST(style_leads_to_tiles),     HTTP_TEST(collections_have_boxes_and_themselves),
        HTTP_TEST(wmts_needs_an_address),    HTTP_TEST(wmts_names_itself),
        cmocka_unit_test(no_ground_no_file),
    };
    return cmocka_run_group_tests(tests, map_setup_all, map_teardown_all);
}
