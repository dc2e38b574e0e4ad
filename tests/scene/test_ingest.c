/* From a procedural city to a scene: poses against the truth, pixels against a formula, bad input.
 * Photographs that are not as their model has them: test_ingest_photographs.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "codec/image/image.h"
#include "codec/limits.h"
#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"
#include "tests/scene/ingest_kit.h"

/* True pose of a photograph in the frame of the scene's own origin. */
static void truth_center(const json_t *root, const struct geo_origin *to, size_t i, double out[3])
{
    struct err e = {0};
    struct geo_origin from;
    const json_t *o = json_object_get(root, "origin"),
                 *p = json_array_get(json_object_get(root, "photographs"), i);
    double enu[3], lon, lat, h;
    kit_ok(jsonc_num(o, "lon_deg", &from.lon_deg, &e), e);
    kit_ok(jsonc_num(o, "lat_deg", &from.lat_deg, &e), e);
    kit_ok(jsonc_num(o, "h_m", &from.h_m, &e), e);
    kit_ok(jsonc_nums(p, "center_enu_m", 3, enu, &e), e);
    kit_ok(geo_from_enu(&from, enu, &lon, &lat, &h, &e), e);
    kit_ok(geo_to_enu(to, lon, lat, h, out, &e), e);
}

/* A distorted camera, exact GPS, pictures shrunk by half: poses, tracks, split, pictures. */
static void test_whole_way(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    struct synth_config sc;
    struct ingest_config ic;
    struct scene s;
    struct err e = {0};
    city_config(&sc, city, "city");
    sc.distorted = true;
    kit_ok(synth_run(&sc, &e), e);
    ingest_config(&ic, out, "scene");
    ic.max_edge_px = 40;
    ic.attribution = "a test";
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_ok(scene_read(out, &s, &e), e);
    json_t *truth = read_json(city, "truth/truth.json");
    assert_int_equal(s.n_images, 32);
    assert_string_equal(s.attribution, "a test");
    for (size_t i = 0; i < s.n_images; i++) {
        double want[3], got[3];
        struct image img;
        truth_center(truth, &s.origin, i, want);
        camera_center(&s.images[i].cam, got);
        kit_near_d("camera", got, want, 3, tol_place_m, 0);
        assert_int_equal(s.images[i].split, i % 8 ? SCENE_TRAIN : SCENE_TEST);
        assert_int_equal(s.images[i].group, i);
        snprintf(path, sizeof path, "%s/images/%s", out, s.images[i].name);
        kit_ok(image_read(path, &(struct codec_limits){0}, &img, &e), e);
        assert_int_equal(img.width_px, 40);
        assert_int_equal(img.height_px, 30);
        assert_int_equal(s.images[i].cam.width_px, 40);
        image_free(&img);
    }
    double error = track_error(&s);
    if (error > 0.5) /* 0.67 px of noise at full size, halved */
        fail_msg("tracks are off by %.2f px", error);
    /* The ground is near z = 0 and the points lie in the city. */
    size_t low = 0;
    for (size_t i = 0; i < s.n_points; i++)
        low += fabs(s.points[i].enu_m[2]) < 30 && s.points[i].track_length >= 2;
    assert_true((double)low > 0.98 * (double)s.n_points);
    json_decref(truth);
    scene_free(&s);
}

/* --test-block: the share asked for, together in one place, and nothing else tests. */
static void test_a_block_is_held_out(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct scene s;
    struct err e = {0};
    city_config(&sc, city, "block-city");
    sc.oblique_share = 0;
    kit_ok(synth_run(&sc, &e), e);
    ingest_config(&ic, out, "block-scene");
    ic.test_block = 0.2;
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_ok(scene_read(out, &s, &e), e);
    assert_int_equal(s.n_images, 32);
    double middle[2] = {0}, rim = 0, next = HUGE_VAL;
    size_t n = 0;
    for (size_t i = 0; i < s.n_images; i++) {
        double c[3];
        camera_center(&s.images[i].cam, c);
        for (int k = 0; k < 2 && s.images[i].split == SCENE_TEST; k++)
            middle[k] += c[k] / 6;
        n += s.images[i].split == SCENE_TEST;
    }
    assert_int_equal(n, 6); /* 0.2 of 32 */
    for (size_t i = 0; i < s.n_images; i++) {
        double c[3], away;
        camera_center(&s.images[i].cam, c);
        away = hypot(c[0] - middle[0], c[1] - middle[1]);
        if (s.images[i].split == SCENE_TEST)
            rim = fmax(rim, away);
        else
            next = fmin(next, away);
    }
    /* Six places of a grid of about 16 m: within 25 m of their middle, and nothing much nearer. */
    assert_true(rim < 25 && next > 0.5 * rim);
    scene_free(&s);
}

