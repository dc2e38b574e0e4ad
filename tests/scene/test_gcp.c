/* Ground control points: both file formats, a scene without GPS that they place to the centimetres
 * of their marks, check points, and what is refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "scene/control/gcp_read.h"
#include "scene/ingest/ingest.h"
#include "tests/scene/city_kit.h"

static char tmp[FILE_PATH_MAX], city[FILE_PATH_MAX], images[FILE_PATH_MAX];
static struct arena texts;
static struct scene by_gps; /* the city as GPS without errors places it */

static void put(const char *name, const char *text, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(path, tmp, name, &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

static void config(struct ingest_config *c, char *dir, const char *name)
{
    struct err e = {0};
    kit_ok(options_defaults(ingest_options(), c, &texts, &e), e);
    kit_ok(file_join(dir, tmp, name, &e), e);
    c->output = dir;
}

/* Its photographs and poses do not depend on the errors of GPS. */
static void make_city(const char *dir, double gps_sigma_m)
{
    struct err e = {0};
    struct synth_config sc;
    city_kit_config(&sc, &texts, dir, 32);
    sc.gps_sigma_m = gps_sigma_m;
    kit_ok(synth_run(&sc, &e), e);
}

static int setup(void **state)
{
    struct err e = {0};
    struct ingest_config ic;
    char dir[FILE_PATH_MAX];
    kit_tmpdir(tmp);
    kit_ok(file_join(city, tmp, "city", &e), e);
    kit_ok(file_join(images, city, "images", &e), e);
    make_city(city, 0);
    config(&ic, dir, "gps");
    kit_ok(ingest_run(images, city, &ic, &e), e);
    kit_ok(scene_read(dir, &by_gps, &e), e);
    return 0;
}

static int teardown(void **state)
{
    scene_free(&by_gps);
    arena_free(&texts);
    kit_rmdir(tmp);
    return 0;
}

enum { PLACES = 10 };
static double places[PLACES][3] = {{-30, -28, 2}, {31, -25, 0}, {28, 33, 5},  {-29, 30, 1},
                                   {2, -3, 9},    {14, 12, 0},  {-15, 10, 3}, {10, -18, 0},
                                   {22, 5, 6},    {-8, -20, 1}};

/* The sparse point that a place is, SIZE_MAX: none. Of one, photographs count that found it. */
static size_t tracked[PLACES] = {SIZE_MAX, SIZE_MAX, SIZE_MAX, SIZE_MAX, SIZE_MAX,
                                 SIZE_MAX, SIZE_MAX, SIZE_MAX, SIZE_MAX, SIZE_MAX};

static bool sees(size_t image, size_t point)
{
    for (size_t i = 0; i < by_gps.n_tracks; i++)
        if (by_gps.tracks[i].point == point && by_gps.tracks[i].image == image)
            return true;
    return point == SIZE_MAX;
}

/* Standard deviations of what people do: survey a point, each axis; mark it in photographs. */
static double survey_m, mark_px;

/* A list of these places as OpenDroneMap writes it, each in up to `most` photographs. */
static void write_list(struct buf *b, const size_t *which, size_t n, size_t most, double scale)
{
    struct err e = {0};
    buf_printf(b, "EPSG:4326\n");
    for (size_t i = 0; i < n; i++) {
        double lon, lat, h, px[2], surveyed[3];
        size_t marks = 0;
        for (size_t k = 0; k < 3; k++)
            surveyed[k] = places[which[i]][k] + survey_m * rng_normal(5, k, which[i]);
        kit_ok(geo_from_enu(&by_gps.origin, surveyed, &lon, &lat, &h, &e), e);
        for (size_t k = 0; k < by_gps.n_images && marks < most; k++) {
            if (!city_kit_sees(&by_gps.images[k].cam, places[which[i]], 1, px) ||
                !sees(k, tracked[which[i]]))
                continue;
            buf_printf(b, "%.10f\t%.10f\t%.4f\t%.3f\t%.3f\t%s\tp%zu\n", lon, lat, h,
                       px[0] * scale + mark_px * rng_normal(6, which[i], k),
                       px[1] * scale + mark_px * rng_normal(7, which[i], k), by_gps.images[k].name,
                       which[i]);
            marks++;
        }
        assert_true(marks >= 1);
    }
    buf_u8(b, 0);
}

/* Camera centres of a scene against those by GPS, in the frame of the latter: the largest
 * distance. */
static double far_off(const char *dir)
{
    struct err e = {0};
    struct scene s;
    double worst = 0;
    kit_ok(scene_read(dir, &s, &e), e);
    assert_int_equal(s.n_images, by_gps.n_images);
    for (size_t i = 0; i < s.n_images; i++) {
        double a[3], b[3], lon, lat, h;
        camera_center(&s.images[i].cam, a);
        kit_ok(geo_from_enu(&s.origin, a, &lon, &lat, &h, &e), e);
        kit_ok(geo_to_enu(&by_gps.origin, lon, lat, h, a, &e), e);
        camera_center(&by_gps.images[i].cam, b);
        worst = fmax(worst, hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]));
    }
    scene_free(&s);
    return worst;
}

