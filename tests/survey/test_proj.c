/* Coordinates against other programs: PROJ's cs2cs and cct, GDAL's gdaltransform and
 * gdallocationinfo, GeographicLib's GeoConvert. The local frame and ECEF (by GeographicLib) are
 * compared with PROJ, map projections (by PROJ) with GeographicLib, and tiles (our own code) with
 * PROJ. Places include the poles, borders of zones, both sides of the antimeridian and both
 * hemispheres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/splat/glb.h"
#include "core/device/dev.h"
#include "core/geo/geo.h"
#include "lod/make/pyramid.h"
#include "lod/store/key.h"
#include "lod/store/store.h"
#include "survey/crs.h"

enum { PLACES = 400 };
#define MERCATOR_M 20037508.342789244
/* Two programs print 1e-9 m of numbers up to 2e7 m, which doubles hold to 4e-9 m. */
static const double same_m = 1e-6;
static const double same_deg = 1e-11; /* of 1.1e5 m each */

static bool there(const char *program)
{
    struct buf out = {0};
    bool found = kit_run(&out, "command -v %s", program) == 0;
    buf_free(&out);
    if (!found)
        print_message("skipped: no %s\n", program);
    return found;
}

/* Lines of `columns` numbers through a command's standard input and back. A line that a program
 * refuses is an error. */
static void through(const char *command, const double *in, size_t n, size_t columns, double *out,
                    size_t out_columns)
{
    struct buf lines = {0}, said = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    for (size_t i = 0; i < n * columns; i++)
        buf_printf(&lines, "%.17g%c", in[i], (i + 1) % columns ? ' ' : '\n');
    kit_ok(buf_check(&lines, &e), e);
    kit_ok(file_join(path, kit_tmp, "lines", &e), e);
    kit_ok(file_write(path, lines.data, lines.size, &e), e);
    buf_free(&lines);
    int rc = kit_run(&said, "%s <'%s'", command, path);
    buf_u8(&said, 0);
    if (rc)
        fail_msg("%s: exit code %d: %s", command, rc, (const char *)said.data);
    char *at = (char *)said.data;
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < out_columns; k++) {
            char *end;
            out[i * out_columns + k] = strtod(at, &end);
            if (end == at)
                fail_msg("%s: line %zu: %.80s", command, i, at);
            at = end;
        }
        at += strcspn(at, "\n");
    }
    buf_free(&said);
}

/* Places of all kinds, longitude and latitude: a random sphere, and those that are hard. */
static size_t places_make(double (*out)[2])
{
    static const double hard[][2] = {
        {0, 0},          {-1e-9, -1e-9},   {6, 50},          {5.999999999, 50}, {12, -35},
        {179.9999, -17}, {-179.9999, -17}, {179.999999, 65}, {-179.999999, 65}, {5.3, 60.4},
        {2.999999, 60},  {3, 63.999999},   {3, 64},          {11.9, 56},        {15.6, 78.2},
        {8.999999, 78},  {9, 72},          {20.9999, 80},    {21, 80},          {33, 80},
        {41.9, 79},      {-62.3, 82.5},    {25, 83.99999},   {166.7, -77.85},   {-60, -79.9999},
        {106.8, 10.8},   {-43.2, -22.9},   {174.8, -41.3},   {151.2, -33.9},    {-70.9, -53.2},
    };
    size_t n = sizeof hard / sizeof *hard;
    memcpy(out, hard, sizeof hard);
    for (uint64_t i = 0; n < PLACES; i++, n++) {
        out[n][0] = 360 * rng_unit(14, 0, i) - 180;
        out[n][1] = asin(2 * rng_unit(14, 1, i) - 1) * 180 / M_PI;
        if (fabs(out[n][1]) > 79.9)
            out[n][1] /= 1.2;
    }
    return n;
}

/* ---- map projections ---- */

