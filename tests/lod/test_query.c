/* Questions about the surface, against the procedural city: heights at many places, profiles, areas
 * and volumes, the place that a pixel shows, lines of sight, and heights above sea level by a geoid
 * model.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey/survey_kit.h"

#include <jansson.h>
#include <stdlib.h>

#include "core/geo/outline.h"
#include "lod/choose/view.h"
#include "lod/surface/query.h"

static json_t *ask(enum query_kind kind, const struct geoid *geoid, json_t *question)
{
    struct err e = {0};
    struct query *q = mem_array(1, sizeof *q);
    json_t *out;
    assert_non_null(q);
    assert_non_null(question);
    kit_ok(query_read(kind, question, &origin, q, &e), e);
    kit_ok(query_answer(f.nadir, geoid, q, &out, &e), e);
    json_decref(question);
    mem_free(q);
    return out;
}

/* A key that is misspelt would leave its default in force. */
static void unknown_keys_are_refused(void **state)
{
    static const struct {
        enum query_kind kind;
        const char *text, *says;
    } bad[] = {
        {QUERY_HEIGHT, "{\"places\": [[8, 50]], \"gsd\": 1}",
         "takes no 'gsd'; it takes places, gsd_m"},
        {QUERY_PROFILE, "{\"line\": [[8, 50], [8, 51]], \"step\": 1}", "takes no 'step'"},
        {QUERY_PICK, "{\"x\": 1, \"y\": 1, \"gsd_m\": 1}", "takes no 'gsd_m'"},
        {QUERY_MEASURE, "{\"polygon\": [[8, 50], [8, 51], [9, 50]], \"base_m\": 3}", "'base_m'"},
        {QUERY_VISIBLE,
         "{\"from\": {\"lon\": 8, \"lat\": 50, \"above\": 2}, \"to\": {\"lon\": 8, \"lat\": 50, "
         "\"above\": 9, \"h\": 1}}",
         "to takes no 'h'"},
        {QUERY_PICK,
         "{\"pose\": {\"lon\": 8, \"lat\": 50, \"height\": 9, \"heading\": 0, \"pitch\": 0, "
         "\"fovy\": 3}, \"width\": 9, \"height\": 9, \"x\": 1, \"y\": 1}",
         "pose takes no 'fovy'"}};
    struct query *q = mem_array(1, sizeof *q);
    assert_non_null(q);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct err e = {0};
        json_t *o = NULL;
        kit_ok(jsonc_parse(bad[i].text, strlen(bad[i].text), "question", &o, &e), e);
        kit_fails(query_read(bad[i].kind, o, &origin, q, &e), ERR_DATA, e, bad[i].says);
        json_decref(o);
    }
    mem_free(q);
}

static double number(const json_t *o, const char *key)
{
    const json_t *v = json_object_get(o, key);
    if (!json_is_number(v))
        fail_msg("no number %s", key);
    return json_number_value(v);
}

static void place_of(double x, double y, double z, double out[3])
{
    struct err e = {0};
    const double enu[3] = {x, y, z};
    kit_ok(geo_from_enu(&origin, enu, &out[0], &out[1], &out[2], &e), e);
}

static void many_places_have_heights(void **state)
{
    json_t *places = json_array();
    double at[200][3];
    size_t n = 0;
    for (size_t i = 0; i < 200; i++) {
        place_of((double)(i * 37 % 201) * 0.27 - 27, (double)(i * 53 % 199) * 0.27 - 27, 0, at[i]);
        json_array_append_new(places, json_pack("[f,f]", at[i][0], at[i][1]));
    }
    json_t *o = ask(QUERY_HEIGHT, NULL, json_pack("{s:o}", "places", places));
    const json_t *list = json_object_get(o, "places");
    assert_int_equal(json_array_size(list), 200);
    for (size_t i = 0; i < 200; i++) {
        double x = (double)(i * 37 % 201) * 0.27 - 27, y = (double)(i * 53 % 199) * 0.27 - 27;
        const json_t *p = json_array_get(list, i);
        assert_true(fabs(number(p, "lon") - at[i][0]) < 1e-8);
        if (!level_at(x, y, 0.3))
            continue;
        n++;
        assert_true(fabs(number(p, "height_m") - origin.h_m - truth_z(x, y)) < 0.35);
    }
    assert_true(n > 80);
    json_decref(o);
}

