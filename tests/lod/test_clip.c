/* Clipping a store: all that is kept lies inside, nothing inside is missing, tiles inside keep
 * every bit, blobs are copied, and invalid input is refused with a clear message.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey/survey_kit.h"

#include <unistd.h>

#include "lod/export/clip.h"
#include "lod/store/area.h"

static const double ring[5][2] = {
    {8.6815, 50.1106}, {8.6825, 50.1106}, {8.6825, 50.1113}, {8.6820, 50.1113}, {8.6815, 50.1106}};

static int setup(void **state)
{
    survey_make(NULL);
    return 0;
}

static void path_of(const char *name, char out[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(out, f.dir, name, &e), e);
}

static void put_file(const char *name, const char *text, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    path_of(name, path);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

static bool inside(double lon, double lat)
{
    bool in = false;
    for (int i = 0; i < 4; i++)
        if ((ring[i][1] > lat) != (ring[i + 1][1] > lat) &&
            lon < ring[i][0] + (lat - ring[i][1]) / (ring[i + 1][1] - ring[i][1]) *
                                   (ring[i + 1][0] - ring[i][0]))
            in = !in;
    return in;
}

static void put_ring(char path[FILE_PATH_MAX])
{
    struct buf b = {0};
    buf_printf(&b, "{\"type\":\"Feature\",\"properties\":{},\"geometry\":{\"type\":\"Polygon\","
                   "\"coordinates\":[[");
    for (int i = 0; i < 5; i++)
        buf_printf(&b, "%s[%.7f,%.7f]", i ? "," : "", ring[i][0], ring[i][1]);
    buf_printf(&b, "]]}}");
    buf_u8(&b, 0);
    put_file("ring.geojson", (char *)b.data, path);
    buf_free(&b);
}

/* How many Gaussians of a tile lie inside; those of `all` that do not are an error. */
static size_t count(struct store *s, struct key k, double high_m, bool all)
{
    struct err e = {0};
    struct gauss g;
    size_t n = 0;
    kit_ok(store_read_gauss(s, k, &g, &e), e);
    for (size_t i = 0; i < g.n; i++) {
        double enu[3], lon, lat, h;
        for (size_t a = 0; a < 3; a++)
            enu[a] = (double)g.mean_m[3 * i + a] + g.origin_enu_m[a];
        kit_ok(geo_from_enu(&origin, enu, &lon, &lat, &h, &e), e);
        bool in = inside(lon, lat) && h <= high_m;
        n += in;
        if (all && !(in || (fabs(h - high_m) < 0.01 && inside(lon, lat)) ||
                     inside(lon + 1e-7, lat) != inside(lon - 1e-7, lat) ||
                     inside(lon, lat + 1e-7) != inside(lon, lat - 1e-7)))
            fail_msg("a Gaussian at %.7f,%.7f %.2f m was kept", lon, lat, h);
    }
    gauss_free(&g);
    return n;
}

static void check_part(double high_m, bool copies)
{
    struct err e = {0};
    struct clip c;
    struct clip_report r;
    struct store *all, *part;
    char polygon[FILE_PATH_MAX], path[FILE_PATH_MAX];
    size_t n, want = 0, got = 0, same = 0;
    put_ring(polygon);
    path_of("part.tiles", path);
    kit_ok(clip_open(polygon, -HUGE_VAL, high_m, &c, &e), e);
    kit_ok(clip_store(&c, f.path, "block", path, &r, &e), e);
    clip_free(&c);
    kit_ok(store_open(f.path, &all, &e), e);
    kit_ok(store_open(path, &part, &e), e);
    assert_string_equal(store_info(part)->name, "block");
    assert_string_equal(store_info(part)->attribution, "ours");
    assert_string_equal(store_info(part)->revision, r.revision);
    const struct store_tile *tiles = store_tiles(all, &n);
    for (size_t i = 0; i < n; i++) {
        size_t here = count(all, tiles[i].key, high_m, false);
        const struct store_tile *t = store_find(part, tiles[i].key);
        want += here;
        assert_int_equal(t != NULL, here > 0);
        if (!t)
            continue;
        got += t->count;
        (void)count(part, t->key, high_m, true);
        if (here == tiles[i].count) {
            assert_memory_equal(&t->hash, &tiles[i].hash, sizeof t->hash);
            same++;
        }
    }
    printf("clip: %zu Gaussians of %zu kept, %zu tiles as they were\n", r.n_kept,
           r.n_kept + r.n_dropped, same);
    assert_int_equal(got, want);
    assert_int_equal(r.n_kept, want);
    assert_int_equal(r.n_copied, same);
    assert_true((same > 0) == copies && r.n_dropped > r.n_kept / 10);
    kit_ok(store_verify(part, NULL, &e), e);
    store_close(&part);
    store_close(&all);
}