static json_t *report(const char *dir)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    json_t *o;
    kit_ok(file_join(path, dir, "report.json", &e), e);
    kit_ok(jsonc_read(path, &o, &e), e);
    return o;
}

static double rmse(const json_t *root, const char *of, const char *key)
{
    return json_number_value(
        json_object_get(json_object_get(json_object_get(root, "ground_control"), of), key));
}

/* Four points fix the scene; two that were kept out lie where they were surveyed. */
static void control_points_place_the_scene(void **state)
{
    static const size_t which[6] = {0, 1, 2, 3, 4, 5};
    struct err e = {0};
    struct buf b = {0};
    struct gcp_list l;
    struct ingest_config ic;
    char path[FILE_PATH_MAX], dir[FILE_PATH_MAX];
    write_list(&b, which, 6, 8, 4);
    put("gcp_list.txt", (char *)b.data, path);
    buf_free(&b);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.n, 6);
    assert_int_equal(l.epsg, GCP_LONLAT);
    kit_ok(gcp_keep_out(&l, "p4,p5", &e), e);
    config(&ic, dir, "gcp");
    ic.gcp_scale = 4;
    kit_ok(ingest_run_gcp(images, city, &ic, &l, &e), e);
    json_t *o = report(dir);
    printf("gcp: cameras off by %.3f m at most, control %.4f m plan %.4f height, check %.4f %.4f\n",
           far_off(dir), rmse(o, "control", "rmse_plan_m"), rmse(o, "control", "rmse_height_m"),
           rmse(o, "check", "rmse_plan_m"), rmse(o, "check", "rmse_height_m"));
    assert_true(far_off(dir) < 0.05);
    assert_true(rmse(o, "control", "points") == 4 && rmse(o, "check", "points") == 2);
    assert_true(rmse(o, "control", "rmse_plan_m") < 0.02);
    assert_true(rmse(o, "check", "rmse_plan_m") < 0.02 && rmse(o, "check", "rmse_height_m") < 0.05);
    json_decref(o);
    /* a wrong survey of one is seen in the residuals */
    l.gcps[2].at[2] += 5;
    ic.overwrite = true;
    kit_ok(ingest_run_gcp(images, city, &ic, &l, &e), e);
    o = report(dir);
    assert_true(rmse(o, "control", "rmse_height_m") > 0.5);
    json_decref(o);
    gcp_free(&l);
}

/* Marked once each: by the sparse points around; and two of them, with level ground. The places are
 * sparse points of their own here: nothing else of the city says how high its surface is. */
