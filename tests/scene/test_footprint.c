/* The footprint: against a survey of known geometry, as GeoJSON and back, and its effect on a
 * Gaussian.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/geojson.h"
#include "scene/cells/footprint.h"
#include "tests/scene/flight_kit.h"

/* The flight, and a tower in its middle. */
static void survey(struct scene *s)
{
    flight_kit_scene(s);
    for (size_t i = 0; i < s->n_points; i++) {
        const double *at = s->points[i].enu_m;
        s->points[i].enu_m[2] = fabs(at[0]) < 10 && fabs(at[1]) < 10 ? 25.0 : 0.0;
    }
}

static double weight(const struct footprint *f, double x, double y, double z, double sigma_m)
{
    const double mean[3] = {x, y, z}, v = sigma_m * sigma_m, cov[9] = {v, 0, 0, 0, v, 0, 0, 0, v};
    return footprint_weight(f, mean, cov);
}

/* Photographs that see a place of the ground. */
static int views(double x, double y)
{
    int n = 0;
    for (int i = 0; i < SIDE * SIDE; i++)
        n += fabs(x - (STEP * (i % SIDE) - 50)) < 40 && fabs(y - (STEP * (i / SIDE) - 50)) < 30;
    return n;
}

static void test_known_survey(void **state)
{
    struct scene s;
    struct footprint f;
    struct err e = {0};
    size_t wrong = 0, n = 0;
    survey(&s);
    kit_ok(footprint_of(&s, &f, &e), e);
    assert_true(f.nx > 0);
    for (size_t j = 0; j < f.ny; j++)
        for (size_t i = 0; i < f.nx; i++) {
            double x = f.corner_m[0] + ((double)i + 0.5) * f.cell_m,
                   y = f.corner_m[1] + ((double)j + 0.5) * f.cell_m;
            n += views(x, y) >= FOOTPRINT_VIEWS;
            wrong += (views(x, y) >= FOOTPRINT_VIEWS) != f.inside[j * f.nx + i];
            assert_true(f.views[j * f.nx + i] == views(x, y) || f.ground_m[j * f.nx + i] > 1);
        }
    print_message("%zu x %zu cells of %.2f m, %zu of %zu inside are wrong, %.2f px/m\n", f.nx, f.ny,
                  f.cell_m, wrong, n, f.px_per_m);
    assert_true(n > 300);
    assert_true((double)wrong <=
                0.02 * (double)n); /* cells that a border cuts; the tower's parallax */
    assert_true(fabs(f.px_per_m - 300 / HEIGHT) < 0.1);

    /* Well inside all of it, far outside nothing, in between ever less. */
    assert_true(weight(&f, 0, 30, 0.5, 0.1) == 1.0);
    assert_true(weight(&f, 150, 0, 0, 0.1) == 0.0);
    assert_true(weight(&f, 1e6, 0, 0, 0.1) == 0.0);
    double before = 1.0;
    for (double x = 0; x < 120; x += 0.5) {
        double w = weight(&f, x, -30, 0.5, 0.1);
        assert_true(w <= before + 1e-12);
        before = w;
    }
    /* Above the tower's neighbourhood and below the ground is nothing; on the tower there is. */
    assert_true(weight(&f, 0, 0, 25, 0.2) == 1.0);
    assert_true(weight(&f, 40, 40, 45, 0.2) == 0.0);
    assert_true(weight(&f, 40, 40, -25, 0.2) == 0.0);
    /* So many metres above or below what stands around; nothing is known far away. */
    const double above[3] = {40, 40, 12}, below[3] = {40, 40, -7}, on_tower[3] = {8, 0, 12},
                 away[3] = {1e5, 0, 500};
    assert_true(fabs(footprint_off(&f, above) - 12) < 0.01);
    assert_true(fabs(footprint_off(&f, below) - 7) < 0.01);
    assert_true(footprint_off(&f, on_tower) < 0.0 && footprint_off(&f, away) < -1e9);
    assert_true(fabs(f.height_m - HEIGHT) < 0.01);
    /* Rays: down to ground that is seen, to ground that is not, past the tower, into the sky. */
    const double eye[3] = {-40, -40, 60}, down[3] = {0.1, 0, -1}, aslant[3] = {0, -2, -1},
                 long_way[3] = {2.5, 2.5, -2}, sky[3] = {0, 0.5, 0.1};
    ptrdiff_t under = footprint_meets(&f, eye, down), far = footprint_meets(&f, eye, long_way),
              out = footprint_meets(&f, eye, aslant);
    assert_true(under >= 0 && f.inside[under] && far >= 0 && f.inside[far]);
    assert_true(out >= 0 && !f.inside[out] && footprint_meets(&f, eye, sky) < 0);
    /* What is as large as the survey reaches out of it, wherever its middle is. */
    assert_true(weight(&f, 0, 40, 0.5, 60.0) == 0.0);
    footprint_free(&f);
    arena_free(&s.arena);
}

