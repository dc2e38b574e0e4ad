/* Contour lines and points of a surface with known truth, the procedural city: where they lie, what
 * other readers find in the files, and what is refused. Heights above sea level use a geoid that is
 * made here.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey/survey_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <gdal/gdal.h>
#include <gdal/ogr_api.h>
#include <gdal/ogr_srs_api.h>
#include <jansson.h>

#include "survey/contour.h"
#include "survey/las.h"
#include "survey/sheet.h"
#include "survey/surface_points.h"

#define GSD_M 0.25
#define INTERVAL_M 2.04 /* no line lies at 160 m, the height of the city's level ground */
#define UNDULATION_M 47 /* of the made geoid, with a slope to the east */

struct vertex {
    double at[3]; /* ENU x, y; height of the line above the origin */
};
struct lines {
    struct vertex *v;
    size_t n, n_lines;
};

static void path_of(const char *name, char out[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(out, f.dir, name, &e), e);
}

static struct contour_request request(double least_m)
{
    return (struct contour_request){{.kind = GEOTIFF_HEIGHT, .gsd_m = GSD_M}, INTERVAL_M, least_m};
}

static void read_line(const json_t *feature, struct lines *out)
{
    struct err e = {0};
    const json_t *shape = json_object_get(feature, "geometry"), *at,
                 *height = json_object_get(json_object_get(feature, "properties"), "height_m");
    double h = json_number_value(height), k_of = h / INTERVAL_M;
    size_t k;
    assert_string_equal(json_string_value(json_object_get(shape, "type")), "LineString");
    assert_true(json_is_number(height) && fabs(k_of - round(k_of)) < 1e-9);
    json_array_foreach(json_object_get(shape, "coordinates"), k, at)
    {
        double enu[3];
        kit_ok(geo_to_enu(&origin, json_number_value(json_array_get(at, 0)),
                          json_number_value(json_array_get(at, 1)), origin.h_m, enu, &e),
               e);
        out->v[out->n++] = (struct vertex){{enu[0], enu[1], h - origin.h_m}};
    }
    out->n_lines++;
}

static void read_geojson(const char *path, struct lines *out)
{
    struct err e = {0};
    json_t *root, *feature;
    size_t i, cap = 0;
    kit_ok(jsonc_read(path, &root, &e), e);
    json_array_foreach(json_object_get(root, "features"), i, feature) cap +=
        json_array_size(json_object_get(json_object_get(feature, "geometry"), "coordinates"));
    *out = (struct lines){.v = mem_array(cap + 1, sizeof *out->v)};
    assert_non_null(out->v);
    json_array_foreach(json_object_get(root, "features"), i, feature) read_line(feature, out);
    json_decref(root);
}

static bool inside(double x, double y, double margin)
{
    return fabs(x) < 0.5 * EXTENT_M - margin && fabs(y) < 0.5 * EXTENT_M - margin;
}

/* Every place of every line is one where the city has its height, within two pixels; also on walls,
 * where the city has all heights from street to roof. */
static void lines_lie_at_their_heights(const struct lines *l)
{
    size_t n = 0, off = 0;
    for (size_t i = 0; i < l->n; i++) {
        const double *at = l->v[i].at;
        double lo = HUGE_VAL, hi = -HUGE_VAL;
        if (!inside(at[0], at[1], 1))
            continue;
        for (int k = 0; k < 25; k++) {
            double z = truth_z(at[0] + (k % 5 - 2) * GSD_M, at[1] + (k / 5 - 2) * GSD_M);
            lo = fmin(lo, z);
            hi = fmax(hi, z);
        }
        n++;
        off += !(at[2] > lo - 0.2 && at[2] < hi + 0.2);
    }
    printf("contours: %zu of %zu places are more than 2 px from where the city has that height\n",
           off, n);
    assert_true(n > 5000 && (double)off < 0.002 * (double)n);
}