static void profiles_follow_the_surface(void **state)
{
    double a[3], b[3], c[3];
    size_t level = 0;
    place_of(-20, -15, 0, a);
    place_of(22, -15, 0, b);
    place_of(22, 17, 0, c);
    json_t *o = ask(QUERY_PROFILE, NULL,
                    json_pack("{s:[[f,f],[f,f],[f,f]],s:f}", "line", a[0], a[1], b[0], b[1], c[0],
                              c[1], "step_m", 0.5001));
    const json_t *list = json_object_get(o, "samples");
    assert_true(fabs(number(o, "length_m") - 74) < 0.01);
    assert_int_equal(json_array_size(list), 84 + 64 + 1);
    assert_true(number(o, "surface_length_m") >= number(o, "length_m"));
    double first = number(json_array_get(list, 0), "height_m"),
           last = number(json_array_get(list, 148), "height_m");
    /* the ends of a profile count where they are more than noise */
    assert_true(fabs(number(o, "climb_m") - number(o, "fall_m") - (last - first)) < 0.1);
    assert_true(number(json_array_get(list, 0), "sigma_m") > 0);
    for (size_t i = 0; i < 149; i++) {
        const json_t *s = json_array_get(list, i);
        double d = 0.5 * (double)i, x = d < 42 ? -20 + d : 22, y = d < 42 ? -15 : -15 + d - 42;
        double at[3];
        place_of(x, y, 0, at);
        assert_true(fabs(number(s, "distance_m") - d) < 0.01);
        assert_true(fabs(number(s, "lon") - at[0]) < 1e-7 && fabs(number(s, "lat") - at[1]) < 1e-7);
        if (!level_at(x, y, 0.3))
            continue;
        level++;
        assert_true(fabs(number(s, "height_m") - origin.h_m - truth_z(x, y)) < 0.35);
    }
    assert_true(level > 50);
    json_decref(o);
}

/* How often the height changes along a line over ground, houses and slopes. */
static size_t changes(double gsd_m)
{
    double a[3], b[3];
    size_t n = 0;
    place_of(-24, -23, 0, a);
    place_of(24, 21, 0, b);
    json_t *question =
        json_pack("{s:[[f,f],[f,f]],s:f}", "line", a[0], a[1], b[0], b[1], "step_m", 0.05);
    if (gsd_m > 0)
        json_object_set_new(question, "gsd_m", json_real(gsd_m));
    json_t *o = ask(QUERY_PROFILE, NULL, question);
    const json_t *list = json_object_get(o, "samples");
    for (size_t i = 1; i < json_array_size(list); i++)
        n += number(json_array_get(list, i), "height_m") !=
             number(json_array_get(list, i - 1), "height_m");
    json_decref(o);
    return n;
}

/* Pixels are as small as the step asks for, and as large as is asked for. */
static void profiles_have_pixels_of_their_step(void **state)
{
    double usual = nadir_area(f.nadir)->sigma_m;
    size_t own = changes(0), as_usual = changes(usual), large = changes(2);
    /* 283, 132 and 36 when this was written; 239, 125 and 30 by clang: its city differs a little */
    if (2 * own < 3 * as_usual || large > as_usual / 3)
        fail_msg("%zu changes, %zu in pixels of %.2f m, %zu of 2 m", own, as_usual, usual, large);
}

/* Heights of a profile, each known to 0.1 m. */
static void climb_of(const double *h, size_t n, double *climb, double *fall)
{
    struct measure_sample s[400];
    assert_true(n <= 400);
    for (size_t i = 0; i < n; i++)
        s[i] = (struct measure_sample){.distance_m = (double)i,
                                       .probe = {.height_m = h[i], .noise_m = 0.1}};
    measure_climb(s, n, climb, fall);
}

/* Noise adds up to little, on a street and on a roof; a house up and down counts once each; a slope
 * of many small steps counts whole. */
static void noise_does_not_climb(void **state)
{
    double h[400], climb, fall;
    for (size_t i = 0; i < 400; i++)
        h[i] = 50 + 0.1 * rng_normal(2, 1, i);
    h[7] = (double)NAN;
    climb_of(h, 400, &climb, &fall);
    assert_true(climb < 4 && fall < 4); /* of 22 m that the noise goes up, and down */
    for (size_t i = 100; i < 200; i++)
        h[i] += 10;
    climb_of(h, 400, &climb, &fall);
    assert_true(fabs(climb - 10) < 4 && fabs(fall - 10) < 4);
    for (size_t i = 0; i < 400; i++)
        h[i] = 50 + 0.05 * (double)i;
    climb_of(h, 400, &climb, &fall);
    assert_true(fabs(climb - 0.05 * 399) < 1e-9 && fall == 0);
    for (size_t i = 0; i < 400; i++)
        h[i] = (double)NAN;
    climb_of(h, 400, &climb, &fall);
    assert_true(climb == 0 && fall == 0);
}

