/* A part of a store (`citysplat clip`), served from end to end. The program serves a triangle of
 * the procedural city, and tiles, tileset, map, terrain, pictures and answers end at its border.
 * The revision is the same after a restart.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"
#include "tests/survey/survey_kit.h"

#include <jansson.h>
#include <signal.h>
#include <sys/wait.h>

#include "codec/image/image.h"
#include "codec/splat/ply.h"
#include "lod/export/clip.h"
#include "lod/surface/raster.h"

/* Triangles about the city's corners: SOUTH_WEST of the line from its north-west to its south-east,
 * NORTH_EAST of the same line. Slanting, so that no tile and no box ends where they do. */
enum { SOUTH_WEST, NORTH_EAST };
static const double corners[2][3][2] = {
    {{8.6815, 50.1105}, {8.6827, 50.1105}, {8.6815, 50.1113}},
    {{8.6827, 50.1105}, {8.6827, 50.1113}, {8.6815, 50.1113}},
};
static const double place_in[2][2] = {{8.68190, 50.11076}, {8.68230, 50.11104}};
enum { BLUE = 60 }; /* of 255: the city is half blue everywhere, black and nothing are not */

static struct part {
    pid_t pid;
    char polygon[FILE_PATH_MAX], path[FILE_PATH_MAX], revision[13], map[96], terrain[96];
    struct clip_report made;
} p;

/* ---- the program ---- */

static void part_make(void)
{
    const double(*c)[2] = corners[SOUTH_WEST];
    struct clip clip;
    char text[512];
    struct err e = {0};
    int n = snprintf(text, sizeof text,
                     "{\"type\":\"Polygon\",\"coordinates\":[[[%.7f,%.7f],[%.7f,%.7f],[%.7f,%.7f],"
                     "[%.7f,%.7f]]]}",
                     c[0][0], c[0][1], c[1][0], c[1][1], c[2][0], c[2][1], c[0][0], c[0][1]);
    kit_ok(file_join(p.polygon, f.dir, "part.geojson", &e), e);
    kit_ok(file_write(p.polygon, text, (size_t)n, &e), e);
    kit_ok(file_join(p.path, f.dir, "part.tiles", &e), e);
    kit_ok(clip_open(p.polygon, -HUGE_VAL, HUGE_VAL, &clip, &e), e);
    kit_ok(clip_store(&clip, f.path, NULL, p.path, &p.made, &e), e);
    clip_free(&clip);
}

static bool inside(int which, double lon, double lat)
{
    bool in = true;
    for (int i = 0; i < 3; i++) {
        const double *a = corners[which][i], *b = corners[which][(i + 1) % 3];
        in = in && (b[0] - a[0]) * (lat - a[1]) - (b[1] - a[1]) * (lon - a[0]) >= 0;
    }
    return in;
}

/* Within so many degrees of it. */
static bool near_border(int which, double lon, double lat, double deg)
{
    bool in = inside(which, lon, lat);
    for (int k = 0; k < 8; k++)
        if (inside(which, lon + deg * cos(k * SURVEY_PI / 4), lat + deg * sin(k * SURVEY_PI / 4)) !=
            in)
            return true;
    return false;
}

static void program_start(void)
{
    int out[2];
    const char *name = kit_program();
    char line[256] = "";
    assert_int_equal(pipe(out), 0);
    p.pid = fork();
    assert_true(p.pid >= 0);
    if (!p.pid) {
        const char *const argv[] = {
            name, "serve", p.path, "-q", "--port", "0", "--device", "cpu", "--no-access-log", NULL};
        dup2(out[1], 1);
        close(out[0]);
        close(out[1]);
        execv(name, (char *const *)(uintptr_t)argv);
        _exit(127);
    }
    close(out[1]);
    for (size_t n = 0; n + 1 < sizeof line && read(out[0], line + n, 1) == 1; n++)
        if (line[n] == '\n')
            break;
    close(out[0]);
    const char *colon = strrchr(line, ':');
    if (!colon)
        fail_msg("the program does not say where it listens: %s", line);
    t.port = (uint16_t)atoi(colon + 1);
    char target[96]; /* addresses have the device in them, which is known once one was drawn */
    struct key k = key_at(0, 0, 5);
    snprintf(target, sizeof target, "/d/survey/terrain/%u/%u/%u.png", k.z, k.x, k.y);
    assert_int_equal(status_of("GET", target, ""), 307);
    struct reply r;
    ask("GET", target, "", &r);
    snprintf(target, sizeof target, "/d/survey/%s", header(&r, "Location") + strlen("../../../"));
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", target, ""), 200);
}