static void what_lies_inside_is_kept(void **state)
{
    check_part(HUGE_VAL, true);
    check_part(origin.h_m + 8, false); /* haze is everywhere, so that no tile is as it was */
}

/* A part of an old store was not made when that was. */
static void a_part_has_its_own_date(void **state)
{
    struct err e = {0};
    struct store *all, *old;
    struct store_meta meta;
    struct clip c;
    struct clip_report r;
    char path[FILE_PATH_MAX], out[FILE_PATH_MAX];
    size_t n;
    path_of("old.tiles", path);
    path_of("new.tiles", out);
    kit_ok(store_open(f.path, &all, &e), e);
    meta = *store_info(all);
    snprintf(meta.created, sizeof meta.created, "2001-02-03T04:05:06Z");
    kit_ok(store_create(path, &meta, &old, &e), e);
    const struct store_tile *tiles = store_tiles(all, &n);
    for (size_t i = 0; i < n; i++) {
        struct store_entry t = {tiles[i], store_shape(all, &tiles[i])};
        struct buf payload = {0};
        kit_ok(store_read(all, tiles[i].key, &payload, &e), e);
        kit_ok(store_add(old, &t, &payload, &e), e);
        buf_free(&payload);
    }
    kit_ok(store_commit(&old, &e), e);
    kit_ok(clip_open(NULL, -HUGE_VAL, origin.h_m + 8, &c, &e), e);
    kit_ok(clip_store(&c, path, NULL, out, &r, &e), e);
    store_close(&all);
    kit_ok(store_open(out, &all, &e), e);
    assert_int_equal(strlen(store_info(all)->created), 20);
    assert_true(strcmp(store_info(all)->created, "2020") > 0);
    store_close(&all);
    clip_free(&c);
}

/* How many of 40 x 40 places lie in a part, which must be those of the whole within the ring, and
 * south of 50.111 of a part of it. */
static size_t held_by(const struct area *a, const struct area *all, bool twice)
{
    uint8_t in[40 * 40];
    double corner[8];
    size_t held = 0;
    for (size_t k = 0; k < 4; k++)
        key_place(k & 1 ? 8.683 : 8.681, k & 2 ? 50.1104 : 50.1114, corner + 2 * k);
    (void)area_mask(a, corner, 40, 40, in);
    for (int i = 0; i < 1600; i++) { /* the mask's rows are even in Mercator, nearly so here */
        double lon = 8.681 + (i % 40 + 0.5) * 0.002 / 40,
               lat = 50.1114 - (i / 40 + 0.5) * 0.001 / 40;
        bool want = inside(lon, lat) && (!twice || lat < 50.111) && area_holds(all, lon, lat);
        if (fabs(lat - 50.111) < 2e-5 ||
            area_holds(all, lon + 2e-6, lat + 2e-6) != area_holds(all, lon - 2e-6, lat - 2e-6) ||
            inside(lon + 2e-6, lat) != inside(lon - 2e-6, lat))
            continue;
        assert_int_equal(area_holds(a, lon, lat), want);
        assert_int_equal(in[i], want);
        held += want;
    }
    return held;
}

/* Of a part what was surveyed ends where it was cut, for every map of it; of a part of a part,
 * where both were. */