static json_t *ring_of(double west, double south, double edge)
{
    json_t *ring = json_array();
    for (int i = 0; i < 5; i++) { /* closed, as GeoJSON has it */
        double at[3];
        place_of(west + (i == 1 || i == 2 ? edge : 0), south + (i == 2 || i == 3 ? edge : 0), 0,
                 at);
        json_array_append_new(ring, json_pack("[f,f]", at[0], at[1]));
    }
    return ring;
}

/* The highest and the lowest of the city within 0.4 m: Gaussians of a roof reach over its edge. */
static void truth_around(double x, double y, double out[2])
{
    out[0] = HUGE_VAL;
    out[1] = -HUGE_VAL;
    for (int k = 0; k < 25; k++) {
        double z = truth_z(x + (k % 5 - 2) * 0.2, y + (k / 5 - 2) * 0.2);
        out[0] = fmin(out[0], z);
        out[1] = fmax(out[1], z);
    }
}

/* A square of 30 m: its area to 1e-5, the volume between those of the city with its edges moved by
 * 0.4 m in and out. A level square of 3 m: the volume of a box to 1 %. */
static void volumes_are_the_citys(void **state)
{
    double least = 0, most = 0, truth = 0, base = origin.h_m + 2, step = 0.25;
    json_t *ring = ring_of(-15, -12, 30), *o;
    for (double y = -12 + step / 2; y < 18; y += step)
        for (double x = -15 + step / 2; x < 15; x += step) {
            double z[2];
            truth_around(x, y, z);
            truth += fmax(truth_z(x, y) + origin.h_m - base, 0) * step * step;
            least += fmax(z[0] + origin.h_m - base, 0) * step * step;
            most += fmax(z[1] + origin.h_m - base, 0) * step * step;
        }
    o = ask(QUERY_MEASURE, NULL, json_pack("{s:O,s:f}", "polygon", ring, "base", base));
    printf("measure: area %.3f m2, above %.1f m3 within %.1f, the city's %.1f, of %.1f to %.1f, "
           "surface %.1f m2, pixels of %.3f m\n",
           number(o, "area_m2"), number(o, "volume_above_m3"), number(o, "volume_error_m3"), truth,
           least, most, number(o, "surface_area_m2"), number(o, "pixel_m"));
    assert_true(fabs(number(o, "area_m2") - 900) < 0.05);
    assert_true(fabs(number(o, "perimeter_m") - 120) < 0.01);
    assert_true(fabs(number(o, "known_area_m2") - 900) < 9);
    assert_true(number(o, "volume_above_m3") > least && number(o, "volume_above_m3") < most);
    /* the error that it states holds the truth, and still says something */
    assert_true(fabs(number(o, "volume_above_m3") - truth) < number(o, "volume_error_m3"));
    assert_true(number(o, "volume_error_m3") < 0.2 * truth);
    assert_true(number(o, "surface_area_m2") > 900);
    json_decref(o);
    /* the plane of the rim lies between the lowest and the highest */
    o = ask(QUERY_MEASURE, NULL, json_pack("{s:o}", "polygon", ring));
    assert_string_equal(json_string_value(json_object_get(o, "base")), "rim");
    assert_true(number(o, "base_m") > number(o, "lowest_m") &&
                number(o, "base_m") < number(o, "highest_m"));
    json_decref(o);
    size_t boxes = 0;
    for (double y = -25; y < 22; y += 5)
        for (double x = -25; x < 22; x += 5) {
            double z = truth_z(x + 1.5, y + 1.5);
            bool level = true;
            for (int k = 0; k < 400 && level; k++)
                level = fabs(truth_z(x - 0.5 + k % 20 * 0.21, y - 0.5 + k / 20 * 0.21) - z) < 0.01;
            if (!level)
                continue;
            o = ask(QUERY_MEASURE, NULL,
                    json_pack("{s:o,s:f,s:f}", "polygon", ring_of(x, y, 3), "base",
                              origin.h_m + z - 4, "gsd_m", 0.05));
            assert_true(fabs(number(o, "volume_above_m3") - 36) < 0.4);
            assert_true(fabs(number(o, "volume_below_m3")) < 0.01);
            assert_true(number(o, "volume_error_m3") < 0.4); /* no edge is within */
            boxes++;
            json_decref(o);
        }
    assert_true(boxes >= 2);
}