/* The zone and its metres by GeographicLib, whose transverse Mercator is exact. */
static void utm_is_geographiclibs(void **state)
{
    double at[PLACES][2], worst = 0, back = 0;
    size_t n = places_make(at);
    struct buf lines = {0}, said = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    if (!there("GeoConvert"))
        skip();
    for (size_t i = 0; i < n; i++)
        buf_printf(&lines, "%.12f %.12f\n", at[i][1], at[i][0]);
    kit_ok(file_join(path, kit_tmp, "utm", &e), e);
    kit_ok(file_write(path, lines.data, lines.size, &e), e);
    buf_free(&lines);
    assert_int_equal(kit_run(&said, "GeoConvert -u -p 9 <'%s'", path), 0);
    buf_u8(&said, 0);
    const char *line = (const char *)said.data;
    for (size_t i = 0; i < n; i++, line += strcspn(line, "\n") + 1) {
        struct crs *c;
        int zone = 0;
        char half = 0;
        double x, y, ours[2] = {at[i][0], at[i][1]};
        if (sscanf(line, "%d%c %lf %lf", &zone, &half, &x, &y) != 4)
            fail_msg("GeoConvert of %.9f,%.9f: %.60s", at[i][1], at[i][0], line);
        int epsg = (half == 's' ? 32700 : 32600) + zone;
        if (crs_utm(at[i][0], at[i][1]) != epsg)
            fail_msg("%.9f,%.9f: EPSG:%d, GeoConvert says %d", at[i][0], at[i][1],
                     crs_utm(at[i][0], at[i][1]), epsg);
        kit_ok(crs_open(epsg, &c, &e), e);
        kit_ok(crs_project(c, 1, &ours[0], &ours[1], &e), e);
        worst = fmax(worst, hypot(ours[0] - x, ours[1] - y));
        kit_ok(crs_unproject(c, 1, &x, &y, &e), e);
        back = fmax(back,
                    hypot(remainder(x - at[i][0], 360) * cos(at[i][1] * M_PI / 180), y - at[i][1]));
        crs_close(&c);
    }
    buf_free(&said);
    printf("proj: UTM of %zu places within %.2g m of GeographicLib, back within %.2g deg\n", n,
           worst, back);
    assert_true(worst < same_m && back < same_deg);
}

/* Projections of countries and of the poles, in the order of axes that each authority has. */
static const struct projection {
    int epsg;
    double box[4]; /* where it is used */
    bool north_first;
} projections[] = {
    {25832, {6, 47, 12, 55}, false},
    {25833, {12, 47, 18, 55}, false},
    {2154, {-4, 42, 8, 51}, false},
    {27700, {-6, 50, 1, 58}, false},
    {28992, {3.5, 51, 7, 53.5}, false},
    {2180, {14.5, 49.2, 24, 54.5}, true},
    {2056, {6, 46, 10.4, 47.7}, false},
    {31287, {9.6, 46.5, 17, 49}, true},
    {3006, {11, 55.5, 23, 68.5}, true},
    {3067, {20, 60, 31, 69.5}, false},
    {3035, {-8, 36, 30, 69}, true},
    {2193, {167, -46.5, 178, -35}, true},
    {7856, {150, -38, 155, -28}, false},
    {6677, {138.6, 34.8, 141, 37}, true},
    {31983, {-48, -33, -42, -5}, false},
    {32632, {0, -10, 18, 83}, false},
    {32733, {12, -79, 18, -1}, false},
    {32760, {177, -40, 179.99, -10}, false},
    {32701, {-179.99, -40, -174, -10}, false},
    {3832, {140, -40, 179.99, 40}, false},
    {3857, {-179.99, -85, 179.99, 85}, false},
    {5041, {-180, 84, 180, 89.9}, false},
    {32661, {-180, 84, 180, 89.9}, true},
    {32761, {-180, -89.9, 180, -80}, true},
    {3031, {-180, -89, 180, -61}, false},
    {3413, {-180, 61, 180, 89}, false},
};

