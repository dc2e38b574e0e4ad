/* Photographs that are not as their model has them: broken, far from their GPS, under other names,
 * with alpha.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/scene/ingest_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/image/exif.h"
#include "codec/scene/colmap.h"

/* A photograph that cannot be read is named and set aside: no picture and half of one. */
static void test_broken_photographs(void **state)
{
    char city[FILE_PATH_MAX], out[FILE_PATH_MAX], images[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct err e = {0};
    struct buf original = {0};
    struct scene s;
    city_config(&sc, city, "broken");
    kit_ok(synth_run(&sc, &e), e);
    join(images, city, "images");
    join(path, images, "IMG_0005.jpg");
    kit_ok(file_write(path, "this is no picture", 18, &e), e);
    join(path, images, "IMG_0007.jpg");
    kit_ok(file_read(path, 0, &original, &e), e);
    kit_ok(file_write(path, original.data, original.size / 2, &e), e);
    buf_free(&original);
    ingest_config(&ic, out, "broken-scene");
    log_set_level(LOG_ERROR);
    kit_ok(ingest_city(city, &ic, &e), e);
    log_set_level(LOG_WARN);
    kit_ok(scene_read(out, &s, &e), e);
    assert_int_equal(s.n_images, 30);
    for (size_t i = 0; i < s.n_images; i++) {
        assert_string_not_equal(s.images[i].name, "IMG_0005.jpg");
        assert_string_not_equal(s.images[i].name, "IMG_0007.jpg");
        join(path, out, "images");
        join(images, path, s.images[i].name);
        assert_true(file_exists(images));
    }
    for (size_t k = 0; k < s.n_tracks; k++) /* of photographs that are there */
        assert_true(s.tracks[k].image < s.n_images && s.tracks[k].point < s.n_points);
    assert_true(track_error(&s) < 1);
    scene_free(&s);
    json_t *r = read_json(out, "report.json"), *photos = json_object_get(r, "photos");
    for (size_t i = 0; i < json_array_size(photos); i++) {
        const json_t *p = json_array_get(photos, i);
        const char *name = json_string_value(json_object_get(p, "name")),
                   *why = json_string_value(json_object_get(p, "why"));
        if (!strcmp(name, "IMG_0005.jpg") || !strcmp(name, "IMG_0007.jpg"))
            kit_expect_text(why, "cannot be read", __FILE__, __LINE__);
        else
            assert_string_equal(why, "");
    }
    json_decref(r);
}

/* ---- photographs far from their GPS ---- */

enum { FAR_PHOTO = 13 }; /* in the middle of the flight */

/* Where a point of the model lies in a photograph. */
static void project(const struct colmap_model *m, const struct colmap_image *im, size_t point,
                    double out[2])
{
    double rot[9], p[3];
    const double *x = m->points[point].xyz;
    camera_quat_to_rot(im->quat_wxyz, rot);
    for (size_t a = 0; a < 3; a++)
        p[a] = rot[3 * a] * x[0] + rot[3 * a + 1] * x[1] + rot[3 * a + 2] * x[2] + im->trans[a];
    lens_distort(&m->cameras[im->camera].lens, p[0] / p[2], p[1] / p[2], &out[0], &out[1]);
}

/* Moves the camera by east_m. With `seen` its observations move as well, so that its points fix the
 * wrong pose as COLMAP does where a facade repeats itself. */
static void move_pose(struct colmap_model *m, const struct scene *s, double east_m, bool seen)
{
    struct colmap_image *im = &m->images[FAR_PHOTO];
    const struct colmap_image was = *im;
    double rot[9];
    camera_quat_to_rot(im->quat_wxyz, rot);
    for (size_t a = 0; a < 3; a++)
        for (size_t b = 0; b < 3; b++)
            im->trans[a] -= rot[3 * a + b] * s->rot[b] * east_m / s->scale;
    for (size_t k = 0; seen && k < im->n_obs; k++) {
        double from[2], to[2];
        if (im->obs[k].point < 0)
            continue;
        project(m, &was, (size_t)im->obs[k].point, from);
        project(m, im, (size_t)im->obs[k].point, to);
        im->obs[k].x_px += to[0] - from[0];
        im->obs[k].y_px += to[1] - from[1];
    }
}

/* Writes a GPS position east_m away into a photograph. */
static void move_gps(const char *photo, double east_m)
{
    struct buf b = {0};
    struct image_gps gps;
    struct err e = {0};
    kit_ok(file_read(photo, 0, &b, &e), e);
    exif_parse(b.data, b.size, &gps, NULL);
    assert_true(gps.has_position && gps.has_altitude);
    gps.lon_deg += east_m / (111320 * cos(gps.lat_deg * 0.017453292519943295));
    kit_ok(exif_insert(&b, &gps, &e), e);
    kit_ok(file_write(photo, b.data, b.size, &e), e);
    buf_free(&b);
}

struct far_case {
    enum { FAR_GPS, FAR_POSE, FAR_POSE_AGAINST_POINTS } wrong;
    double by_m;
    const char *why; /* of being dropped; "": it stays, and its GPS does not count */
};

/* What the scene `out` has of the city, `right` without the fault. */
static void far_ends_as(const char *out, const struct scene *right, const struct far_case *c)
{
    const bool stays = !c->why[0];
    struct scene s;
    struct err e = {0};
    double was[3], is[3], moved[3];
    size_t n;
    json_t *report = read_json(out, "report.json");
    const json_t *p = json_array_get(json_object_get(report, "photos"), FAR_PHOTO);
    if (dropped_as(report, c->why, &n) != (stays ? 32 : 1) || n != !stays ||
        !json_is_null(json_object_get(p, "residual_m")) !=
            (!stays && c->wrong != FAR_POSE_AGAINST_POINTS))
        fail_msg("wrong by %.0f m, kind %d: '%s'", c->by_m, (int)c->wrong,
                 json_string_value(json_object_get(p, "why")));
    kit_ok(scene_read(out, &s, &e), e);
    assert_int_equal(s.n_images, stays ? 32 : 31);
    /* The others lie where they did, and a wrong pose that stays where it was put. */
    camera_center(&right->images[0].cam, was);
    camera_center(&s.images[0].cam, is);
    kit_near_d("another photograph", is, was, 3, tol_place_m, 0);
    camera_center(&right->images[FAR_PHOTO].cam, was);
    camera_center(&s.images[FAR_PHOTO].cam, moved);
    was[0] += c->wrong == FAR_POSE ? c->by_m : 0;
    if (stays)
        kit_near_d("the photograph", moved, was, 3, 2 * tol_place_m, 0);
    scene_free(&s);
    json_decref(report);
}

/* A photograph whose GPS or pose is wrong by so much: which of them stay, and that the frame does
 * not follow it. Exact GPS otherwise: the limit is 6 m. */
static void test_far_from_gps(void **state)
{
    static const struct far_case cases[] = {
        {FAR_GPS, 8, ""},
        {FAR_GPS, 15, ""},
        {FAR_GPS, 30, "m from its GPS position, more than 6.0 m"},
        {FAR_POSE, 8, ""},
        {FAR_POSE, 15, ""},
        {FAR_POSE, 30, "m from its GPS position, more than 6.0 m"},
        {FAR_POSE_AGAINST_POINTS, 8, "its pose disagrees with the points it sees"},
        {FAR_POSE_AGAINST_POINTS, 15, "its pose disagrees with the points it sees"},
        {FAR_POSE_AGAINST_POINTS, 30, "its pose disagrees with the points it sees"}};
    char city[FILE_PATH_MAX], images[FILE_PATH_MAX], photo[FILE_PATH_MAX], model[FILE_PATH_MAX],
        out[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct scene right;
    struct buf original = {0};
    struct err e = {0};
    city_config(&sc, city, "far");
    kit_ok(synth_run(&sc, &e), e);
    join(images, city, "images");
    join(photo, images, "IMG_0014.jpg");
    join(model, city, "moved");
    kit_ok(file_mkdir(model, &e), e);
    kit_ok(file_read(photo, 0, &original, &e), e);
    ingest_config(&ic, out, "far-scene");
    ic.exposure = false;
    ic.overwrite = true;
    ic.max_reprojection_px = 2; /* the usual 8 px are a tenth of these pictures */
    kit_ok(ingest_city(city, &ic, &e), e);
    kit_ok(scene_read(out, &right, &e), e);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        struct colmap_model m;
        kit_ok(colmap_read(city, &m, &e), e);
        assert_string_equal(m.images[FAR_PHOTO].name, "IMG_0014.jpg");
        if (cases[k].wrong != FAR_GPS)
            move_pose(&m, &right, cases[k].by_m, cases[k].wrong == FAR_POSE);
        else
            move_gps(photo, cases[k].by_m);
        kit_ok(colmap_write_bin(model, &m, &e), e);
        colmap_free(&m);
        kit_ok(ingest_run(images, model, &ic, &e), e);
        kit_ok(file_write(photo, original.data, original.size, &e), e);
        far_ends_as(out, &right, &cases[k]);
    }
    scene_free(&right);
    buf_free(&original);
}

/* ---- photographs of other systems ---- */

/* A name by a form, in which * stands for the old one without its ending. */
static void name_by(const char *form, const char *stem, char out[300])
{
    const char *star = strchr(form, '*');
    assert_non_null(star);
    snprintf(out, 300, "%.*s%s%s", (int)(star - form), form, stem, star + 1);
}

/* The city's photographs in the folder `to`, made by a command of each ("$1" to "$2"), and its
 * model with names by a form. */
static void city_as(const char *city, const char *to, const char *command, const char *file_form,
                    const char *model_form)
{
    struct colmap_model m;
    struct err e = {0};
    char path[FILE_PATH_MAX], folder[FILE_PATH_MAX];
    kit_ok(colmap_read(city, &m, &e), e);
    join(folder, kit_tmp, to);
    assert_int_equal(kit_run(NULL, "rm -rf '%s' && mkdir -p '%s/model'", folder, folder), 0);
    for (size_t i = 0; i < m.n_images; i++) {
        char file[300], stem[100];
        snprintf(stem, sizeof stem, "%.*s", (int)strcspn(m.images[i].name, "."), m.images[i].name);
        name_by(file_form, stem, file);
        assert_int_equal(kit_run(NULL,
                                 "set -- '%s/images/%s.jpg' '%s/%s' && "
                                 "mkdir -p \"$(dirname \"$2\")\" && %s",
                                 city, stem, folder, file, command),
                         0);
        name_by(model_form, stem, file);
        m.images[i].name = arena_text(&m.arena, file);
    }
    join(path, folder, "model");
    kit_ok(colmap_write_bin(path, &m, &e), e);
    colmap_free(&m);
}

static size_t count_masks(const char *scene)
{
    struct buf out = {0};
    kit_run(&out, "ls '%s/masks' 2>/dev/null | wc -l", scene);
    size_t n = (size_t)atoi((const char *)out.data);
    buf_free(&out);
    return n;
}

/* Names that the model and the folder write in two ways, and photographs with alpha. */
static void test_other_systems(void **state)
{
    static const char link[] = "ln \"$1\" \"$2\"",
                      half[] = "oiiotool \"$1\" --ch R,G,B,A=1 --fill:color=0.5,0.5,0.5,0 "
                               "40x60+0+0 -o \"$2\"",
                      nothing[] = "oiiotool \"$1\" --ch R,G,B,A=0 -o \"$2\"",
                      whole[] = "oiiotool \"$1\" --ch R,G,B,A=1 -o \"$2\"";
    static const struct {
        const char *command, *file, *model;
        bool masks;
    } cases[] = {{link, "*.jpg", "*.JPG", false},
                 {link, "Flug 1/*.jpg", "FLUG 1\\*.jpg", false},
                 {link, "K\u00f6ln/*.jpg", "Ko\u0308ln/*.jpg", false},
                 {link, "e\u0301te\u0301/*.jpg", "\u00e9t\u00e9\\*.JPG", false},
                 {half, "*.png", "*.png", true},
                 {half, "*.tif", "*.tif", true},
                 {half, "*.webp", "*.webp", true},
                 {whole, "*.png", "*.png", false},
                 {nothing, "*.png", "*.png", false}};
    char city[FILE_PATH_MAX], dir[FILE_PATH_MAX], out[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct synth_config sc;
    struct ingest_config ic;
    struct err e = {0};
    city_config(&sc, city, "systems");
    sc.photos = 8;
    kit_ok(synth_run(&sc, &e), e);
    join(path, kit_tmp, "as");
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        struct scene s;
        city_as(city, "as", cases[k].command, cases[k].file, cases[k].model);
        ingest_config(&ic, out, "as-scene");
        ic.overwrite = true;
        ic.origin = "7.5,47.5,300"; /* oiiotool keeps no GPS of some formats */
        ic.metres_per_unit = 1;
        ic.min_gps_share = 1;
        ic.exposure = false;
        join(dir, path, "model");
        log_set_level(LOG_ERROR);
        kit_ok(ingest_run(path, dir, &ic, &e), e);
        log_set_level(LOG_WARN);
        kit_ok(scene_read(out, &s, &e), e);
        if (s.n_images != 8 || count_masks(out) != (cases[k].masks ? 8 : 0))
            fail_msg("%s: %zu photographs, %zu masks", cases[k].model, s.n_images,
                     count_masks(out));
        scene_free(&s);
    }
    /* Two files that differ in capitals alone, and the model means neither for sure. */
    city_as(city, "as", link, "img_*.jpg", "Img_*.jpg");
    kit_run(NULL, "cp '%s/img_IMG_0003.jpg' '%s/IMG_IMG_0003.jpg'", path, path);
    kit_fails(ingest_run(path, dir, &ic, &e), ERR_NOENT, e, "1 of the 8 photographs");
}

/* Samples of 12 bits are read as they are meant. In samples of 16 they are a sixteenth as bright,
 * which a file does not say: a warning does. So it is with floats that count farther than to 1. */
static void test_more_than_8_bits(void **state)
{
    static const struct {
        const char *command, *says; /* "": nothing of light */
    } cases[] = {{"oiiotool \"$1\" -d uint16 --mulc 0.0625 -o \"$2\"", "photographs are dark"},
                 {"oiiotool \"$1\" -d float --mulc 255 -o \"$2\"", "photographs are white"},
                 {"oiiotool \"$1\" -d float -o \"$2\"", ""},
                 {"oiiotool \"$1\" -d uint16 -o \"$2\"", ""},
                 {"oiiotool \"$1\" -d uint12 -o \"$2\"", ""}};
    char city[FILE_PATH_MAX];
    struct synth_config sc;
    struct err e = {0};
    city_config(&sc, city, "deep");
    sc.photos = 8;
    kit_ok(synth_run(&sc, &e), e);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        struct buf out = {0};
        city_as(city, "deep-as", cases[k].command, "*.tif", "*.tif");
        assert_int_equal(kit_run(&out,
                                 "cd '%s' && '%s' ingest deep-as deep-as/model -o deep-scene "
                                 "--overwrite --origin 7.5,47.5,300 --metres-per-unit 1 "
                                 "--min-gps-share 1 --no-exposure",
                                 kit_tmp, kit_program()),
                         0);
        buf_u8(&out, 0);
        if (!strstr((const char *)out.data, *cases[k].says ? cases[k].says : "scene ") ||
            (!*cases[k].says && strstr((const char *)out.data, "all photographs are")))
            fail_msg("%s: %s", cases[k].command, (const char *)out.data);
        buf_free(&out);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_broken_photographs),
        cmocka_unit_test(test_other_systems),
        cmocka_unit_test(test_more_than_8_bits),
        cmocka_unit_test(test_far_from_gps),
    };
    progress_quiet(true);
    log_set_level(LOG_WARN);
    return cmocka_run_group_tests_name("ingest_photographs", tests, kit_tmp_make,
                                       ingest_kit_teardown);
}