static void one_photograph_and_two_points_do(void **state)
{
    static const size_t four[4] = {0, 1, 2, 3}, two[2] = {0, 2};
    for (size_t i = 0; i < 4; i++) {
        double least = HUGE_VAL, want[2] = {places[i][0], places[i][1]};
        for (size_t k = 0; k < by_gps.n_points; k++) {
            const double *x = by_gps.points[k].enu_m;
            double d = hypot(x[0] - want[0], x[1] - want[1]);
            if (d < least && x[2] < 1) { /* on the ground */
                memcpy(places[i], x, sizeof places[i]);
                tracked[i] = k;
            }
            least = x[2] < 1 ? fmin(d, least) : least;
        }
    }
    for (int k = 0; k < 2; k++) {
        struct err e = {0};
        struct buf b = {0};
        struct gcp_list l;
        struct ingest_config ic;
        char path[FILE_PATH_MAX], dir[FILE_PATH_MAX];
        write_list(&b, k ? two : four, k ? 2 : 4, k ? 8 : 1, 1);
        put("few.txt", (char *)b.data, path);
        buf_free(&b);
        kit_ok(gcp_read(path, &l, &e), e);
        config(&ic, dir, k ? "two" : "once");
        kit_ok(ingest_run_gcp(images, city, &ic, &l, &e), e);
        printf("gcp: %s: cameras off by %.2f m at most\n", k ? "two points" : "one mark each",
               far_off(dir));
        json_t *o = report(dir);
        assert_true(rmse(o, "control", "rmse_plan_m") < 2);
        assert_true(rmse(o, "control", "rmse_height_m") < 2);
        json_decref(o);
        assert_true(far_off(dir) < 12); /* pixels of these photographs are 1 m wide */
        gcp_free(&l);
    }
}

/* The poses of the city, with the camera of one photograph 2000 units under the ground. */
static void write_poses_with_a_wrong_one(const char *dir)
{
    struct err e = {0};
    struct colmap_model m;
    char path[FILE_PATH_MAX];
    kit_ok(colmap_read(city, &m, &e), e);
    struct colmap_image *im = &m.images[13];
    const double *q = im->quat_wxyz, *up = &by_gps.rot[6]; /* third row: up in COLMAP's frame */
    double cross[3], twice[3];
    for (size_t k = 0; k < 3; k++) /* t = -R c: t moves by R up, v + 2 w (q x v) + 2 q x (q x v) */
        cross[k] = q[1 + (k + 1) % 3] * up[(k + 2) % 3] - q[1 + (k + 2) % 3] * up[(k + 1) % 3];
    for (size_t k = 0; k < 3; k++)
        twice[k] =
            q[1 + (k + 1) % 3] * cross[(k + 2) % 3] - q[1 + (k + 2) % 3] * cross[(k + 1) % 3];
    for (size_t k = 0; k < 3; k++)
        im->trans[k] += 2000 * (up[k] + 2 * q[0] * cross[k] + 2 * twice[k]);
    kit_ok(file_mkdir(dir, &e), e);
    kit_ok(file_join(path, dir, "sparse", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(colmap_write_bin(path, &m, &e), e);
    colmap_free(&m);
}

/* Of two points, what is up comes from the cameras: one wrong pose does not outvote the others. */
static void a_wrong_pose_turns_nothing_over(void **state)
{
    static const size_t two[2] = {0, 2};
    struct err e = {0};
    struct buf b = {0};
    struct gcp_list l;
    struct ingest_config ic;
    struct scene s;
    char path[FILE_PATH_MAX], dir[FILE_PATH_MAX], poses[FILE_PATH_MAX];
    kit_ok(file_join(poses, tmp, "poses", &e), e);
    write_poses_with_a_wrong_one(poses);
    write_list(&b, two, 2, 3, 1);
    put("two.txt", (char *)b.data, path);
    buf_free(&b);
    kit_ok(gcp_read(path, &l, &e), e);
    config(&ic, dir, "upright");
    kit_ok(ingest_run_gcp(images, poses, &ic, &l, &e), e);
    kit_ok(scene_read(dir, &s, &e), e);
    assert_int_equal(s.n_images, by_gps.n_images - 1);
    for (size_t i = 0; i < s.n_images; i++)
        assert_true(s.images[i].cam.rot[8] < 0); /* cameras look down */
    scene_free(&s);
    gcp_free(&l);
}

/* What a survey is paid for: GPS that errs by 3 m, six control points surveyed to 2 cm and marked
 * to half a pixel in photographs of 1600 x 1200 px, about 5 cm on the ground; four exact check
 * points. */
static void control_points_mend_gps(void **state)
{
    static const size_t all[PLACES] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9};
    enum { CONTROL = 6, MARKS = 8 };
    const double scale = 20;
    struct err e = {0};
    struct buf b = {0}, check = {0};
    struct gcp_list l;
    struct ingest_config ic;
    char path[FILE_PATH_MAX], dir[FILE_PATH_MAX], noisy[FILE_PATH_MAX], photos[FILE_PATH_MAX];
    kit_ok(file_join(noisy, tmp, "noisy", &e), e);
    kit_ok(file_join(photos, noisy, "images", &e), e);
    make_city(noisy, 3);
    config(&ic, dir, "noisy-gps");
    kit_ok(ingest_run(photos, noisy, &ic, &e), e);
    double by_noise = far_off(dir);
    mark_px = 0.5;
    survey_m = 0.02;
    write_list(&b, all, CONTROL, MARKS, scale);
    survey_m = 0;
    write_list(&check, all + CONTROL, PLACES - CONTROL, MARKS, scale);
    mark_px = 0;
    b.size--; /* the end of the text */
    buf_printf(&b, "%s", strchr((char *)check.data, '\n') + 1);
    buf_u8(&b, 0);
    put("survey.txt", (char *)b.data, path);
    buf_free(&b);
    buf_free(&check);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.n, PLACES);
    kit_ok(gcp_keep_out(&l, "p6,p7,p8,p9", &e), e);
    config(&ic, dir, "noisy-gcp");
    ic.gcp_scale = scale;
    kit_ok(ingest_run_gcp(photos, noisy, &ic, &l, &e), e);
    json_t *o = report(dir);
    double plan_m = rmse(o, "check", "rmse_plan_m"), height_m = rmse(o, "check", "rmse_height_m");
    printf("gcp: GPS errs by 3 m: cameras off by %.2f m at most; by 6 points of 2 cm %.3f m, check "
           "points RMSE %.4f m in plan, %.4f m in height\n",
           by_noise, far_off(dir), plan_m, height_m);
    assert_true(by_noise > 0.5);
    assert_true(rmse(o, "control", "points") == CONTROL && rmse(o, "check", "points") == 4);
    assert_true(plan_m > 0.002 && plan_m <= 0.05);
    assert_true(height_m > 0.002 && height_m <= 0.08);
    json_decref(o);
    gcp_free(&l);
}