static void test_geojson_and_back(void **state)
{
    struct scene s;
    struct footprint f, g;
    struct buf b = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    survey(&s);
    kit_ok(footprint_of(&s, &f, &e), e);
    kit_ok(footprint_write(&f, &s.origin, &b, &e), e);
    kit_ok(file_join(path, kit_tmp, "footprint.geojson", &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    json_t *root;
    kit_ok(jsonc_read(path, &root, &e), e);
    const json_t *geometry = json_object_get(root, "geometry"),
                 *p = json_object_get(root, "properties"),
                 *ring =
                     json_array_get(json_array_get(json_object_get(geometry, "coordinates"), 0), 0);
    assert_string_equal(json_string_value(json_object_get(geometry, "type")), "MultiPolygon");
    assert_true(json_array_size(json_object_get(geometry, "coordinates")) == 1);
    assert_true(json_array_size(ring) >= 5 && json_array_size(ring) < 200);
    assert_true(
        json_equal(json_array_get(ring, 0), json_array_get(ring, json_array_size(ring) - 1)));
    double area = json_number_value(json_object_get(p, "area_m2")), inside = 0.0;
    for (size_t i = 0; i < f.nx * f.ny; i++)
        inside += f.inside[i] * f.cell_m * f.cell_m;
    print_message("%.0f m2 in %zu corners, %.0f m2 of cells\n", area, json_array_size(ring),
                  inside);
    assert_true(fabs(area - inside) < 0.03 * inside);
    json_decref(root);
    kit_ok(footprint_of(&s, &g, &e), e);
    memset(g.inside, 0, g.nx * g.ny);
    kit_ok(footprint_read(&g, path, &s.origin, &e), e);
    size_t wrong = 0;
    for (size_t i = 0; i < f.nx * f.ny; i++)
        wrong += f.inside[i] != g.inside[i];
    assert_true((double)wrong < 0.02 * (double)(f.nx * f.ny));
    footprint_free(&g);
    g = (struct footprint){0}; /* the polygons alone */
    kit_ok(footprint_read(&g, path, &s.origin, &e), e);
    assert_true(weight(&g, 0, 0, 1000, 0.1) == 1.0 && weight(&g, 150, 0, 0, 0.1) == 0.0);
    footprint_free(&g);
    footprint_free(&f);
    buf_free(&b);
    arena_free(&s.arena);
}

/* A hole stays a hole, and two islands two polygons. */
static void test_holes(void **state)
{
    static const char text[] =
        "{\"type\":\"FeatureCollection\",\"features\":["
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"Polygon\",\"coordinates\":["
        "[[7.57,47.56],[7.574,47.56],[7.574,47.564],[7.57,47.564],[7.57,47.56]],"
        "[[7.571,47.561],[7.571,47.563],[7.573,47.563],[7.573,47.561],[7.571,47.561]]]}},"
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"Polygon\",\"coordinates\":["
        "[[7.576,47.56],[7.578,47.56],[7.578,47.562],[7.576,47.562],[7.576,47.56]]]}}]}";
    const struct geo_origin origin = {7.57, 47.56, 280};
    struct footprint f = {0};
    struct buf b = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, kit_tmp, "holes.geojson", &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
    kit_ok(footprint_read(&f, path, &origin, &e), e);
    kit_ok(footprint_write(&f, &origin, &b, &e), e);
    json_t *root;
    kit_ok(jsonc_parse((const char *)b.data, b.size, "written", &root, &e), e);
    const json_t *polygons = json_object_get(json_object_get(root, "geometry"), "coordinates");
    size_t rings = 0;
    assert_int_equal(json_array_size(polygons), 2);
    for (size_t i = 0; i < 2; i++)
        rings += json_array_size(json_array_get(polygons, i));
    assert_int_equal(rings, 3);
    json_decref(root);
    double enu[3];
    kit_ok(geo_to_enu(&origin, 7.572, 47.562, 280, enu, &e), e);
    assert_true(weight(&f, enu[0], enu[1], 0, 0.1) == 0.0);
    kit_ok(geo_to_enu(&origin, 7.5705, 47.562, 280, enu, &e), e);
    assert_true(weight(&f, enu[0], enu[1], 0, 0.1) == 1.0);
    footprint_free(&f);
    buf_free(&b);
}

/* Polygons that overlap or lie in each other add up; only a ring of the same polygon is a hole. The
 * file begins as Windows begins files. */
static void test_polygons_add_up(void **state)
{
    static const char text[] =
        "\xef\xbb\xbf{\"type\":\"FeatureCollection\",\"features\":["
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"MultiPolygon\",\"coordinates\":["
        "[[[7.57,47.56],[7.573,47.56],[7.573,47.564],[7.57,47.564],[7.57,47.56]]],"
        "[[[7.572,47.56],[7.576,47.56],[7.576,47.564],[7.572,47.564],[7.572,47.56]]]]}},"
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"Polygon\",\"coordinates\":["
        "[[7.5705,47.561],[7.571,47.561],[7.571,47.563],[7.5705,47.563],[7.5705,47.561]]]}},"
        "{\"type\":\"Feature\",\"geometry\":{\"type\":\"Polygon\",\"coordinates\":["
        "[[7.574,47.563],[7.578,47.563],[7.578,47.566],[7.574,47.566],[7.574,47.563]],"
        "[[7.577,47.5632],[7.577,47.5658],[7.5778,47.5658],[7.5778,47.5632],[7.577,47.5632]]]}}]}";
    static const struct {
        double lon, lat;
        bool in;
    } places[] = {{7.5725, 47.562, true}, /* in the first two */
                  {7.5707, 47.562, true}, /* in the one inside of the first */
                  {7.5702, 47.562, true},  {7.575, 47.5635, true},   {7.577, 47.562, false},
                  {7.575, 47.5655, true},  {7.5774, 47.5645, false}, /* the hole */
                  {7.5718, 47.566, false}, {7.569, 47.562, false}};
    const struct geo_origin origin = {7.57, 47.56, 280};
    struct footprint f = {0};
    struct geojson_area area;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, kit_tmp, "many.geojson", &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
    kit_ok(footprint_read(&f, path, &origin, &e), e);
    kit_ok(geojson_read(path, &area, &e), e);
    for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
        double enu[3];
        kit_ok(geo_to_enu(&origin, places[i].lon, places[i].lat, 280, enu, &e), e);
        assert_int_equal(geojson_holds(area.edges, area.n, places[i].lon, places[i].lat),
                         places[i].in);
        assert_true(weight(&f, enu[0], enu[1], 0, 0.1) == (places[i].in ? 1.0 : 0.0));
    }
    geojson_free(&area);
    footprint_free(&f);
}

static void expect(const char *text, enum err_code want, const char *word)
{
    const struct geo_origin origin = {7.57, 47.56, 280};
    struct footprint f = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, kit_tmp, "bad.geojson", &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
    assert_int_equal(footprint_read(&f, path, &origin, &e), want);
    if (!strstr(e.msg, word) || !strstr(e.msg, "bad.geojson"))
        fail_msg("'%s' does not say %s and which file", e.msg, word);
    footprint_free(&f);
}

static void test_bad_input(void **state)
{
    struct scene s = {0};
    struct footprint f;
    struct err e = {0};
    expect("{\"type\":\"Point\",\"coordinates\":[1,2]}", ERR_FORMAT, "Point");
    expect("{\"type\":\"FeatureCollection\",\"features\":[]}", ERR_FORMAT, "no polygon");
    expect("{\"type\":\"Polygon\",\"coordinates\":[[[1,2],[2,3],[1,2]]]}", ERR_FORMAT, "four");
    expect("{\"type\":\"Polygon\",\"coordinates\":[[[1,2],\"x\",[1,3],[1,2]]]}", ERR_FORMAT,
           "longitude");
    expect("{\"type\":\"Polygon\",\"coordinates\":[[[1,92],[2,3],[1,3],[1,92]]]}", ERR_FORMAT,
           "92");
    expect("{\"type\":\"Polygon\",\"coordinates\":[[[7.57,47.56],[7.574,47.56],[7.574,47.564],"
           "[7.57,47.564]]]}",
           ERR_FORMAT, "not closed");
    expect("{\"type\":\"Polygon\",\"crs\":{\"type\":\"name\",\"properties\":{\"name\":"
           "\"urn:ogc:def:crs:EPSG::2056\"}},\"coordinates\":[[[7.57,47.56],[7.574,47.56],"
           "[7.574,47.564],[7.57,47.56]]]}",
           ERR_FORMAT, "ogr2ogr");
    log_set_level(LOG_ERROR); /* it warns that nothing is known */
    kit_ok(footprint_of(&s, &f, &e), e);
    log_set_level(LOG_WARN);
    assert_true(f.nx == 0 && weight(&f, 1, 2, 3, 4) == 1.0);
    struct buf b = {0};
    assert_int_equal(footprint_write(&f, &s.origin, &b, &e), ERR_DATA);
    survey(&s); /* polygons of another place */
    kit_ok(footprint_of(&s, &f, &e), e);
    char path[FILE_PATH_MAX];
    static const char far[] = "{\"type\":\"Polygon\",\"coordinates\":[[[8,47],[8.1,47],[8.1,47.1],"
                              "[8,47]]]}";
    kit_ok(file_join(path, kit_tmp, "far.geojson", &e), e);
    kit_ok(file_write(path, far, strlen(far), &e), e);
    assert_int_equal(footprint_read(&f, path, &s.origin, &e), ERR_DATA);
    footprint_free(&f);
    arena_free(&s.arena);
}

/* Any allocation may fail: then it says so, and makes no other footprint. */
static void test_out_of_memory(void **state)
{
    struct scene s;
    struct footprint want, f = {0};
    struct err e = {0};
    survey(&s);
    kit_ok(footprint_of(&s, &want, &e), e);
    kit_out_of_memory((footprint_free(&f), footprint_of(&s, &f, &e)), 4, e);
    assert_true(f.height_m == want.height_m && f.cell_m == want.cell_m);
    footprint_free(&f);
    footprint_free(&want);
    arena_free(&s.arena);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_known_survey),  cmocka_unit_test(test_geojson_and_back),
        cmocka_unit_test(test_holes),         cmocka_unit_test(test_bad_input),
        cmocka_unit_test(test_out_of_memory), cmocka_unit_test(test_polygons_add_up),
    };
    return cmocka_run_group_tests(tests, kit_tmp_make, kit_tmp_remove);
}