/* Largest distance so far of N places by ours, from gdaltransform's [0] and from cs2cs' [1]. */
static void projection_is_projs(size_t k, bool cs2cs, double worst[2])
{
    enum { N = 40 };
    const struct projection *p = &projections[k];
    double lonlat[N][2], latlon[N][2], gdal[N][2], proj[N][2];
    struct err e = {0};
    struct crs *c;
    char command[200];
    for (uint64_t i = 0; i < N; i++) {
        lonlat[i][0] = latlon[i][1] = p->box[0] + rng_unit(k, 2, i) * (p->box[2] - p->box[0]);
        lonlat[i][1] = latlon[i][0] = p->box[1] + rng_unit(k, 3, i) * (p->box[3] - p->box[1]);
    }
    snprintf(command, sizeof command, "gdaltransform -s_srs EPSG:4326 -t_srs EPSG:%d", p->epsg);
    through(command, lonlat[0], N, 2, gdal[0], 2);
    snprintf(command, sizeof command, "cs2cs -f %%.9f EPSG:4326 EPSG:%d", p->epsg);
    if (cs2cs)
        through(command, latlon[0], N, 2, proj[0], 2);
    kit_ok(crs_open(p->epsg, &c, &e), e);
    for (size_t i = 0; i < N; i++) {
        double x = lonlat[i][0], y = lonlat[i][1];
        kit_ok(crs_project(c, 1, &x, &y, &e), e);
        worst[0] = fmax(worst[0], hypot(x - gdal[i][0], y - gdal[i][1]));
        double off = cs2cs ? hypot(x - proj[i][p->north_first], y - proj[i][!p->north_first]) : 0;
        if (!(off < same_m))
            fail_msg("EPSG:%d of %.9f,%.9f: %.6f %.6f, cs2cs says %.6f %.6f", p->epsg, lonlat[i][0],
                     lonlat[i][1], x, y, proj[i][0], proj[i][1]);
        worst[1] = fmax(worst[1], off);
    }
    crs_close(&c);
}

static void projections_are_projs(void **state)
{
    double worst[2] = {0};
    bool cs2cs = there("cs2cs");
    size_t n = sizeof projections / sizeof *projections;
    for (size_t k = 0; k < n; k++)
        projection_is_projs(k, cs2cs, worst);
    printf("proj: %zu projections within %.2g m of gdaltransform, %.2g m of cs2cs%s\n", n, worst[0],
           worst[1], cs2cs ? "" : " (not there)");
    assert_true(worst[0] < same_m);
}

/* ---- tiles ---- */

/* Corners of tiles are even in EPSG:3857, at every zoom, and places lie in the tile that PROJ's
 * metres say. */
static void tiles_are_web_mercator(void **state)
{
    double at[PLACES][2], metres[PLACES][2], worst = 0;
    size_t n = places_make(at);
    struct key key[PLACES];
    for (size_t i = 0; i < n; i++) {
        double west, south, east, north;
        key[i] = key_at(at[i][0], at[i][1], (uint8_t)(i % (KEY_ZOOM_MAX + 1)));
        key_bounds(key[i], &west, &south, &east, &north);
        assert_true(west <= at[i][0] && at[i][0] < east);
        at[i][0] = i % 2 ? west : east; /* corners from here on */
        at[i][1] = i / 2 % 2 ? south : north;
    }
    through("gdaltransform -s_srs EPSG:4326 -t_srs EPSG:3857", at[0], n, 2, metres[0], 2);
    for (size_t i = 0; i < n; i++) {
        double edge = 2 * MERCATOR_M / pow(2, key[i].z),
               x = (key[i].x + (i % 2 ? 0.0 : 1.0)) * edge - MERCATOR_M,
               y = MERCATOR_M - (key[i].y + (i / 2 % 2 ? 1.0 : 0.0)) * edge;
        double off = hypot(remainder(metres[i][0] - x, 2 * MERCATOR_M), metres[i][1] - y);
        if (!(off < 10 * same_m))
            fail_msg("corner of %u/%u/%u: %.9f %.9f, gdaltransform says %.9f %.9f", key[i].z,
                     key[i].x, key[i].y, x, y, metres[i][0], metres[i][1]);
        worst = fmax(worst, off);
    }
    printf("proj: corners of %zu tiles within %.2g m of gdaltransform's EPSG:3857\n", n, worst);
}

/* ---- the frame ---- */