/* GPS outliers, wrong poses and a second flight 12 m higher, all at once. */
static void test_everything_wrong(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct scene s;
    struct err e = {0};
    city_config(&sc, city, "wrong");
    sc.photos = 48;
    sc.gps_sigma_m = 0.5;
    sc.gps_outlier_share = 0.06;
    sc.pose_error_share = 0.06;
    sc.flight_offset_m = 12;
    kit_ok(synth_run(&sc, &e), e);
    ingest_config(&ic, out, "wrong-scene");
    kit_ok(ingest_city(city, &ic, &e), e);
    json_t *truth = read_json(city, "truth/truth.json"), *report = read_json(out, "report.json");
    const json_t *photos = json_object_get(report, "photos");
    /* Where they lie, as seen from the scene. */
    const char *images =
        json_string_value(json_object_get(json_object_get(report, "source"), "photographs"));
    char seen[FILE_PATH_MAX], there[PATH_MAX], want[PATH_MAX];
    assert_true(images && images[0] == '.');
    kit_ok(file_join(seen, out, images, &e), e);
    assert_non_null(realpath(seen, there));
    kit_ok(file_join(seen, city, "images", &e), e);
    assert_non_null(realpath(seen, want));
    assert_string_equal(there, want);
    size_t bad = 0;
    for (size_t i = 0; i < json_array_size(photos); i++) {
        const json_t *t = json_array_get(json_object_get(truth, "photographs"), i),
                     *p = json_array_get(photos, i);
        bool must = json_is_true(json_object_get(t, "gps_outlier")) ||
                    json_is_true(json_object_get(t, "pose_error"));
        bool kept = json_is_true(json_object_get(p, "kept"));
        bad += must;
        if (must == kept)
            fail_msg("%s: %s", json_string_value(json_object_get(p, "name")),
                     kept ? "kept" : json_string_value(json_object_get(p, "why")));
    }
    assert_true(bad >= 2);
    const json_t *offsets =
        json_object_get(json_object_get(report, "georeferencing"), "flight_height_offset_m");
    assert_int_equal(json_array_size(offsets), 2);
    double offset = json_number_value(json_array_get(offsets, 1));
    if (fabs(fabs(offset) - 12) > 1)
        fail_msg("offset of the second flight %.2f m", offset);
    kit_ok(scene_read(out, &s, &e), e);
    /* Observations of dropped photographs are gone, and points that only they saw. */
    for (size_t i = 0; i < s.n_points; i++)
        assert_true(s.points[i].track_length >= 1 && s.points[i].track_length <= s.n_images);
    assert_true(track_error(&s) < 1);
    scene_free(&s);
    json_decref(truth);
    json_decref(report);
}

/* ---- pixels ---- */

/* A smooth picture: colours are a known function of the place. */
static void smooth(double u, double v, double rgb[3])
{
    rgb[0] = 128 + 60 * sin(u / 17) * cos(v / 23);
    rgb[1] = 128 + 60 * cos(u / 29 + v / 19);
    rgb[2] = 60 + u / 8 + v / 8;
}