static void maps_end_at_the_cut(void **state)
{
    static const char south[] = "{\"type\":\"Polygon\",\"coordinates\":[[[8.68,50.11],[8.69,50.11],"
                                "[8.69,50.111],[8.68,50.111],[8.68,50.11]]]}";
    struct err e = {0};
    struct clip c[2];
    struct clip_report r[2];
    struct store *part, *whole;
    struct area a, all;
    char polygon[FILE_PATH_MAX], path[FILE_PATH_MAX], second[FILE_PATH_MAX];
    put_ring(polygon);
    path_of("once.tiles", path);
    path_of("second.tiles", second);
    kit_ok(clip_open(polygon, -HUGE_VAL, HUGE_VAL, &c[0], &e), e);
    kit_ok(clip_store(&c[0], f.path, NULL, path, &r[0], &e), e);
    kit_ok(clip_store(&c[0], f.path, NULL, second, &r[1], &e), e);
    assert_string_equal(r[0].revision, r[1].revision); /* its id */
    put_file("south.geojson", south, polygon);
    kit_ok(clip_open(polygon, -HUGE_VAL, HUGE_VAL, &c[1], &e), e);
    kit_ok(clip_store(&c[1], path, NULL, second, &r[1], &e), e);
    assert_true(r[1].n_kept < r[0].n_kept && r[1].n_kept > r[0].n_kept / 4);
    kit_ok(store_open(f.path, &whole, &e), e);
    kit_ok(area_make(whole, &all, &e), e);
    for (int twice = 0; twice < 2; twice++) {
        kit_ok(store_open(twice ? second : path, &part, &e), e);
        kit_ok(area_make(part, &a, &e), e);
        assert_true(fabs(a.west_deg - fmax(all.west_deg, 8.6815)) < 1e-6);
        assert_true(fabs(a.east_deg - fmin(all.east_deg, 8.6825)) < 1e-6);
        assert_true(fabs(a.south_deg - fmax(all.south_deg, 50.1106)) < 1e-6);
        assert_true(fabs(a.north_deg - (twice ? 50.111 : 50.1113)) < 1e-6);
        assert_true(held_by(&a, &all, twice) > 200);
        area_free(&a);
        store_close(&part);
    }
    area_free(&all);
    store_close(&whole);
    clip_free(&c[0]);
    clip_free(&c[1]);
}

/* RFC 7946 allows features of no place. */
static void features_without_geometry_are_skipped(void **state)
{
    static const char text[] =
        "{\"type\":\"FeatureCollection\",\"features\":[{\"type\":\"Feature\",\"geometry\":null},"
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"Polygon\",\"coordinates\":"
        "[[[8,50],[9,50],[9,51],[8,50]]]}}]}";
    struct err e = {0};
    struct clip c;
    char path[FILE_PATH_MAX];
    put_file("null.geojson", text, path);
    kit_ok(clip_open(path, -HUGE_VAL, HUGE_VAL, &c, &e), e);
    assert_int_equal(c.area.n_polygons, 1);
    clip_free(&c);
}

static void nonsense_is_refused(void **state)
{
    static const struct {
        const char *text, *says;
        enum err_code rc;
    } bad[] = {
        {"{\"type\":\"Polygon\",\"coordinates\":[[[8,50],[9,51],[9,50],[8,51],[8,50]]]}",
         "crosses itself", ERR_DATA},
        {"{\"type\":\"Polygon\",\"coordinates\":[[[8,50],[9,51],[9,50],[8,51]]]}", "not closed",
         ERR_FORMAT},
        {"{\"type\":\"Polygon\",\"coordinates\":[[[477000,5550000],[477001,5550000],[477001,"
         "5550001],"
         "[477000,5550000]]]}",
         "ogr2ogr", ERR_FORMAT},
        {"{\"type\":\"FeatureCollection\",\"crs\":{\"properties\":{\"name\":\"urn:ogc:def:crs:EPSG:"
         ":"
         "25832\"}},\"features\":[]}",
         "25832", ERR_FORMAT},
        {"{\"type\":\"Point\",\"coordinates\":[8,50]}", "no polygon", ERR_FORMAT},
        {"[]", "is expected", ERR_FORMAT},
        {"{\"type\":\"Feature\",\"geometry\":null}", "no polygon", ERR_FORMAT},
        {"{\"type\":\"Feature\"}", "is expected", ERR_FORMAT},
    };
    struct err e = {0};
    struct clip c;
    struct clip_report r;
    char path[FILE_PATH_MAX], out[FILE_PATH_MAX];
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        put_file("bad.geojson", bad[i].text, path);
        kit_fails(clip_open(path, -HUGE_VAL, HUGE_VAL, &c, &e), bad[i].rc, e, bad[i].says);
    }
    kit_fails(clip_open("/nowhere.geojson", 0, 1, &c, &e), ERR_NOENT, e, "nowhere");
    kit_fails(clip_open(NULL, 5, 5, &c, &e), ERR_DATA, e, "below");
    path_of("none.tiles", out);
    put_file("far.geojson",
             "{\"type\":\"Polygon\",\"coordinates\":[[[8,50],[8.1,50],[8.1,50.1],[8,50]]]}", path);
    kit_ok(clip_open(path, -HUGE_VAL, HUGE_VAL, &c, &e), e);
    kit_fails(clip_store(&c, f.path, NULL, out, &r, &e), ERR_DATA, e,
              "m above the WGS 84 ellipsoid");
    kit_fails(clip_store(&c, f.path, NULL, f.path, &r, &e), ERR_ARG, e, "onto itself");
    clip_free(&c);
    assert_false(file_exists(out));
}