static void program_end(void)
{
    int status = -1;
    if (!p.pid)
        return;
    kill(p.pid, SIGTERM);
    assert_int_equal(waitpid(p.pid, &status, 0), p.pid);
    p.pid = 0;
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

static json_t *document(const char *target)
{
    struct reply r;
    ask("GET", target, "", &r);
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.body_size, (const char *)r.body);
    json_t *o = json_loadb((const char *)r.body, r.body_size, 0, NULL);
    assert_non_null(o);
    buf_free(&r.raw);
    return o;
}

/* "r/REV-EDITION/WHAT" of a document's template, which is absolute. */
static void template_of(const char *target, char out[96])
{
    json_t *o = document(target);
    const char *tile = json_string_value(json_array_get(json_object_get(o, "tiles"), 0)), *end;
    assert_non_null(tile);
    tile = strstr(tile, "/r/");
    end = tile ? strstr(tile, "/{z}") : NULL;
    assert_non_null(end);
    tile++;
    snprintf(out, 96, "%.*s", (int)(end - tile), tile);
    json_decref(o);
}

static void look_again(void)
{
    template_of("/d/survey/map.json", p.map);
    template_of("/d/survey/terrain.json", p.terrain);
    assert_int_equal(sscanf(p.map, "r/%12[0-9a-f]", p.revision), 1);
}

static const char *picture_target(const char *of, struct key k, const char *ext, char out[256])
{
    snprintf(out, 256, "/d/survey/%s/%u/%u/%u.%s", of, k.z, k.x, k.y, ext);
    return out;
}

/* false: 204, there is nothing. */
static bool read_picture(const char *target, const char *name, struct image *img)
{
    struct reply r;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    ask("GET", target, "", &r);
    if (r.status == 204) {
        buf_free(&r.raw);
        return false;
    }
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.body_size, (const char *)r.body);
    kit_ok(file_join(path, f.dir, name, &e), e);
    kit_ok(file_write(path, r.body, r.body_size, &e), e);
    buf_free(&r.raw);
    kit_ok(image_read(path, NULL, img, &e), e);
    return true;
}

static void etag_of(const char *target, char out[64])
{
    struct reply r;
    ask("GET", target, "", &r);
    if (r.status != 200)
        fail_msg("%s: %d", target, r.status);
    assert_string_equal(header(&r, "Cache-Control"), "public, max-age=31536000, immutable");
    snprintf(out, 64, "%s", header(&r, "ETag"));
    assert_true(strlen(out) > 2);
    buf_free(&r.raw);
}

/* ---- what is asked ---- */

/* Gaussians of this tile of the part, all within it. */
static size_t tile_in_the_part(const char *target)
{
    struct err e = {0};
    struct reply r;
    struct gauss g;
    struct ply_info info = {0};
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 200);
    kit_ok(ply_decode(r.body, r.body_size, NULL, &g, &info, &e), e);
    buf_free(&r.raw);
    assert_true(info.has_origin);
    for (size_t i = 0; i < g.n; i++) {
        double enu[3], lon, lat, h;
        for (size_t a = 0; a < 3; a++)
            enu[a] = (double)g.mean_m[3 * i + a] + g.origin_enu_m[a];
        kit_ok(geo_from_enu(&info.origin, enu, &lon, &lat, &h, &e), e);
        if (!inside(SOUTH_WEST, lon, lat) && !near_border(SOUTH_WEST, lon, lat, 1e-7))
            fail_msg("%s has a Gaussian at %.7f,%.7f", target, lon, lat);
    }
    size_t n = g.n;
    gauss_free(&g);
    return n;
}