static void test_undistorted_pixels(void **state)
{
    static const struct lens lenses[] = {
        {LENS_SIMPLE_RADIAL, 320, 240, {250, 160, 120, -0.12}},
        {LENS_SIMPLE_RADIAL, 320, 240, {250, 160, 120, 0.10}},
        {LENS_OPENCV, 320, 240, {250, 252, 163, 117, -0.15, 0.05, 0.001, -0.002}},
        {LENS_OPENCV_FISHEYE, 320, 240, {140, 141, 160, 120, 0.02, -0.005, 0.001, 0}},
        {LENS_PINHOLE, 320, 240, {250, 255, 150, 125}},
    };
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    struct image img;
    struct err e = {0};
    kit_ok(image_alloc(320, 240, 3, &img, &e), e);
    for (uint32_t y = 0; y < 240; y++)
        for (uint32_t x = 0; x < 320; x++) {
            double rgb[3];
            smooth(x + 0.5, y + 0.5, rgb);
            for (int k = 0; k < 3; k++)
                img.px[3 * ((size_t)y * 320 + x) + (size_t)k] = (uint8_t)(rgb[k] + 0.5);
        }
    join(from, kit_tmp, "smooth.png");
    join(to, kit_tmp, "flat.png");
    kit_ok(image_write(from, &img, 0, NULL, &e), e);
    image_free(&img);
    for (size_t l = 0; l < sizeof lenses / sizeof *lenses; l++)
        for (uint32_t edge = 320; edge >= 80; edge /= 2) {
            struct ingest_view v;
            kit_ok(ingest_view_make(&lenses[l], 320, 240, edge, &v, &e), e);
            assert_int_equal(v.pinhole.width_px, edge);
            enum ingest_light light = INGEST_LIGHT_DARK;
            kit_ok(ingest_photo_convert(&v, from, to, &(struct codec_limits){0}, &light, &e), e);
            assert_int_equal(light, INGEST_LIGHT_USUAL);
            kit_ok(image_read(to, &(struct codec_limits){0}, &img, &e), e);
            double worst = 0;
            for (uint32_t y = 0; y < img.height_px; y++)
                for (uint32_t x = 0; x < img.width_px; x++) {
                    double u, w, want[3];
                    lens_distort(&lenses[l], (x + 0.5 - v.pinhole.cx_px) / v.pinhole.fx_px,
                                 (y + 0.5 - v.pinhole.cy_px) / v.pinhole.fy_px, &u, &w);
                    assert_true(u > -1e-3 && w > -1e-3 && u < 320.001 &&
                                w < 240.001); /* no black borders */
                    smooth(u, w, want);
                    bool border = x < 3 || y < 3 || x + 3 >= img.width_px || y + 3 >= img.height_px;
                    for (int k = 0; k < 3 && !border; k++)
                        worst = fmax(
                            worst,
                            fabs(img.px[3 * ((size_t)y * img.width_px + x) + (size_t)k] - want[k]));
                }
            image_free(&img);
            if (worst > 4) /* two or three roundings to bytes, and curvature within a pixel of 4 */
                fail_msg("%s to %u px: off by %.1f levels", lens_name(lenses[l].model), edge,
                         worst);
            /* Observations land where the pixels do. */
            double u, w, mu, mw;
            lens_distort(&lenses[l], 0.1, -0.2, &u, &w);
            assert_true(ingest_view_map(&v, &lenses[l], u, w, &mu, &mw));
            assert_true(fabs(mu - (v.pinhole.fx_px * 0.1 + v.pinhole.cx_px)) < 1e-6);
            assert_true(fabs(mw - (v.pinhole.fy_px * -0.2 + v.pinhole.cy_px)) < 1e-6);
        }
}

/* ---- bad input ---- */

static void expect_nothing_left(const char *out)
{
    char cmd[FILE_PATH_MAX + 64];
    struct buf b = {0};
    snprintf(cmd, sizeof cmd, "%s", out);
    assert_false(file_exists(out) || file_is_dir(out));
    assert_int_equal(kit_run(&b, "ls -d '%s'.* 2>/dev/null | wc -l", out), 0);
    assert_int_equal(atoi((const char *)b.data), 0);
    buf_free(&b);
}