/* The report of that survey, as people read it: one file that needs no other. */
static void the_report_tells_them(void **state)
{
    static const char *const wants[] = {"photographs used</td><td>32 of 32",
                                        "check points, RMSE in plan",
                                        "<td>p7</td><td>check</td>",
                                        "<td>p0</td><td>control</td>",
                                        "Coverage",
                                        "data:image/png;base64,iVBOR",
                                        "GPS minus camera",
                                        "fitted to ground control points",
                                        "A &lt;b&gt; &amp; c"};
    static const char *const never[] = {"<script", "http:", "https:", "nan"};
    struct buf out = {0};
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && '%s' report -q noisy-gcp -o report.html --title 'A <b> & c' "
                "&& cat report.html",
                tmp, kit_program()),
        0);
    for (size_t i = 0; i < sizeof wants / sizeof *wants; i++)
        kit_expect_text((const char *)out.data, wants[i], __FILE__, __LINE__);
    for (size_t i = 0; i < sizeof never / sizeof *never; i++)
        if (strstr((const char *)out.data, never[i]))
            fail_msg("the report has %s", never[i]);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "cd '%s' && '%s' report -q . -o x.html", tmp, kit_program()), 1);
    kit_expect_text((const char *)out.data, "scene.json", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "cd '%s' && '%s' report -q noisy-gcp", tmp, kit_program()), 2);
    buf_free(&out);
}