/* Every Gaussian of every tile lies in the part, and there are as many as the part has. */
static void tiles_hold_the_part(void **state)
{
    const struct clip_report want = p.made;
    struct reply r;
    char target[256];
    size_t n_tiles = 0, n = 0;
    assert_string_equal(p.revision, want.revision);
    ask("GET", "/d/survey/seed.ndjson?f=ply", "", &r);
    assert_int_equal(r.status, 200);
    char *list = strndup((const char *)r.body, r.body_size), *rest = NULL;
    buf_free(&r.raw);
    for (char *line = strtok_r(list, "\n", &rest); line; line = strtok_r(NULL, "\n", &rest)) {
        unsigned z, x, y;
        const char *at = strstr(line, "/t/");
        if (!at)
            continue;
        assert_int_equal(sscanf(at, "/t/%u/%u/%u", &z, &x, &y), 3);
        snprintf(target, sizeof target, "/d/survey/r/%s/t/%u/%u/%u.ply", p.revision, z, x, y);
        n += tile_in_the_part(target);
        n_tiles++;
    }
    free(list);
    printf("a part: %zu Gaussians in %zu tiles\n", n, n_tiles);
    assert_int_equal(n, want.n_kept);
    assert_int_equal(n_tiles, want.n_tiles);
    assert_true(want.n_dropped > want.n_kept / 2);
}

/* Tileset and collection: what they say of where the city is has shrunk with it. The whole has
 * large Gaussians 400 m away on every side. */
static void documents_end_there(void **state)
{
    json_t *o = document("/collections/survey"),
           *box = json_array_get(
               json_object_get(json_object_get(json_object_get(o, "extent"), "spatial"), "bbox"),
               0);
    struct err e = {0};
    size_t up = json_array_size(box) == 6 ? 3 : 2;
    assert_true(json_array_size(box) >= 4);
    for (size_t k = 0; k < 2; k++) {
        double enu[3], lon = json_number_value(json_array_get(box, k * up)),
                       lat = json_number_value(json_array_get(box, k * up + 1));
        kit_ok(geo_to_enu(&origin, lon, lat, origin.h_m, enu, &e), e);
        printf("a part: a corner of the collection %.1f m east, %.1f north\n", enu[0], enu[1]);
        assert_true(fabs(enu[0]) < 120 && fabs(enu[1]) < 120);
    }
    json_decref(o);
    o = document("/d/survey/map.json");
    box = json_object_get(o, "bounds"); /* of ground, to the corner */
    assert_true(json_number_value(json_array_get(box, 0)) > corners[SOUTH_WEST][0][0] - 1e-9);
    assert_true(json_number_value(json_array_get(box, 1)) > corners[SOUTH_WEST][0][1] - 1e-9);
    assert_true(json_number_value(json_array_get(box, 2)) < corners[SOUTH_WEST][1][0] + 1e-9);
    assert_true(json_number_value(json_array_get(box, 3)) < corners[SOUTH_WEST][2][1] + 1e-9);
    json_decref(o);
    o = document("/d/survey/tileset.json");
    char *text = json_dumps(o, JSON_COMPACT);
    assert_non_null(strstr(text, p.revision));
    free(text);
    json_decref(o);
}

/* A tile pixel by pixel: colour within, nothing without; heights within, the survey's floor
 * without. count: pixels without and within; off: those that are wrong. */