/* Of each photograph's points the first so many stay. */
static void few_points(struct colmap_model *m, size_t most)
{
    size_t n_tracks = 0;
    for (size_t i = 0; i < m->n_images; i++)
        for (size_t k = 0, n = 0; k < m->images[i].n_obs; k++)
            if (m->images[i].obs[k].point >= 0 && ++n > most)
                m->images[i].obs[k].point = -1;
    for (size_t p = 0; p < m->n_points; p++) {
        struct colmap_point *x = &m->points[p];
        size_t from = n_tracks;
        for (size_t t = x->track; t < x->track + x->n_track; t++)
            if (m->images[m->tracks[t].image].obs[m->tracks[t].obs].point == (int64_t)p)
                m->tracks[n_tracks++] = m->tracks[t];
        x->track = from;
        x->n_track = n_tracks - from;
    }
    m->n_tracks = n_tracks;
}

static void test_bad_input(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX], photo[FILE_PATH_MAX], images[FILE_PATH_MAX],
        other[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct err e = {0};
    struct image img;
    struct buf original = {0};
    city_config(&sc, city, "bad");
    kit_ok(synth_run(&sc, &e), e);
    join(images, city, "images");
    join(photo, images, "IMG_0005.jpg");
    kit_ok(file_read(photo, 0, &original, &e), e);
    ingest_config(&ic, out, "bad-scene");

    kit_ok(image_alloc(33, 44, 3, &img, &e), e);
    kit_ok(image_write(photo, &img, 0, NULL, &e), e);
    image_free(&img);
    kit_fails(ingest_city(city, &ic, &e), ERR_DATA, e, "33 x 44");
    assert_int_equal(remove(photo), 0);
    kit_fails(ingest_city(city, &ic, &e), ERR_NOENT, e, "1 of the 32 photographs");
    ic.skip_missing = true;
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_fails(ingest_city(city, &ic, &e), ERR_ARG, e, "--overwrite");
    ic.overwrite = true;
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_ok(file_write(photo, original.data, original.size, &e), e);
    buf_free(&original);

    ingest_config(&ic, other, "other-scene");
    kit_fails(ingest_run("/nonexistent", city, &ic, &e), ERR_NOENT, e, "no such folder");
    kit_fails(ingest_run(images, images, &ic, &e), ERR_NOENT, e, "looked for");
    ic.origin = "8,95,100";
    kit_fails(ingest_city(city, &ic, &e), ERR_ARG, e, "--origin");
    ic.origin = NULL;
    ic.output = NULL;
    kit_fails(ingest_city(city, &ic, &e), ERR_ARG, e, "-o SCENE");
    join(other, photo, "scene"); /* below a file */
    ic.output = other;
    kit_fails(ingest_city(city, &ic, &e), ERR_IO, e, "IMG_0005.jpg");

    /* Four points a photograph fix no pose. */
    struct colmap_model m;
    ingest_config(&ic, other, "other-scene");
    kit_ok(colmap_read(city, &m, &e), e);
    few_points(&m, 4);
    join(photo, city, "few");
    kit_ok(file_mkdir(photo, &e), e);
    kit_ok(colmap_write_bin(photo, &m, &e), e);
    colmap_free(&m);
    kit_fails(ingest_run(images, photo, &ic, &e), ERR_DATA, e,
              "do not fix their poses (the best one sees 4");
    expect_nothing_left(other);

    /* COLMAP run on a list of whole paths */
    static const char *const whole[] = {"/home/me/IMG_0006.jpg", "C:\\me\\IMG_0006.jpg",
                                        "d:/IMG_0006.jpg", "\\\\nas\\me\\IMG_0006.jpg"};
    for (size_t i = 0; i < sizeof whole / sizeof *whole; i++) {
        char says[128];
        kit_ok(colmap_read(city, &m, &e), e);
        m.images[6].name = arena_printf(&m.arena, "%s", whole[i]);
        join(photo, city, "few");
        kit_ok(colmap_write_bin(photo, &m, &e), e);
        colmap_free(&m);
        snprintf(says, sizeof says, "image '%s' has an absolute name", whole[i]);
        kit_fails(ingest_run(images, photo, &ic, &e), ERR_DATA, e, says);
        kit_expect_text(e.msg, "images.txt", __FILE__, __LINE__);
    }

    /* a name in Latin-1, before anything is converted */
    ingest_config(&ic, other, "latin-scene");
    join(photo, images,
         "Stra\xdf"
         "e_2.jpg");
    kit_ok(file_write(photo, "this is no picture", 18, &e), e);
    kit_ok(colmap_read(city, &m, &e), e);
    m.images[6].name = arena_printf(&m.arena, "Stra\xdf"
                                              "e_2.jpg");
    join(photo, city, "sparse/0");
    kit_ok(colmap_write_bin(photo, &m, &e), e);
    colmap_free(&m);
    kit_fails(ingest_city(city, &ic, &e), ERR_DATA, e,
              "Stra\xdf"
              "e_2.jpg");
    kit_expect_text(e.msg, "UTF-8", __FILE__, __LINE__);
    ic.attribution = "caf\xe9";
    kit_fails(ingest_city(city, &ic, &e), ERR_ARG, e, "--attribution");
}