/* Where the ray through a pixel meets the city, of metres; HUGE_VAL beyond its edge, on a wall (on
 * which the test city has no Gaussians) and in the sky. */
static double truth_along(const struct camera *cam, double x_px, double y_px)
{
    double c = cos(f.city.yaw_rad), s = sin(f.city.yaw_rad), center[3], world[3];
    const double dir[3] = {(x_px - cam->cx_px) / cam->fx_px, (y_px - cam->cy_px) / cam->fy_px, 1};
    double length = sqrt(dir[0] * dir[0] + dir[1] * dir[1] + 1);
    camera_center(cam, center);
    for (size_t k = 0; k < 3; k++)
        world[k] =
            (cam->rot[k] * dir[0] + cam->rot[3 + k] * dir[1] + cam->rot[6 + k] * dir[2]) / length;
    const double from[3] = {c * center[0] + s * center[1], -s * center[0] + c * center[1],
                            center[2]},
                 along[3] = {c * world[0] + s * world[1], -s * world[0] + c * world[1], world[2]};
    struct synth_hit hit;
    synth_trace_ray(&f.city, NULL, from, along, &hit);
    double at[2] = {center[0] + hit.t_m * world[0], center[1] + hit.t_m * world[1]};
    bool roof_or_ground = fabs(at[0]) <= 29 && fabs(at[1]) <= 29 &&
                          fabs(center[2] + hit.t_m * world[2] - truth_z(at[0], at[1])) <= 0.1;
    return roof_or_ground ? hit.t_m : HUGE_VAL;
}

/* Gaussians reach over edges: those of the test city have a sigma of up to REACH_PX pixels here,
 * and what a ray meets there is theirs, not the surface's. */
static bool clear_of_edges(const struct camera *cam, double x_px, double y_px, double truth_m)
{
    enum { REACH_PX = 4 };
    for (int k = 0; k < 16; k++) {
        double angle = k * 3.14159265358979323846 / 8;
        for (int r = 1; r <= REACH_PX; r++) {
            double t = truth_along(cam, x_px + r * cos(angle), y_px + r * sin(angle));
            if (!(fabs(t - truth_m) < 0.5))
                return false;
        }
    }
    return true;
}

/* Rays of a leaning camera against those of the city; from farther to the side the haze of the test
 * city, which is no surface from above, becomes one. */
static void pixels_show_the_city(void **state)
{
    struct err e = {0};
    struct camera cam;
    double eye[3];
    size_t n = 0, off = 0;
    place_of(4, -18, 110, eye);
    const struct view_pose pose = {eye[0], eye[1], eye[2], 0, -80, 30};
    kit_ok(view_camera(&origin, &pose, 320, 240, &cam, &e), e);
    for (int i = 0; i < 640; i++) {
        double x = 60.5 + i % 32 * 7, y = 40.5 + i / 32 * 10, truth_m = truth_along(&cam, x, y);
        if (!isfinite(truth_m) || !clear_of_edges(&cam, x, y, truth_m))
            continue;
        json_t *o = ask(QUERY_PICK, NULL,
                        json_pack("{s:{s:f,s:f,s:f,s:f,s:f,s:f},s:i,s:i,s:f,s:f}", "pose", "lon",
                                  eye[0], "lat", eye[1], "height", eye[2], "heading", 0.0, "pitch",
                                  -80.0, "fov", 30.0, "width", 320, "height", 240, "x", x, "y", y));
        assert_true(json_is_true(json_object_get(o, "found")));
        n++;
        off += fabs(number(o, "distance_m") - truth_m) > 0.5;
        json_decref(o);
    }
    printf("pick: %zu of %zu rays off by more than 0.5 m\n", off, n);
    assert_true(n > 60 && off * 100 <= n);
}