static void map_check(struct key k, double void_m, size_t count[2], size_t *off)
{
    struct image map = {0}, terrain;
    char target[256];
    double n = pow(2, k.z), pixel_deg = 360 / n / 256;
    bool any = read_picture(picture_target(p.map, k, "jpg", target), "map.jpg", &map);
    assert_true(read_picture(picture_target(p.terrain, k, "png", target), "terrain.png", &terrain));
    for (uint32_t i = 0; i < 256 * 256; i++) {
        double u = (k.x + (i % 256 + 0.5) / 256) / n, v = (k.y + (i / 256 + 0.5) / 256) / n,
               lon = 360 * u - 180, lat = 360 / SURVEY_PI * atan(exp(SURVEY_PI * (1 - 2 * v))) - 90,
               enu[3];
        struct err e = {0};
        static const uint8_t nothing[] = {255, 255, 255};
        const uint8_t *px = terrain.px + 3 * i, *c = any ? map.px + 3 * i : nothing;
        double h = -10000 + 0.1 * (65536 * px[0] + 256 * px[1] + px[2]);
        kit_ok(geo_to_enu(&origin, lon, lat, origin.h_m, enu, &e), e);
        bool in = inside(SOUTH_WEST, lon, lat), white = c[0] > 250 && c[1] > 250 && c[2] > 250;
        if (in && (fabs(enu[0]) > 28 || fabs(enu[1]) > 28))
            continue;
        if (near_border(SOUTH_WEST, lon, lat,
                        (in ? 10 : 18) * pixel_deg)) /* blocks of JPEG are 8 */
            continue;
        *off += white == in;
        if (!in)
            *off += fabs(h - void_m) > 0.051;
        else if (level_at(enu[0], enu[1], 0.5))
            *off += fabs(h - origin.h_m - truth_z(enu[0], enu[1])) > 1;
        count[in]++;
    }
    image_free(&map);
    image_free(&terrain);
}

static void maps_end_there(void **state)
{
    struct key middle = key_at(origin.lon_deg, origin.lat_deg, 19); /* 49 m */
    size_t count[2] = {0}, off = 0;
    json_t *o = document("/d/survey/terrain.json");
    double void_m = json_number_value(json_object_get(o, "voidHeight"));
    json_decref(o);
    for (uint32_t i = 0; i < 9; i++) {
        struct key k = {middle.z, middle.x + i % 3 - 1, middle.y + i / 3 - 1};
        map_check(k, void_m, count, &off);
    }
    printf("a part: map of %zu px within and %zu without, %zu wrong\n", count[1], count[0], off);
    assert_true(count[0] > 100000 && count[1] > 20000);
    assert_int_equal(off, 0);
}

/* 13 m of ground from straight above, on either side of the border and 15 m away from it. */
static void views_end_there(void **state)
{
    for (int which = 0; which < 2; which++) {
        struct image img;
        char target[256];
        size_t blue = 0;
        snprintf(target, sizeof target,
                 "/d/survey/r/%s/static/%.7f,%.7f,%.1f@0,-90,8/64x64.png?background=000000",
                 p.revision, place_in[which][0], place_in[which][1], origin.h_m + 90);
        assert_true(read_picture(target, "view.png", &img));
        for (size_t i = 0; i < 64 * 64; i++)
            blue += img.px[3 * i + 2] > BLUE;
        printf("a part: %zu of 4096 px show the city %s of it\n", blue,
               which == SOUTH_WEST ? "within" : "without");
        assert_true(which == SOUTH_WEST ? blue > 3900 : blue == 0);
        image_free(&img);
    }
}

static json_t *answer(const char *what, const char *body)
{
    struct reply r;
    char target[128];
    snprintf(target, sizeof target, "/d/survey/%s", what);
    if (post_text(target, body, &r) != 200)
        fail_msg("%s %s: %d %.*s", what, body, r.status, (int)r.body_size, (const char *)r.body);
    json_t *o = json_loadb((const char *)r.body, r.body_size, 0, NULL);
    assert_non_null(o);
    buf_free(&r.raw);
    return o;
}