/* Who asks for too much height is told where the store lies, as the store counts heights. */
static void heights_are_those_of_the_store(void **state)
{
    struct err e = {0};
    struct store *all, *sea = NULL;
    struct clip c;
    struct clip_report r;
    char path[FILE_PATH_MAX], out[FILE_PATH_MAX];
    size_t n;
    path_of("sea.tiles", path);
    path_of("none.tiles", out);
    kit_ok(store_open(f.path, &all, &e), e);
    struct store_meta meta = *store_info(all);
    snprintf(meta.heights, sizeof meta.heights, "sea");
    kit_ok(store_create(path, &meta, &sea, &e), e);
    const struct store_tile *tiles = store_tiles(all, &n);
    for (size_t i = 0; i < n; i++) {
        struct store_entry t = {.tile = {.key = tiles[i].key, .level = tiles[i].level}};
        struct gauss g;
        kit_ok(store_read_gauss(all, t.tile.key, &g, &e), e);
        kit_ok(store_put(sea, &t, &g, &e), e);
        gauss_free(&g);
    }
    kit_ok(store_commit(&sea, &e), e);
    store_close(&all);
    kit_ok(clip_open(NULL, 5000, HUGE_VAL, &c, &e), e);
    kit_fails(clip_store(&c, path, NULL, out, &r, &e), ERR_DATA, e, "m above sea level");
    clip_free(&c);
}

/* The command, and export of the part. */
static void the_program_clips(void **state)
{
    struct buf out = {0};
    char polygon[FILE_PATH_MAX];
    const char *bin = kit_program();
    put_ring(polygon);
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && '%s' clip -q city.tiles -o cli.tiles --polygon ring.geojson "
                "&& '%s' export -q cli.tiles -o cli.ply && '%s' verify cli.tiles",
                f.dir, bin, bin, bin),
        0);
    kit_expect_text((const char *)out.data, "Gaussians kept", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s' clip -q city.tiles -o low.tiles --high-m x", f.dir, bin), 2);
    kit_expect_text((const char *)out.data, "--high-m", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "cd '%s' && '%s' clip -q city.tiles -o x.tiles", f.dir, bin), 2);
    kit_expect_text((const char *)out.data, "--polygon", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s' clip -q city.tiles -o x.tiles --low-m 5000", f.dir, bin), 1);
    kit_expect_text((const char *)out.data, "nothing is left", __FILE__, __LINE__);
    buf_free(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_lies_inside_is_kept),
        cmocka_unit_test(a_part_has_its_own_date),
        cmocka_unit_test(maps_end_at_the_cut),
        cmocka_unit_test(nonsense_is_refused),
        cmocka_unit_test(features_without_geometry_are_skipped),
        cmocka_unit_test(heights_are_those_of_the_store),
        cmocka_unit_test(the_program_clips),
    };
    return cmocka_run_group_tests_name("clip", tests, setup, survey_teardown);
}