/* ENU and ECEF by GeographicLib against PROJ's cart and topocentric: places around one. */
static void frame_is_projs(uint64_t i, const struct geo_origin *o, double worst[3])
{
    enum { AROUND = 5 };
    struct err e = {0};
    double m[16], in[AROUND][4], ecef[AROUND][4], enu[AROUND][4], ours[3], lon, lat, h;
    char command[400];
    for (uint64_t k = 0; k < AROUND; k++) {
        in[k][0] = k ? o->lon_deg + 0.2 * (rng_unit(6, i, k) - 0.5) : o->lon_deg;
        in[k][1] = k ? o->lat_deg + 0.1 * (rng_unit(7, i, k) - 0.5) : o->lat_deg;
        in[k][2] = k ? o->h_m + 800 * rng_unit(8, i, k) : o->h_m;
        in[k][3] = 0;
    }
    through("cct -d 9 +proj=cart +ellps=WGS84", in[0], AROUND, 4, ecef[0], 4);
    snprintf(command, sizeof command,
             "cct -d 9 +proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric "
             "+ellps=WGS84 +lon_0=%.17g +lat_0=%.17g +h_0=%.17g",
             o->lon_deg, o->lat_deg, o->h_m);
    through(command, in[0], AROUND, 4, enu[0], 4);
    kit_ok(geo_enu_to_ecef(o, m, &e), e);
    for (size_t k = 0; k < AROUND; k++) {
        kit_ok(geo_to_enu(o, in[k][0], in[k][1], in[k][2], ours, &e), e);
        for (size_t a = 0; a < 3; a++) {
            double place = m[a] * ours[0] + m[4 + a] * ours[1] + m[8 + a] * ours[2] + m[12 + a];
            worst[0] = fmax(worst[0], fabs(ours[a] - enu[k][a]));
            worst[1] = fmax(worst[1], fabs(place - ecef[k][a]));
        }
        kit_ok(geo_from_enu(o, enu[k], &lon, &lat, &h, &e), e);
        worst[2] = fmax(worst[2], fabs(lat - in[k][1]));
        worst[2] =
            fmax(worst[2], fabs(remainder(lon - in[k][0], 360)) * cos(in[k][1] * M_PI / 180));
    }
}

static void frames_are_projs(void **state)
{
    double at[PLACES][2], worst[3] = {0};
    places_make(at);
    if (!there("cct"))
        skip();
    for (uint64_t i = 0; i < 40; i++) {
        const struct geo_origin o = {at[i][0], at[i][1], 3000 * rng_unit(5, 0, i) - 200};
        frame_is_projs(i, &o, worst);
    }
    printf("proj: east-north-up within %.2g m of cct, ECEF %.2g m, back %.2g deg\n", worst[0],
           worst[1], worst[2]);
    assert_true(worst[0] < same_m && worst[1] < same_m && worst[2] < same_deg);
}

/* ---- cities at hard places, through the program ---- */

enum { SIDE = 160, ALL = SIDE * SIDE }; /* Gaussians of a city */
#define SPACING_M 0.25
#define EXTENT_M (SIDE * SPACING_M)
static const struct geo_origin cities[] = {
    {15.6356, 78.2232, 40},   /* Longyearbyen: zone 33 is wider there */
    {5.9995, 60.3929, 20},    /* Norway: where zone 31 would end */
    {-0.0001, 51.4779, 70},   /* both sides of Greenwich */
    {-78.4558, 0.0001, 2800}, /* both sides of the equator */
    {179.9990, -16.8, 30},    /* 107 m west of the antimeridian */
    {-179.9990, -16.8, 30},   /* and east of it */
    {166.6683, -77.8463, 25}, /* McMurdo */
    {-70.9171, -53.1638, 10},
};

/* Level ground whose red grows to the east and green to the north, from 0 to 1 over EXTENT_M. */
static void city_make(const struct geo_origin *o, const char *path)
{
    struct err e = {0};
    struct gauss g;
    const struct pyramid_config cfg = {.name = "place", .tile_edge_m = 30};
    kit_ok(gauss_alloc(&g, ALL, 0, 0, &e), e);
    g.antialiased = true;
    g.n = ALL;
    for (size_t i = 0; i < g.n; i++) {
        const double at[3] = {((double)(i % SIDE) + 0.5) * SPACING_M - 0.5 * EXTENT_M,
                              ((double)(i / SIDE) + 0.5) * SPACING_M - 0.5 * EXTENT_M, 0};
        g.quat_wxyz[4 * i] = 1;
        g.opacity_logit[i] = 6;
        for (size_t k = 0; k < 3; k++) {
            g.quat_wxyz[4 * i + 1 + k] = 0;
            g.mean_m[3 * i + k] = (float)at[k];
            g.scale_log[3 * i + k] = (float)log(k < 2 ? 0.5 * SPACING_M : 0.02);
            g.sh[3 * i + k] = (float)(at[k] / EXTENT_M / 0.28209479);
        }
    }
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(o, &level, 1, &cfg, NULL, 0, path, NULL, &e), e);
    gauss_free(&g);
}