/* Wherever the city goes through a height of a line within a metre, such a line is near. */
static void no_line_is_missing(const struct lines *l)
{
    size_t n = 0, missing = 0;
    for (int i = 0; i < 20000; i++) {
        double x = (rng_unit(7, 0, (uint64_t)i) - 0.5) * (EXTENT_M - 6),
               y = (rng_unit(7, 1, (uint64_t)i) - 0.5) * (EXTENT_M - 6), a = truth_z(x, y),
               b = truth_z(x + 1, y), lo = fmin(a, b) + 0.3, hi = fmax(a, b) - 0.3,
               level = ceil((lo + origin.h_m) / INTERVAL_M) * INTERVAL_M - origin.h_m;
        bool found = false;
        if (!(level < hi))
            continue;
        for (size_t k = 0; k < l->n && !found; k++)
            found = fabs(l->v[k].at[2] - level) < 1e-6 &&
                    hypot(l->v[k].at[0] - x - 0.5, l->v[k].at[1] - y) < 1.5;
        n++;
        missing += !found;
    }
    printf("contours: %zu of %zu steps of the city have no line\n", missing, n);
    assert_true(n > 300 && (double)missing < 0.01 * (double)n);
}

static void lines_are_the_citys(void **state)
{
    char path[FILE_PATH_MAX], few[FILE_PATH_MAX];
    struct err e = {0};
    struct contour_report r, s;
    struct contour_request q = request(0), longer = request(5);
    struct lines l, m;
    path_of("lines.geojson", path);
    kit_ok(contour_write(f.nadir, &q, path, &r, &e), e);
    read_geojson(path, &l);
    assert_int_equal(l.n_lines, r.lines);
    assert_int_equal(l.n, r.points);
    lines_lie_at_their_heights(&l);
    no_line_is_missing(&l);
    path_of("few.JSON", few);
    kit_ok(contour_write(f.nadir, &longer, few, &s, &e), e);
    read_geojson(few, &m);
    printf("contours: %zu lines of %zu points; %zu lines of 5 m and more\n", l.n_lines, l.n,
           m.n_lines);
    assert_true(s.lines + s.n_short == r.lines + r.n_short && s.lines < r.lines && s.lines > 0);
    assert_int_equal(m.n_lines, s.lines);
    mem_free(l.v);
    mem_free(m.v);
}

/* The same lines as a GeoPackage, as GDAL reads it, over a file that was there. */
static void a_geopackage_holds_the_same(void **state)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    struct contour_report r, json;
    struct contour_request q = request(0);
    struct buf out = {0};
    size_t points = 0;
    path_of("lines.gpkg", path);
    kit_ok(file_write(path, "older", 5, &e), e);
    kit_ok(contour_write(f.nadir, &q, path, &r, &e), e);
    path_of("again.geojson", path);
    kit_ok(contour_write(f.nadir, &q, path, &json, &e), e);
    assert_true(r.lines == json.lines && r.points == json.points);
    path_of("lines.gpkg", path);
    GDALDatasetH d = GDALOpenEx(path, GDAL_OF_VECTOR | GDAL_OF_READONLY, NULL, NULL, NULL);
    assert_non_null(d);
    OGRLayerH layer = GDALDatasetGetLayerByName(d, "contours");
    assert_non_null(layer);
    assert_int_equal(OGR_L_GetFeatureCount(layer, TRUE), r.lines);
    assert_string_equal(OSRGetAuthorityCode(OGR_L_GetSpatialRef(layer), NULL), "32632");
    int field = OGR_FD_GetFieldIndex(OGR_L_GetLayerDefn(layer), "height_m");
    assert_true(field >= 0);
    OGR_L_SetAttributeFilter(layer, "height_m > 162 AND height_m < 164");
    assert_true(OGR_L_GetFeatureCount(layer, TRUE) > 0);
    OGR_L_SetAttributeFilter(layer, NULL);
    for (OGRFeatureH line; (line = OGR_L_GetNextFeature(layer)); OGR_F_Destroy(line)) {
        OGRGeometryH g = OGR_F_GetGeometryRef(line);
        points += (size_t)OGR_G_GetPointCount(g);
        assert_true(OGR_G_GetX(g, 0) > r.map.grid.west_m &&
                    OGR_G_GetX(g, 0) < r.map.grid.west_m + r.map.grid.width * GSD_M);
        assert_true(OGR_G_GetY(g, 0) < r.map.grid.north_m &&
                    OGR_G_GetY(g, 0) > r.map.grid.north_m - r.map.grid.height * GSD_M);
    }
    assert_int_equal(points, r.points);
    GDALClose(d);
    assert_int_equal(kit_run(&out, "ls '%s' | grep -c 'part\\|journal\\|wal'", f.dir), 1);
    buf_free(&out);
}