static void csv_is_read(void **state)
{
    struct err e = {0};
    struct gcp_list l;
    char path[FILE_PATH_MAX];
    put("a.csv",
        "# by hand\nName, Image, px, py, Easting, Northing, Height\r\n"
        "north, DJI_1.JPG, 10.5, 20, 634676, 485344, 112\r\n"
        "south, DJI_1.JPG, 30, 40.25, 634604, 485234, 111\r\n"
        "north, DJI_2.JPG, 11, 22, 634676, 485344, 112\r\n",
        path);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.n, 2);
    assert_int_equal(l.n_marks, 3);
    assert_int_equal(l.epsg, 0);
    assert_string_equal(l.gcps[0].name, "north");
    assert_string_equal(l.marks[1].image, "DJI_1.JPG");
    assert_true(l.marks[1].gcp == 1 && l.marks[1].y_px == 40.25 && l.gcps[1].at[0] == 634604);
    gcp_free(&l);
    put("b.csv", "name,lon,lat,h,u,v,photo\na,8.6,50.1,100,1,2,x.jpg\n", path);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.epsg, GCP_LONLAT);
    gcp_free(&l);
    put("c.txt", "WGS84 UTM 32N\n1 2 3 4 5 a.jpg\n1 2 3 6 7 b.jpg\n2 2 3 6 7 b.jpg\n", path);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.epsg, 32632);
    assert_int_equal(l.n, 2); /* without names: by their coordinates */
    assert_string_equal(l.gcps[1].name, "2");
    kit_fails(gcp_keep_out(&l, "9", &e), ERR_ARG, e, "no ground control point '9'");
    gcp_free(&l);
    put("d.txt", "1 2 3 4 5 a.jpg p\n1 2 3 6 7 b.jpg p\n", path); /* no line says the system */
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.epsg, 0);
    assert_int_equal(l.n_marks, 2);
    gcp_free(&l);
    put("e.csv", "\xef\xbb\xbflat,lon,z,px,py,image\n50.1,8.6,100,1,2,x.jpg\n", path);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.epsg, GCP_LONLAT);
    assert_true(l.gcps[0].at[0] == 8.6 && l.gcps[0].at[1] == 50.1);
    gcp_free(&l);
    put("f.csv", "easting\tnorthing\telev\tpx\tpy\timage\tpoint\n1\t2\t3\t4,5\t5\ta b.jpg\tp 1\n",
        path);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_string_equal(l.gcps[0].name, "p 1");
    assert_true(l.marks[0].x_px == 4.5 && l.gcps[0].at[2] == 3);
    gcp_free(&l);
    put("g.csv",
        "GCP Label,Easting,Northing,Elevation,Image X,Image Y,Image Name\nq,1,2,3,4,5,a.jpg\n",
        path);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_string_equal(l.gcps[0].name, "q");
    assert_true(l.marks[0].x_px == 4 && l.marks[0].y_px == 5);
    gcp_free(&l);
    put("h.txt", "32632\n1 2 3 4 5 a.jpg\n", path); /* a code alone */
    kit_ok(gcp_read(path, &l, &e), e);
    assert_int_equal(l.epsg, 32632);
    gcp_free(&l);
}

/* Two folders in which cameras began to count anew: every second photograph is in the other one. */
static void photo_name(size_t k, const char *folders[2], char *out, size_t room)
{
    snprintf(out, room, "%sDJI_%04zu.jpg", folders[k % 2], k / 2);
}

/* A control point's marks in folders named like these; the code and message of the run in *e. */
static enum err_code place_by_folders(const char *folders[2], const char *poses, const char *photos,
                                      char dir[FILE_PATH_MAX], struct err *e)
{
    static const size_t four[4] = {0, 1, 2, 3};
    struct buf b = {0};
    struct gcp_list l;
    struct ingest_config ic;
    char path[FILE_PATH_MAX];
    write_list(&b, four, 4, 6, 1);
    put("folders.txt", (char *)b.data, path);
    buf_free(&b);
    kit_ok(gcp_read(path, &l, e), *e);
    for (size_t i = 0; i < l.n_marks; i++)
        for (size_t k = 0; k < by_gps.n_images; k++)
            if (!strcmp(l.marks[i].image, by_gps.images[k].name)) {
                photo_name(k, folders, l.marks[i].image, sizeof l.marks[i].image);
                break;
            }
    config(&ic, dir, "folders");
    ic.overwrite = true;
    enum err_code rc = ingest_run_gcp(photos, poses, &ic, &l, e);
    gcp_free(&l);
    return rc;
}