/* Photographs without GPS: a scene without metres, or placed by hand. */
static void test_without_gps(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct scene s;
    struct err e = {0};
    city_config(&sc, city, "nogps");
    kit_ok(synth_run(&sc, &e), e);
    for (int i = 1; i <= 32; i++) {
        char path[FILE_PATH_MAX + 32];
        struct image img;
        snprintf(path, sizeof path, "%s/images/IMG_%04d.jpg", city, i);
        kit_ok(image_read(path, &(struct codec_limits){0}, &img, &e), e);
        kit_ok(image_write(path, &img, 95, NULL, &e), e);
        image_free(&img);
    }
    ingest_config(&ic, out, "nogps-scene");
    log_set_level(LOG_ERROR); /* it warns */
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_ok(scene_read(out, &s, &e), e);
    assert_string_equal(s.heights, "unscaled");
    assert_true(s.origin.lon_deg == 0 && s.origin.lat_deg == 0);
    double height = 0; /* as if from 100 m, whatever COLMAP's unit is; the ground is rough */
    for (size_t i = 0; i < s.n_images; i++) {
        double at[3];
        camera_center(&s.images[i].cam, at);
        height += at[2] / (double)s.n_images;
    }
    assert_true(fabs(height - 100) < 10);
    scene_free(&s);
    ic.overwrite = true;
    ic.metres_per_unit = 2;
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_ok(scene_read(out, &s, &e), e);
    assert_string_equal(s.heights, "unknown");
    assert_true(s.scale == 2);
    scene_free(&s);
    ic.origin = "7.5,47.5,300";
    json_t *truth = read_json(city, "truth/truth.json");
    kit_ok(jsonc_num(json_object_get(truth, "colmap_to_enu"), "scale", &ic.metres_per_unit, &e), e);
    kit_ok(ingest_city(city, &ic, &e), e);
    log_set_level(LOG_WARN);
    kit_ok(scene_read(out, &s, &e), e);
    assert_true(s.origin.lon_deg == 7.5 && s.origin.lat_deg == 47.5 && s.origin.h_m == 300);
    for (size_t i = 0; i < s.n_images; i++) {
        double want[3], got[3];
        truth_center(truth, &(struct geo_origin){7.5733, 47.5584, 280}, i, want);
        camera_center(&s.images[i].cam, got);
        if (fabs(got[2] - want[2]) >
            6) /* level and to scale, to a few degrees; heading is arbitrary */
            fail_msg("camera %zu at height %.1f m, want %.1f m", i, got[2], want[2]);
        assert_true(isnan(s.images[i].residual_m));
    }
    json_decref(truth);
    scene_free(&s);
}

/* A real flight with a drifting receiver: nothing is rejected in masses, and its cameras look down.
 */