static json_t *document(const char *name)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    json_t *o;
    kit_ok(file_join(path, kit_tmp, name, &e), e);
    kit_ok(jsonc_read(path, &o, &e), e);
    return o;
}

/* a = a b, column-major. */
static void matrix_times(double a[16], const json_t *b)
{
    double m[16] = {0};
    assert_int_equal(json_array_size(b), 16);
    for (size_t i = 0; i < 16; i++)
        for (size_t k = 0; k < 4; k++)
            m[i] += a[4 * k + i % 4] * json_number_value(json_array_get(b, 4 * (i / 4) + k));
    memcpy(a, m, sizeof m);
}

/* ECEF of every Gaussian of a leaf, as any client of 3D Tiles computes it: y up in the file. */
static void tileset_walk(const json_t *node, const double parent[16], double (*ecef)[4], size_t cap,
                         size_t *n)
{
    const json_t *children = json_object_get(node, "children"), *child;
    char path[FILE_PATH_MAX], name[128];
    struct buf bytes = {0};
    struct err e = {0};
    struct gauss g;
    double m[16];
    size_t i;
    memcpy(m, parent, sizeof m);
    if (json_object_get(node, "transform"))
        matrix_times(m, json_object_get(node, "transform"));
    json_array_foreach(children, i, child) tileset_walk(child, m, ecef, cap, n);
    if (json_array_size(children))
        return;
    const char *uri = json_string_value(json_object_get(json_object_get(node, "content"), "uri"));
    assert_non_null(uri);
    snprintf(name, sizeof name, "tileset/%.100s", uri);
    kit_ok(file_join(path, kit_tmp, name, &e), e);
    kit_ok(file_read(path, 0, &bytes, &e), e);
    kit_ok(glb_decode(bytes.data, bytes.size, NULL, &g, &e), e);
    buf_free(&bytes);
    assert_true(*n + g.n <= cap);
    for (i = 0; i < g.n; i++, (*n)++) {
        const float *at = g.mean_m + 3 * i;
        const double local[3] = {(double)at[0], -(double)at[2], (double)at[1]};
        ecef[*n][3] = 0;
        for (size_t a = 0; a < 3; a++)
            ecef[*n][a] = m[a] * local[0] + m[4 + a] * local[1] + m[8 + a] * local[2] + m[12 + a];
    }
    gauss_free(&g);
}

/* An exported tileset, read as a client reads it, has every Gaussian where PROJ has the node of the
 * grid that it was put on. */