static void marks_go_to_the_photograph_in_their_folder(void **state)
{
    static const char *folders[2] = {"a/", "b/"}, *full[2] = {"/survey/a/", "C:\\photos\\B\\"},
                      *none[2] = {"", ""}, *other[2] = {"c/", "d/"};
    struct err e = {0};
    struct colmap_model m;
    char poses[FILE_PATH_MAX], photos[FILE_PATH_MAX], path[FILE_PATH_MAX], from[FILE_PATH_MAX],
        dir[FILE_PATH_MAX], name[64];
    kit_ok(file_join(poses, tmp, "two-folders", &e), e);
    kit_ok(file_join(photos, tmp, "two-folders/images", &e), e);
    assert_int_equal(kit_run(NULL, "mkdir -p '%s/sparse' '%s/a' '%s/b'", poses, photos, photos), 0);
    kit_ok(colmap_read(city, &m, &e), e);
    for (size_t i = 0; i < m.n_images; i++) {
        struct buf b = {0};
        photo_name(i, folders, name, sizeof name);
        kit_ok(file_join(from, images, m.images[i].name, &e), e);
        kit_ok(file_join(path, photos, name, &e), e);
        kit_ok(file_read(from, 0, &b, &e), e);
        kit_ok(file_write(path, b.data, b.size, &e), e);
        assert_string_equal(m.images[i].name, by_gps.images[i].name);
        m.images[i].name = arena_printf(&m.arena, "%s", name);
        buf_free(&b);
    }
    kit_ok(file_join(path, poses, "sparse", &e), e);
    kit_ok(colmap_write_bin(path, &m, &e), e);
    colmap_free(&m);
    for (size_t k = 0; k < 2; k++) {
        kit_ok(place_by_folders(k ? full : folders, poses, photos, dir, &e), e);
        json_t *o = report(dir);
        assert_true(rmse(o, "control", "points") == 4);
        assert_true(rmse(o, "control", "rmse_plan_m") < 0.02);
        json_decref(o);
    }
    kit_fails(place_by_folders(none, poses, photos, dir, &e), ERR_DATA, e, "may be a/DJI_");
    kit_fails(place_by_folders(other, poses, photos, dir, &e), ERR_DATA, e, "at least 2");
}