/* ---- points ---- */

static double f64_at(const struct buf *b, size_t at)
{
    struct cursor c = cursor_over(b->data + at, b->size - at);
    return cursor_f64(&c);
}

/* As tests/web/las.test.mjs reads it with another's reader: here the places and colours. */
static void points_lie_on_the_surface(void **state)
{
    const struct map_request q = {.kind = GEOTIFF_COLOR, .gsd_m = 0.5};
    struct map_report r;
    struct crs *crs;
    struct buf b = {0};
    struct err e = {0};
    struct shown sum = {0};
    char path[FILE_PATH_MAX];
    size_t n = 0, off = 0;
    double lo[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, hi[3] = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
    path_of("points.las", path);
    kit_ok(surface_points_write(f.nadir, &q, path, &r, &e), e);
    kit_ok(file_read(path, 0, &b, &e), e);
    assert_memory_equal(b.data, "LASF", 4);
    struct cursor head = cursor_over(b.data + 96, 4), count = cursor_over(b.data + 247, 8);
    size_t start = cursor_u32(&head);
    assert_int_equal(cursor_u64(&count), r.pixels_held);
    assert_int_equal(b.size, start + 36 * r.pixels_held);
    kit_ok(crs_open(32632, &crs, &e), e);
    struct cursor c = cursor_over(b.data + start, b.size - start);
    for (size_t i = 0; i < r.pixels_held; i++) {
        double at[3], enu[3], z_lo = HUGE_VAL, z_hi = -HUGE_VAL;
        for (size_t k = 0; k < 3; k++) {
            at[k] = f64_at(&b, 155 + 8 * k) + (int32_t)cursor_u32(&c) * f64_at(&b, 131 + 8 * k);
            lo[k] = fmin(lo[k], at[k]);
            hi[k] = fmax(hi[k], at[k]);
        }
        assert_non_null(cursor_take(&c, 18));
        double red = cursor_u16(&c) / 65535.0, green = cursor_u16(&c) / 65535.0;
        (void)cursor_u16(&c);
        double h = at[2];
        kit_ok(crs_unproject(crs, 1, &at[0], &at[1], &e), e);
        kit_ok(geo_to_enu(&origin, at[0], at[1], origin.h_m, enu, &e), e);
        if (!inside(enu[0], enu[1], 3))
            continue;
        for (int k = 0; k < 25; k++) {
            double z = truth_z(enu[0] + (k % 5 - 2) * 0.5, enu[1] + (k / 5 - 2) * 0.5);
            z_lo = fmin(z_lo, z);
            z_hi = fmax(z_hi, z);
        }
        n++;
        off += !(h - origin.h_m > z_lo - 0.2 && h - origin.h_m < z_hi + 0.2);
        if (fabs(enu[0]) < 28 && fabs(enu[1]) < 28)
            shown_add(&sum, red, green, enu);
    }
    printf("points: %zu of %zu are more than 2 px from the city's surface, colours shifted by %.3f "
           "and %.3f m\n",
           off, n, shown_shift(&sum, 0), shown_shift(&sum, 1));
    assert_true(!c.bad && n > 10000 && (double)off < 0.002 * (double)n);
    assert_true(fabs(shown_shift(&sum, 0)) < 0.1 && fabs(shown_shift(&sum, 1)) < 0.1);
    for (size_t k = 0; k < 3; k++) {
        assert_true(fabs(f64_at(&b, 179 + 16 * k) - hi[k]) < 1e-6);
        assert_true(fabs(f64_at(&b, 187 + 16 * k) - lo[k]) < 1e-6);
    }
    crs_close(&crs);
    buf_free(&b);
}

static void las_has_limits(void **state)
{
    struct las *l;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct las_info info = {.offset_m = {500000, 5000000, 0}, .wkt = "x", .source = "s"};
    const struct las_point far = {{500000 + 3e6, 5000000, 1}, {0}, 0},
                           nowhere = {{(double)NAN, 0, 0}, {0}, 0};
    path_of("limits.las", path);
    kit_ok(las_create(path, &info, &l, &e), e);
    kit_fails(las_add(l, &far, 1, &e), ERR_ARG, e, "from the offset");
    kit_fails(las_add(l, &nowhere, 1, &e), ERR_ARG, e, "from the offset");
    kit_fails(las_commit(&l, &e), ERR_DATA, e, "no points");
    assert_null(l);
    assert_false(file_exists(path));
    char *wkt = mem_array(70001, 1);
    assert_non_null(wkt);
    memset(wkt, 'x', 70000);
    info.wkt = wkt;
    kit_fails(las_create(path, &info, &l, &e), ERR_LIMIT, e, "65535");
    mem_free(wkt);
    info.wkt = "x";
    path_of("none/limits.las", path);
    kit_fails(las_create(path, &info, &l, &e), ERR_IO, e, "none/limits.las");
}

/* ---- above sea level ---- */

/* A geoid as GeographicLib reads it: UNDULATION_M at the prime meridian, 1 m more every 10 degrees
 * to the east, on a grid of 10 degrees. */
static void write_geoid(const char *name)
{
    struct buf b = {0};
    struct err e = {0};
    char file[64], path[FILE_PATH_MAX];
    buf_printf(&b,
               "P5\n# Description made\n# DateTime 2026-01-01 00:00:00\n# MaxBilinearError 0.1\n"
               "# RMSBilinearError 0.1\n# MaxCubicError 0.1\n# RMSCubicError 0.1\n# Offset -108\n"
               "# Scale 0.003\n# Origin 90N 0E\n# AREA_OR_POINT Point\n# Vertical_Datum WGS84\n"
               "36 19\n65535\n");
    for (int row = 0; row < 19; row++)
        for (int c = 0; c < 36; c++) {
            double east = c < 18 ? c : c - 36; /* both ways from the meridian */
            unsigned v = (unsigned)lround((UNDULATION_M + east + 108) / 0.003);
            buf_u8(&b, v >> 8);
            buf_u8(&b, v & 255);
        }
    snprintf(file, sizeof file, "%s.pgm", name);
    path_of(file, path);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

/* The largest difference of two surface models, m. */
static void compare_sheets(const char *a, const char *b, double *least, double *most)
{
    struct sheet *s[2];
    struct err e = {0};
    const char *path[2] = {a, b};
    float *row[2];
    *least = HUGE_VAL;
    *most = -HUGE_VAL;
    for (int k = 0; k < 2; k++) {
        kit_ok(sheet_open(path[k], GEOTIFF_HEIGHT, &s[k], &e), e);
        assert_int_equal(sheet_grid(s[k])->epsg, 32632);
        row[k] = mem_array(sheet_grid(s[k])->width, sizeof *row[k]);
        assert_non_null(row[k]);
    }
    for (uint32_t y = 0; y < sheet_grid(s[0])->height; y++) {
        for (int k = 0; k < 2; k++)
            kit_ok(sheet_read(s[k], 0, y, sheet_grid(s[k])->width, 1, row[k], &e), e);
        for (uint32_t x = 0; x < sheet_grid(s[0])->width; x++) {
            assert_true((row[0][x] < -9000) == (row[1][x] < -9000));
            if (row[0][x] < -9000)
                continue;
            *least = fmin(*least, (double)row[0][x] - (double)row[1][x]);
            *most = fmax(*most, (double)row[0][x] - (double)row[1][x]);
        }
    }
    for (int k = 0; k < 2; k++) {
        mem_free(row[k]);
        sheet_close(&s[k]);
    }
}

static void heights_count_from_the_sea(void **state)
{
    const char *bin = kit_program();
    double least, most, want = UNDULATION_M + origin.lon_deg / 10;
    char a[FILE_PATH_MAX], b[FILE_PATH_MAX];
    struct buf out = {0};
    write_geoid("egm2008-600");
    write_geoid("local-600");
    path_of("ellipsoid.tif", a);
    path_of("sea.tif", b);
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s' dsm -q city.tiles -o ellipsoid.tif --gsd-m 0.5", f.dir, bin),
        0);
    kit_expect_text((const char *)out.data, "above the WGS 84 ellipsoid, 1", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' dsm -q city.tiles -o sea.tif --gsd-m 0.5 --geoid "
                             "egm2008-600.pgm",
                             f.dir, bin),
                     0);
    kit_expect_text((const char *)out.data, "above sea level by egm2008-600, 1", __FILE__,
                    __LINE__);
    buf_free(&out);
    compare_sheets(a, b, &least, &most);
    printf("sea level: %.4f to %.4f m below the ellipsoid's heights, %.4f made\n", least, most,
           want);
    assert_true(fabs(least - want) < 0.01 && fabs(most - want) < 0.01);
    /* EPSG:3855 is the EGM2008 height. */
    assert_int_equal(kit_run(&out, "gdalinfo -json '%s'", b), 0);
    kit_expect_text((const char *)out.data, "EGM2008 height", __FILE__, __LINE__);
    kit_expect_text((const char *)out.data, "3855", __FILE__, __LINE__);
    kit_expect_text((const char *)out.data, "height above sea level by egm2008-600", __FILE__,
                    __LINE__);
    buf_free(&out);
    /* A geoid without a code: the projection alone, and the description. */
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' dsm -q city.tiles -o local.tif --gsd-m 0.5 --geoid "
                             "./local-600 && gdalinfo -json local.tif",
                             f.dir, bin),
                     0);
    kit_expect_text((const char *)out.data, "height above sea level by local-600", __FILE__,
                    __LINE__);
    if (strstr((const char *)out.data, "COMPD_CS") || strstr((const char *)out.data, "VERTCRS"))
        fail_msg("heights of an unknown geoid got a code: %s", (const char *)out.data);
    buf_free(&out);
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' points -q city.tiles -o sea.las --gsd-m 1 --geoid "
                             "./egm2008-600.pgm && grep -ac 'EGM2008 height' sea.las",
                             f.dir, bin),
                     0);
    buf_free(&out);
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s' dsm -q city.tiles -o no.tif --geoid ./none", f.dir, bin), 1);
    kit_expect_text((const char *)out.data, "geographiclib-get-geoids", __FILE__, __LINE__);
    buf_free(&out);
}