static void eyes_see_what_is_not_hidden(void **state)
{
    struct err e = {0};
    struct measure_sight s;
    double from[3], to[3], high[2] = {0}, top = -1;
    for (double y = -24; y < 24; y += 0.5) /* the highest roof */
        for (double x = -24; x < 24; x += 0.5)
            if (truth_z(x, y) > top && level_at(x, y, 0.3)) {
                top = truth_z(x, y);
                high[0] = x;
                high[1] = y;
            }
    assert_true(top > 6);
    place_of(high[0], high[1], top + 30, from);
    place_of(high[0], high[1], top, to);
    kit_ok(measure_sight(f.nadir, from, to, &s, &e), e);
    assert_true(s.visible && s.light > 0.5 && fabs(s.distance_m - 30) < 0.01);
    assert_true(isnan(s.blocked_m));
    place_of(high[0], high[1], top - 5, to); /* below the roof */
    kit_ok(measure_sight(f.nadir, from, to, &s, &e), e);
    assert_true(!s.visible && s.light < 0.2);
    assert_true(fabs(s.blocked_m - 30) < 0.5);
    assert_true(fabs(s.blocked[2] - (to[2] + 5)) < 0.5);
    kit_fails(measure_sight(f.nadir, from, from, &s, &e), ERR_DATA, e, "apart");
}

static void polygons_are_checked(void **state)
{
    static const double bow[4][2] = {{0, 0}, {1, 1}, {1, 0}, {0, 1}},
                        flat[3][2] = {{0, 0}, {1, 1}, {2, 2}},
                        l[6][2] = {{0, 0}, {4, 0}, {4, 1}, {1, 1}, {1, 3}, {0, 3}};
    struct err e = {0};
    kit_fails(outline_check(bow, 4, &e), ERR_DATA, e, "corner 1 and the one from corner 3");
    kit_fails(outline_check(flat, 3, &e), ERR_DATA, e, "no area");
    kit_fails(outline_check(l, 2, &e), ERR_DATA, e, "at least 3");
    kit_ok(outline_check(l, 6, &e), e);
    assert_true(fabs(outline_area(l, 6) - 6) < 1e-12 && fabs(outline_length(l, 6) - 14) < 1e-12);
    assert_true(outline_holds(l, 6, 0.5, 2.5) && outline_holds(l, 6, 3.5, 0.5));
    assert_false(outline_holds(l, 6, 2, 2));
}

/* A polygon of 4 km x 1 mm is drawn in pieces that are wider: what counts is what is drawn. */
static void what_is_drawn_is_limited(void **state)
{
    static const double corner[4][2] = {{-30, 0}, {3970, 0}, {3970, 0.001}, {-30, 0.001}};
    struct err e = {0};
    struct measure_area a;
    double ring[4][2], at[3], least;
    for (size_t i = 0; i < 4; i++) {
        place_of(corner[i][0], corner[i][1], 0, at);
        memcpy(ring[i], at, sizeof ring[i]);
    }
    kit_fails(measure_polygon(f.nadir, (const double(*)[2])ring, 4, 160, 0.001, &a, &e), ERR_DATA,
              e, "from gsd_m");
    assert_int_equal(sscanf(strstr(e.msg, "from gsd_m"), "from gsd_m %lf", &least), 1);
    assert_true(least > 0.01 && least < 0.1);
    kit_ok(measure_polygon(f.nadir, (const double(*)[2])ring, 4, 160, least, &a, &e), e);
    /* In pieces that are no squares: the same as in one. */
    json_t *ring_json = json_array(), *o[2];
    for (size_t i = 0; i < 4; i++) {
        place_of(i == 1 || i == 2 ? 15 : -15, i >= 2 ? 5 : 1, 0, at);
        json_array_append_new(ring_json, json_pack("[f,f]", at[0], at[1]));
    }
    for (size_t i = 0; i < 2; i++)
        o[i] = ask(QUERY_MEASURE, NULL,
                   json_pack("{s:O,s:f,s:f}", "polygon", ring_json, "base", origin.h_m, "gsd_m",
                             i ? 0.02 : 0.1));
    assert_true(fabs(number(o[1], "known_area_m2") - 120) < 1);
    assert_true(fabs(number(o[0], "volume_above_m3") / number(o[1], "volume_above_m3") - 1) < 0.02);
    json_decref(o[0]);
    json_decref(o[1]);
    json_decref(ring_json);
}

static void far_lines_are_refused(void **state)
{
    static const double ends[][2] = {{8.6821, 51.2}, {188.6821 - 360, -50.1109}}; /* antipode */
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) {
        struct err e = {0};
        struct query q = {.kind = QUERY_MEASURE, .n = 2};
        json_t *o;
        q.place[0][0] = origin.lon_deg;
        q.place[0][1] = origin.lat_deg;
        memcpy(q.place[1], ends[i], sizeof q.place[1]);
        kit_fails(query_answer(f.nadir, NULL, &q, &o, &e), ERR_DATA, e, "100 km");
        assert_null(o);
    }
}