static void tilesets_stand_on_the_earth(void **state)
{
    static double ecef[ALL][4], enu[ALL][4];
    static bool hit[ALL];
    double worst = 0;
    const char *bin = kit_program();
    if (!there("cct"))
        skip();
    for (size_t i = 0; i < sizeof cities / sizeof *cities; i++) {
        const struct geo_origin *o = &cities[i];
        static const double unit[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
        struct buf out = {0};
        struct err e = {0};
        char path[FILE_PATH_MAX], command[200];
        size_t n = 0;
        kit_ok(file_join(path, kit_tmp, "place.tiles", &e), e);
        city_make(o, path);
        if (kit_run(&out, "'%s' export -q '%s' -o '%s/tileset' --format 3dtiles --overwrite", bin,
                    path, kit_tmp))
            fail_msg("%.*s", (int)out.size, (const char *)out.data);
        buf_free(&out);
        json_t *tileset = document("tileset/tileset.json");
        tileset_walk(json_object_get(tileset, "root"), unit, ecef, ALL, &n);
        json_decref(tileset);
        assert_int_equal(n, ALL);
        snprintf(command, sizeof command,
                 "cct -d 9 +proj=topocentric +ellps=WGS84 +lon_0=%.17g +lat_0=%.17g +h_0=%.17g",
                 o->lon_deg, o->lat_deg, o->h_m);
        through(command, ecef[0], ALL, 4, enu[0], 4);
        memset(hit, 0, sizeof hit);
        for (size_t k = 0; k < ALL; k++) {
            double x = (enu[k][0] + 0.5 * EXTENT_M) / SPACING_M - 0.5,
                   y = (enu[k][1] + 0.5 * EXTENT_M) / SPACING_M - 0.5,
                   off = hypot(hypot(x - round(x), y - round(y)) * SPACING_M, enu[k][2]);
            if (!(off < 2e-3)) /* files have steps of a fraction of a millimetre */
                fail_msg("%.4f,%.4f: a Gaussian at %.6f %.6f %.6f m", o->lon_deg, o->lat_deg,
                         enu[k][0], enu[k][1], enu[k][2]);
            worst = fmax(worst, off);
            size_t at = (size_t)round(y) * SIDE + (size_t)round(x);
            assert_true(at < ALL && !hit[at]);
            hit[at] = true;
        }
    }
    printf("proj: Gaussians of %zu tilesets within %.2g m of cct\n", sizeof cities / sizeof *cities,
           worst);
}

/* What GDAL reads at a longitude and latitude of o.tif: how far from there a place of these colours
 * lies, m. */
static double colour_off(const struct geo_origin *o, const double at[2])
{
    const double enu[3] = {at[0], at[1], 0};
    double lon, lat, h, red = 0, green = 0, blue = 1;
    struct err e = {0};
    struct buf out = {0};
    kit_ok(geo_from_enu(o, enu, &lon, &lat, &h, &e), e);
    int rc =
        kit_run(&out, "gdallocationinfo -valonly -wgs84 '%s/o.tif' %.12f %.12f", kit_tmp, lon, lat);
    buf_u8(&out, 0);
    if (rc || sscanf((const char *)out.data, "%lf %lf %lf", &red, &green, &blue) != 3)
        fail_msg("%.4f,%.4f: %s", o->lon_deg, o->lat_deg, (const char *)out.data);
    buf_free(&out);
    /* Blue is a half everywhere: what is let through darkens all alike. */
    double off_m = hypot((0.5 * red / blue - 0.5) * EXTENT_M - enu[0],
                         (0.5 * green / blue - 0.5) * EXTENT_M - enu[1]);
    if (!(off_m < 0.4)) /* half a pixel of 0.25 m and half a step of colour each way */
        fail_msg(
            "%.4f,%.4f: %.1f m east, %.1f north is red %.0f green %.0f, a place %.2f m beside it",
            o->lon_deg, o->lat_deg, enu[0], enu[1], red, green, off_m);
    return off_m;
}

static void orthophotos_lie_where_gdal_has_them(void **state)
{
    static const double asked[5][2] = {{0, 0}, {-15, 12}, {13, -16}, {16, 15}, {-12, -14}};
    struct err e = {0};
    struct dev dev;
    double worst_m = 0;
    const char *bin = kit_program();
    if (dev_open("cpu", &dev, &e) != ERR_OK) {
        print_message("skipped: %s\n", e.msg);
        skip();
    }
    dev_close(&dev);
    for (size_t i = 0; i < sizeof cities / sizeof *cities; i++) {
        const struct geo_origin *o = &cities[i];
        struct buf out = {0};
        char path[FILE_PATH_MAX], want[16];
        kit_ok(file_join(path, kit_tmp, "place.tiles", &e), e);
        city_make(o, path);
        if (kit_run(&out, "'%s' ortho -q '%s' -o '%s/o.tif' --gsd-m 0.25 --device cpu --overwrite",
                    bin, path, kit_tmp))
            fail_msg("%.4f,%.4f: %.*s", o->lon_deg, o->lat_deg, (int)out.size,
                     (const char *)out.data);
        snprintf(want, sizeof want, "EPSG:%d", crs_utm(o->lon_deg, o->lat_deg));
        buf_u8(&out, 0);
        kit_expect_text((const char *)out.data, want, __FILE__, __LINE__);
        buf_free(&out);
        for (size_t k = 0; k < 5; k++)
            worst_m = fmax(worst_m, colour_off(o, asked[k]));
    }
    printf("proj: orthophotos of %zu places within %.2f m of gdallocationinfo\n",
           sizeof cities / sizeof *cities, worst_m);
}

static int quiet_folder(void **state)
{
    log_set_level(LOG_ERROR);
    return kit_tmp_make(state);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(utm_is_geographiclibs),
        cmocka_unit_test(projections_are_projs),
        cmocka_unit_test(tiles_are_web_mercator),
        cmocka_unit_test(frames_are_projs),
        cmocka_unit_test(tilesets_stand_on_the_earth),
        cmocka_unit_test(orthophotos_lie_where_gdal_has_them),
    };
    return cmocka_run_group_tests_name("proj", tests, quiet_folder, kit_tmp_remove);
}