static void answers_end_there(void **state)
{
    const double *in = place_in[SOUTH_WEST], *out = place_in[NORTH_EAST];
    char body[512];
    snprintf(body, sizeof body, "{\"places\": [[%.7f, %.7f], [%.7f, %.7f]]}", in[0], in[1], out[0],
             out[1]);
    json_t *o = answer("height", body), *places = json_object_get(o, "places");
    assert_int_equal(json_array_size(places), 2);
    assert_true(json_is_number(json_object_get(json_array_get(places, 0), "height_m")));
    assert_true(json_is_null(json_object_get(json_array_get(places, 1), "height_m")));
    json_decref(o);
    for (int which = 0; which < 2; which++) {
        snprintf(body, sizeof body,
                 "{\"pose\": {\"lon\": %.7f, \"lat\": %.7f, \"height\": %.1f, \"heading\": 0, "
                 "\"pitch\": -90}, \"width\": 100, \"height\": 100, \"x\": 50, \"y\": 50}",
                 place_in[which][0], place_in[which][1], origin.h_m + 90);
        o = answer("pick", body);
        assert_int_equal(json_is_true(json_object_get(o, "found")), which == SOUTH_WEST);
        json_decref(o);
    }
    /* Across the border at its middle, which is the origin. */
    snprintf(body, sizeof body, "{\"line\": [[%.7f, %.7f], [%.7f, %.7f]], \"step_m\": 0.5}", in[0],
             in[1], out[0], out[1]);
    o = answer("profile", body);
    json_t *samples = json_object_get(o, "samples");
    size_t n = json_array_size(samples), wrong = 0;
    assert_true(n > 50);
    for (size_t i = 0; i < n; i++) {
        double share = (double)i / (double)(n - 1), lon = in[0] + share * (out[0] - in[0]),
               lat = in[1] + share * (out[1] - in[1]);
        bool there = json_is_number(json_object_get(json_array_get(samples, i), "height_m"));
        if (!near_border(SOUTH_WEST, lon, lat, 1e-5)) /* 0.7 m */
            wrong += there != inside(SOUTH_WEST, lon, lat);
    }
    printf("a part: a profile of %zu samples, %zu wrong\n", n, wrong);
    assert_int_equal(wrong, 0);
    json_decref(o);
}

/* Started anew, the same part has the same addresses and tags. */
static void a_restart_changes_nothing(void **state)
{
    char tile[256], map[256], tags[2][2][64], revision[13];
    struct key k = key_at(place_in[SOUTH_WEST][0], place_in[SOUTH_WEST][1], 18);
    picture_target(p.map, k, "webp", map);
    json_t *o = document("/collections/survey/tiles.json");
    const char *url = json_string_value(json_array_get(json_object_get(o, "tiles"), 0));
    assert_non_null(url);
    const char *r = strstr(url, "/r/");
    assert_non_null(r);
    uint8_t z = (uint8_t)json_integer_value(json_object_get(o, "maxzoom"));
    k = key_at(place_in[SOUTH_WEST][0], place_in[SOUTH_WEST][1], z);
    snprintf(tile, sizeof tile, "/d/survey%.*s/t/%u/%u/%u.glb", (int)strcspn(r + 3, "/") + 3, r,
             k.z, k.x, k.y);
    json_decref(o);
    memcpy(revision, p.revision, sizeof revision);
    for (int round = 0; round < 2; round++) {
        etag_of(tile, tags[round][0]);
        etag_of(map, tags[round][1]);
        if (round)
            break;
        program_end();
        program_start();
        look_again();
        assert_string_equal(p.revision, revision);
    }
    for (int i = 0; i < 2; i++) {
        char line[320];
        assert_string_equal(tags[0][i], tags[1][i]);
        snprintf(line, sizeof line, "If-None-Match: %s\r\n", tags[0][i]);
        assert_int_equal(status_of("GET", i ? map : tile, line), 304);
    }
}

static int part_setup(void **state)
{
    struct err e = {0};
    struct dev dev;
    log_set_level(LOG_ERROR);
    survey_make(NULL);
    if (!getenv("CITYSPLAT_BIN"))
        return 0;
    if (dev_open("cpu", &dev, &e) != ERR_OK) {
        print_message("skipped: %s\n", e.msg);
        return 0;
    }
    dev_close(&dev);
    part_make();
    program_start();
    look_again();
    return 0;
}

static int part_teardown(void **state)
{
    program_end();
    return survey_teardown(state);
}

static int needs_program(void **state)
{
    if (!p.pid)
        skip();
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(tiles_hold_the_part, needs_program),
        cmocka_unit_test_setup(documents_end_there, needs_program),
        cmocka_unit_test_setup(maps_end_there, needs_program),
        cmocka_unit_test_setup(views_end_there, needs_program),
        cmocka_unit_test_setup(answers_end_there, needs_program),
        cmocka_unit_test_setup(a_restart_changes_nothing, needs_program),
    };
    return cmocka_run_group_tests_name("serve_part", tests, part_setup, part_teardown);
}