static void nonsense_is_refused(void **state)
{
    static const size_t one[1] = {0}, line[2] = {0, 1};
    static const struct {
        const char *text, *says;
        enum err_code rc;
    } bad[] = {
        {"EPSG:4326\n", "no ground control points", ERR_DATA},
        {"EPSG:4326\n1 2 -9999 4 5 a.jpg\n",
         "line 2: the height is -9999 m, which stands for unknown", ERR_FORMAT},
        {"# EPSG:4326\nx,y,z,px,py,image,name,accuracy_xy\n1,2,3,4,5,a.jpg,p,-1\n",
         "or nothing where it is not known", ERR_FORMAT},
        {"EPSG:4326\n1 2 3 4 x a.jpg\n", "line 2: field 5 is no number", ERR_FORMAT},
        {"EPSG:25832\n634 676.5 5 123 456.7 300 4 5 a.jpg\n",
         "line 2: the photograph is '300', a number; are there decimal commas or thousands sep",
         ERR_FORMAT},
        {"EPSG:25832\n634676.5 5'123'456.7 300 4 5 a.jpg\n",
         "line 2: field 2, '5'123'456.7', has a thousands separator: write it without", ERR_FORMAT},
        {"EPSG:25832\n634676.5\t5 123 456.7\t300\t4\t5\ta.jpg\n", "'5 123 456.7', has a thou",
         ERR_FORMAT},
        {"x,y,z,px,py,image\n634,676.5,5,123,456.7,300,4,5,a.jpg\n",
         "line 2: 9 fields, but the first line names 6; are there decimal commas or thousands sep",
         ERR_FORMAT},
        {"x,y,z,px,py,image\n634676.5,\"5,123,456.7\",300,4,5,a.jpg\n", "thousands separator",
         ERR_FORMAT},
        {"x;y;z;px;py;image\n634676,5;5.123.456,7;300;4;5;a.jpg\n", "thousands separator",
         ERR_FORMAT},
        {"# EPSG:25832\nx,y,z (ft),px,py,image,name\n6e5,5e6,3,4,5,a.jpg,p\n",
         "line 2: column 'z (ft)': metres and decimal degrees are read", ERR_FORMAT},
        {"# EPSG:25832\nx (m),y (m),z (m),px,py,image,accuracy_xy [cm]\n6e5,5e6,3,4,5,a.jpg,2\n",
         "line 2: column 'accuracy_xy [cm]': metres", ERR_FORMAT},
        {"EPSG:4326\n1 2 3 4 5\n", "no photograph", ERR_FORMAT},
        {"EPSG:4326\n1 2 nan 4 5 a.jpg\n", "field 3", ERR_FORMAT},
        {"name,x,y,z,px,py,image\na,1,2,3,4\n", "line 2", ERR_FORMAT},
        {"lat,degrees,z,px,py,image,name\n7,47,100,1,2,a.jpg,a\n", "no column for x", ERR_FORMAT},
        {"x y z px py photo\n1 2 3 4 5 a.jpg\n", "by commas", ERR_FORMAT},
        {"EPSG:4326\n1 2 3 4 5 a.jpg p\n1 2.5 3 4 5 b.jpg p\n",
         "line 3: ground control point p lies at 1 2.5 3 here and at 1 2 3 before", ERR_FORMAT},
        {"EPSG:4326\n1 2 3 4 5 a.jpg a23456789a23456789a23456789a23456789a23456789"
         "a23456789a23456789a\n",
         "line 2: 'a23456789a23456789a23456789a23456789", ERR_FORMAT}};
    struct err e = {0};
    struct gcp_list l;
    struct ingest_config ic;
    struct buf b = {0}, out = {0};
    char path[FILE_PATH_MAX], dir[FILE_PATH_MAX];
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        put("bad.txt", bad[i].text, path);
        kit_fails(gcp_read(path, &l, &e), bad[i].rc, e, bad[i].says);
    }
    kit_fails(gcp_read("/nowhere/gcp.txt", &l, &e), ERR_NOENT, e, "gcp.txt");
    config(&ic, dir, "refused");
    write_list(&b, one, 1, 8, 1);
    put("one.txt", (char *)b.data, path);
    buf_free(&b);
    kit_ok(gcp_read(path, &l, &e), e);
    kit_fails(ingest_run_gcp(images, city, &ic, &l, &e), ERR_DATA, e, "at least 2");
    gcp_free(&l);
    write_list(&b, line, 2, 8, 50);
    put("large.txt", (char *)b.data, path);
    buf_free(&b);
    kit_ok(gcp_read(path, &l, &e), e);
    kit_fails(ingest_run_gcp(images, city, &ic, &l, &e), ERR_DATA, e, "--gcp-scale");
    gcp_free(&l);
    assert_false(file_exists(dir));
    /* through the program: a coordinate system that it does not know, and one that it does */
    put("odd.txt", "PUWG1992\n634676 485344 112 1 1 a.jpg\n", path);
    assert_int_equal(kit_run(&out, "'%s' ingest '%s' '%s' -o '%s' --gcp '%s'", kit_program(),
                             images, city, dir, path),
                     2);
    kit_expect_text((const char *)out.data, "--gcp-epsg CODE", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(
        kit_run(&out, "'%s' ingest '%s' '%s' -o '%s' --check p1", kit_program(), images, city, dir),
        2);
    buf_free(&out);
    kit_ok(file_join(path, tmp, "gcp_list.txt", &e), e);
    assert_int_equal(kit_run(&out,
                             "'%s' ingest '%s' '%s' -q -o '%s' --gcp '%s' --gcp-scale 4 --check p4",
                             kit_program(), images, city, dir, path),
                     0);
    kit_expect_text((const char *)out.data, "check:   RMSE", __FILE__, __LINE__);
    buf_free(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(control_points_place_the_scene),
        cmocka_unit_test(control_points_mend_gps),
        cmocka_unit_test(the_report_tells_them),
        cmocka_unit_test(one_photograph_and_two_points_do),
        cmocka_unit_test(a_wrong_pose_turns_nothing_over),
        cmocka_unit_test(csv_is_read),
        cmocka_unit_test(marks_go_to_the_photograph_in_their_folder),
        cmocka_unit_test(nonsense_is_refused),
    };
    return cmocka_run_group_tests_name("gcp", tests, setup, teardown);
}