static void test_caliterra(void **state)
{
    const char *dir = getenv("CITYSPLAT_CALITERRA");
    if (!dir)
        dir = "../shared/data/caliterra";
    char path[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct ingest_config ic;
    struct scene s;
    struct err e = {0};
    join(path, dir, "images");
    if (!file_is_dir(path)) {
        print_message("caliterra photographs not at %s (set CITYSPLAT_CALITERRA): skipped\n", path);
        skip();
    }
    ingest_config(&ic, out, "caliterra");
    ic.max_edge_px = 160;
    log_set_level(LOG_ERROR); /* it warns of its GPS */
    kit_ok(ingest_city(dir, &ic, &e), e);
    log_set_level(LOG_WARN);
    kit_ok(scene_read(out, &s, &e), e);
    json_t *report = read_json(out, "report.json");
    size_t n;
    dropped_as(report, "GPS", &n);
    assert_true(n <= 2);
    assert_true(s.n_images >= 73 && s.n_points > 45000);
    double down = 0;
    for (size_t i = 0; i < s.n_images; i++)
        down += -s.images[i].cam.rot[8] / (double)s.n_images;
    assert_true(down > 0.97);
    assert_true(track_error(&s) < 0.1);
    json_decref(report);
    scene_free(&s);
}

/* COLMAP's models 0 and 1: the larger counts, in whatever order; what it lacks is named. */
static void test_largest_model(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX], from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct err e = {0};
    struct colmap_model m;
    city_config(&sc, city, "models");
    kit_ok(synth_run(&sc, &e), e);
    kit_ok(colmap_read(city, &m, &e), e);
    assert_int_equal(m.n_models, 1);
    assert_non_null(strstr(m.dir, "sparse/0"));
    colmap_free(&m);
    join(from, city, "sparse/0");
    join(to, city, "sparse/1");
    assert_int_equal(rename(from, to), 0);
    /* model 0: that of another, smaller city */
    struct synth_config small;
    char other[FILE_PATH_MAX];
    city_config(&small, other, "small");
    small.photos = 8;
    kit_ok(synth_run(&small, &e), e);
    join(to, other, "sparse/0");
    assert_int_equal(rename(to, from), 0);
    kit_ok(colmap_read(city, &m, &e), e);
    assert_int_equal(m.n_images, 32);
    assert_true(m.n_models == 2 && m.n_second == 8);
    assert_non_null(strstr(m.dir, "sparse/1"));
    colmap_free(&m);
    /* capitals of endings, and photographs that the model does not have */
    join(from, city, "images/IMG_0003.jpg");
    join(to, city, "images/IMG_0003.JPG");
    assert_int_equal(rename(from, to), 0);
    join(from, city, "images/IMG_0004.jpg");
    assert_int_equal(kit_run(NULL,
                             "cd '%s/images' && mkdir late masks && cp IMG_0004.jpg late/extra.JPG "
                             "&& cp IMG_0004.jpg masks/x.png && cp IMG_0004.jpg IMG_0004.jpg.png",
                             city),
                     0);
    ingest_config(&ic, out, "models-scene");
    kit_ok(ingest_city(city, &ic, &e), e);
    json_t *r = read_json(out, "report.json"), *unplaced = json_object_get(r, "unplaced");
    assert_int_equal(json_integer_value(json_object_get(r, "kept")), 32);
    assert_int_equal(json_array_size(unplaced), 1);
    assert_string_equal(json_string_value(json_array_get(unplaced, 0)), "late/extra.JPG");
    assert_int_equal(json_integer_value(json_object_get(r, "not_in_model")), 1);
    json_decref(r);
    /* two files that differ in capitals alone: which is meant cannot be told */
    join(from, city, "images/IMG_0003.Jpg");
    struct buf b = {0};
    kit_ok(file_read(to, 0, &b, &e), e);
    kit_ok(file_write(from, b.data, b.size, &e), e);
    buf_free(&b);
    ic.overwrite = true;
    kit_fails(ingest_city(city, &ic, &e), ERR_NOENT, e, "IMG_0003.jpg");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_whole_way),          cmocka_unit_test(test_everything_wrong),
        cmocka_unit_test(test_undistorted_pixels), cmocka_unit_test(test_bad_input),
        cmocka_unit_test(test_without_gps),        cmocka_unit_test(test_a_block_is_held_out),
        cmocka_unit_test(test_largest_model),      cmocka_unit_test(test_caliterra),
    };
    progress_quiet(true);
    log_set_level(LOG_WARN);
    return cmocka_run_group_tests_name("ingest", tests, kit_tmp_make, ingest_kit_teardown);
}