/* ---- what is refused ---- */

static void nonsense_is_refused(void **state)
{
    static const struct {
        const char *args, *says;
        int status;
    } bad[] = {
        {"contour city.tiles -o no.shp", ".geojson or .gpkg", 2},
        {"contour city.tiles -o no.gpkg --interval-m 0", "interval", 2},
        {"contour city.tiles -o no.geojson --interval-m 0.001 --gsd-m 1", "at most 10000", 2},
        {"contour city.tiles -o none/no.gpkg --gsd-m 1", "none/no.gpkg", 1},
        {"contour city.tiles -o no.gpkg --bbox 9,51,9.1,52", "the area is empty", 2},
        {"contour city.tiles", "-o FILE is missing", 2},
        {"points city.tiles -o no.las --gsd-m 0.0008", "points: at most", 2},
        {"points city.tiles -o no.las --bbox 9,51,9.1,52", "the area is empty", 2},
        {"points none.tiles -o no.las", "none.tiles", 1},
    };
    struct buf out = {0};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        int status = kit_run(&out, "cd '%s' && '%s' %s -q", f.dir, kit_program(), bad[i].args);
        if (status != bad[i].status)
            fail_msg("%s: exit %d: %s", bad[i].args, status, (const char *)out.data);
        kit_expect_text((const char *)out.data, bad[i].says, __FILE__, __LINE__);
        buf_free(&out);
    }
    assert_int_equal(kit_run(&out, "ls '%s' | grep -c 'no\\.\\|part'", f.dir), 1); /* none */
    buf_free(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lines_are_the_citys),        cmocka_unit_test(a_geopackage_holds_the_same),
        cmocka_unit_test(points_lie_on_the_surface),  cmocka_unit_test(las_has_limits),
        cmocka_unit_test(heights_count_from_the_sea), cmocka_unit_test(nonsense_is_refused),
    };
    return cmocka_run_group_tests_name("contour", tests, survey_setup, survey_teardown);
}
