/* A part of a store: what is kept lies inside and nothing that does is missing, tiles inside keep every
 * bit, blobs come along, and what makes no sense is refused in words.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey_kit.h"

#include "lod/clip.h"

static const double ring[5][2] = {
    {8.6815, 50.1106}, {8.6825, 50.1106}, {8.6825, 50.1113}, {8.6820, 50.1113}, {8.6815, 50.1106}};

static int setup(void **state)
{
    (void)state;
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
    (void)state;
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
    (void)state;
    path_of("old.tiles", path);
    path_of("new.tiles", out);
    kit_ok(store_open(f.path, &all, &e), e);
    meta = *store_info(all);
    snprintf(meta.created, sizeof meta.created, "2001-02-03T04:05:06Z");
    kit_ok(store_create(path, &meta, &old, &e), e);
    const struct store_tile *tiles = store_tiles(all, &n);
    for (size_t i = 0; i < n; i++) {
        struct store_tile t = tiles[i];
        struct buf payload = {0};
        kit_ok(store_read(all, t.key, &payload, &e), e);
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
    };
    struct err e = {0};
    struct clip c;
    struct clip_report r;
    char path[FILE_PATH_MAX], out[FILE_PATH_MAX];
    (void)state;
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
    kit_fails(clip_store(&c, f.path, NULL, out, &r, &e), ERR_DATA, e, "the store lies within");
    kit_fails(clip_store(&c, f.path, NULL, f.path, &r, &e), ERR_ARG, e, "onto itself");
    clip_free(&c);
    assert_false(file_exists(out));
}

/* The command, and export of the part. */
static void the_program_clips(void **state)
{
    struct buf out = {0};
    char polygon[FILE_PATH_MAX];
    const char *bin = kit_program();
    (void)state;
    put_ring(polygon);
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && '%s' clip -q city.tiles -o cli.tiles --polygon ring.geojson "
                "&& '%s' export -q cli.tiles -o cli.ply && '%s' verify cli.tiles",
                f.dir, bin, bin, bin),
        0);
    kit_expect_text((const char *)out.data, "Gaussians kept", __FILE__, __LINE__);
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
        cmocka_unit_test(nonsense_is_refused),
        cmocka_unit_test(the_program_clips),
    };
    return cmocka_run_group_tests_name("clip", tests, setup, survey_teardown);
}