/* A geoid of GeographicLib's format that lies 40 m above the ellipsoid everywhere. */
static void sea_level_is_told(void **state)
{
    struct err e = {0};
    struct geoid *g;
    struct buf b = {0};
    char path[FILE_PATH_MAX];
    buf_printf(&b, "P5\n# Description test\n# DateTime 2026-01-01\n# Offset -108\n# Scale 0.003\n"
                   "# MaxBilinearError 0\n# RMSBilinearError 0\n# MaxCubicError 0\n"
                   "# RMSCubicError 0\n8 5\n65535\n");
    for (size_t i = 0; i < 8 * 5; i++) {
        unsigned v = (unsigned)((40 + 108) / 0.003 + 0.5);
        buf_u8(&b, v >> 8);
        buf_u8(&b, v & 255);
    }
    kit_ok(file_join(path, f.dir, "level40.pgm", &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
    kit_ok(geoid_open(path, &g, &e), e);
    assert_true(fabs(geoid_above(g, 8.68, 50.11) - 40) < 0.002);
    json_t *o =
        ask(QUERY_HEIGHT, g,
            json_pack("{s:[[f,f],[f,f]]}", "places", origin.lon_deg, origin.lat_deg, 9.0, 50.0));
    const json_t *p = json_array_get(json_object_get(o, "places"), 0),
                 *none = json_array_get(json_object_get(o, "places"), 1);
    assert_string_equal(json_string_value(json_object_get(o, "sea_level")), "level40");
    assert_true(fabs(number(p, "height_m") - number(p, "sea_level_height_m") - 40) < 0.005);
    assert_true(json_is_null(json_object_get(none, "sea_level_height_m")));
    json_decref(o);
    geoid_close(&g);
    kit_fails(geoid_open("atlantis", &g, &e), ERR_NOENT, e, "geographiclib-get-geoids");
    assert_null(g);
}

static void put_file(const char *name, const char *text)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, f.dir, name, &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

/* Through the program: the same answers, and exit codes of questions that have none. */
static void the_program_answers(void **state)
{
    struct buf out = {0};
    const char *bin = kit_program();
    put_file("heap.geojson", "{\"type\":\"Polygon\",\"coordinates\":[[[8.682,50.1108],"
                             "[8.6822,50.1108],[8.6822,50.111],[8.682,50.111],[8.682,50.1108]]]}");
    put_file("bow.geojson", "{\"type\":\"Polygon\",\"coordinates\":[[[8.682,50.1108],"
                            "[8.6822,50.111],[8.6822,50.1108],[8.682,50.111],[8.682,50.1108]]]}");
    const struct {
        const char *command, *args, *says;
        int code;
    } cases[] = {
        {"profile", "8.682,50.1109 8.6822,50.1109 --step-m 0.5", "\"surface_length_m\"", 0},
        {"measure", "8.682,50.1109 8.6822,50.1109", "\"space_length_m\"", 0},
        {"measure", "--polygon heap.geojson --base-m 160", "\"volume_above_m3\"", 0},
        {"measure", "--polygon bow.geojson", "crosses itself", 2},
        {"measure", "--polygon none.geojson", "none.geojson", 1},
        {"measure", "", "two or more places", 2},
        {"profile", "8.682,50.1109 x", "LON,LAT", 2},
        {"height", "8.682,50.1109 --geoid atlantis", "atlantis", 1},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        int got = kit_run(&out, "cd '%s' && '%s' %s city.tiles %s", f.dir, bin, cases[i].command,
                          cases[i].args);
        if (got != cases[i].code || !strstr((const char *)out.data, cases[i].says))
            fail_msg("%s %s: %d: %s", cases[i].command, cases[i].args, got, (const char *)out.data);
        buf_free(&out);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(many_places_have_heights),
        cmocka_unit_test(profiles_follow_the_surface),
        cmocka_unit_test(profiles_have_pixels_of_their_step),
        cmocka_unit_test(noise_does_not_climb),
        cmocka_unit_test(volumes_are_the_citys),
        cmocka_unit_test(pixels_show_the_city),
        cmocka_unit_test(eyes_see_what_is_not_hidden),
        cmocka_unit_test(polygons_are_checked),
        cmocka_unit_test(what_is_drawn_is_limited),
        cmocka_unit_test(unknown_keys_are_refused),
        cmocka_unit_test(far_lines_are_refused),
        cmocka_unit_test(sea_level_is_told),
        cmocka_unit_test(the_program_answers),
    };
    return cmocka_run_group_tests_name("query", tests, survey_setup, survey_teardown);
}
