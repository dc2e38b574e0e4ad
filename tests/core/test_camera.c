/* Cameras and lens models: conventions, closed forms, round trips, hostile JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/splat/camera.h"
#include "tests/kit.h"

static const double tol_exact = 1e-12; /* a few roundings of double */
static const double tol_newton =
    1e-7; /* px: the solver stops at 1e-9 px, 1e2 of slack for its last step */

/* Pixel of a world point. */
static void project(const struct camera *c, const double x[3], double uv[2])
{
    double t[3];
    for (int i = 0; i < 3; i++)
        t[i] = c->rot[3 * i] * x[0] + c->rot[3 * i + 1] * x[1] + c->rot[3 * i + 2] * x[2] +
               c->trans[i];
    uv[0] = c->fx_px * t[0] / t[2] + c->cx_px;
    uv[1] = c->fy_px * t[1] / t[2] + c->cy_px;
}

static void test_look_at_conventions(void **state)
{
    const double eye[3] = {10, 20, 100}, below[3] = {10, 20, 0};
    struct camera c = camera_look_at(eye, below, 60 * M_PI / 180, 400, 300);
    double center[3], uv[2];
    camera_center(&c, center);
    kit_near_d("center", center, eye, 3, tol_exact * 100, 0);
    /* Straight down with north up: east is right, north is up in the picture. */
    project(&c, (double[3]){20, 20, 0}, uv);
    assert_true(uv[0] > 200 && fabs(uv[1] - 150) < 1e-9);
    project(&c, (double[3]){10, 30, 0}, uv);
    assert_true(fabs(uv[0] - 200) < 1e-9 && uv[1] < 150);
    /* fov_y: the ground at the upper edge is 100 tan(30 deg) away. */
    project(&c, (double[3]){10, 20 + 100 * tan(M_PI / 6), 0}, uv);
    assert_true(fabs(uv[1]) < 1e-9);
    /* Horizontal view to the east: up is up, south is right. */
    c = camera_look_at(eye, (double[3]){60, 20, 100}, 1, 400, 300);
    project(&c, (double[3]){60, 10, 110}, uv);
    assert_true(uv[0] > 200 && uv[1] < 150);
    /* Eye on target must not give NaN. */
    c = camera_look_at(eye, eye, 1, 400, 300);
    for (int i = 0; i < 9; i++)
        assert_true(isfinite(c.rot[i]));
}

static void test_heading_agrees_with_look_at(void **state)
{
    const double eye[3] = {-3, 7, 50};
    for (int k = 0; k < 24; k++) {
        double heading = k * 15.0, pitch = -80 + 6.5 * k, h = heading * M_PI / 180,
               p = pitch * M_PI / 180;
        double target[3] = {eye[0] + 9 * sin(h) * cos(p), eye[1] + 9 * cos(h) * cos(p),
                            eye[2] + 9 * sin(p)};
        struct camera a = camera_heading(eye, heading, pitch, 0.8, 320, 200);
        struct camera b = camera_look_at(eye, target, 0.8, 320, 200);
        kit_near_d("rot", a.rot, b.rot, 9, 1e-9, 0);
        kit_near_d("trans", a.trans, b.trans, 3, 1e-7, 0);
    }
    /* Straight down, heading east: the top of the picture is east. */
    struct camera c = camera_heading(eye, 90, -90, 0.8, 320, 200);
    double uv[2];
    project(&c, (double[3]){7, 7, 0}, uv);
    assert_true(uv[1] < 100 && fabs(uv[0] - 160) < 1e-6);
}

static void test_resize_keeps_the_view(void **state)
{
    struct camera c =
        camera_look_at((double[3]){0, -30, 40}, (double[3]){1, 2, 3}, 0.9, 1600, 1200);
    struct camera d = camera_resize(&c, 400, 301);
    const double x[3] = {4, 5, 6};
    double a[2], b[2];
    project(&c, x, a);
    project(&d, x, b);
    const double want[2] = {a[0] * 400 / 1600, a[1] * 301 / 1200};
    kit_near_d("pixel", b, want, 2, 1e-9, 0);
}

static void test_project(void **state)
{
    const struct camera c =
        camera_look_at((double[3]){3, -30, 40}, (double[3]){1, 2, 3}, 0.9, 640, 480);
    double px[2], want[2], depth_m, again_m;
    size_t framed = 0;
    for (uint64_t i = 0; i < 2000; i++) {
        double x[3], ahead = c.trans[2];
        for (uint64_t k = 0; k < 3; k++) {
            x[k] = 60 * rng_normal(2, i, k);
            ahead += c.rot[6 + k] * x[k];
        }
        bool front = camera_project(&c, x, 0, px, &depth_m);
        assert_int_equal(front, ahead > 0);
        bool inside = false;
        if (front) {
            project(&c, x, want);
            kit_near_d("pixel", px, want, 2, tol_exact, tol_exact);
            kit_near_d("depth", &depth_m, &ahead, 1, tol_exact * 100, 0);
            inside = px[0] >= 0 && px[0] < 640 && px[1] >= 0 && px[1] < 480;
        }
        assert_int_equal(camera_frames(&c, x, 0, &again_m), inside);
        assert_true(!inside || again_m == depth_m);
        framed += inside;
    }
    assert_in_range(framed, 100, 1900); /* both happen */
}

/* Numbers that double holds exactly: a camera at the origin that looks north. */
static void test_project_edges(void **state)
{
    const struct camera c = {.width_px = 64,
                             .height_px = 32,
                             .fx_px = 16,
                             .fy_px = 16,
                             .cx_px = 32,
                             .cy_px = 16,
                             .rot = {1, 0, 0, 0, 0, -1, 0, 1, 0}};
    double px[2] = {-7, -7}, depth_m = -7;
    /* Not deeper than the near plane: nothing is written. */
    assert_false(camera_project(&c, (double[3]){0, 2, 0}, 2, px, &depth_m));
    assert_false(camera_project(&c, (double[3]){1, 0, 1}, 0, px, &depth_m));
    assert_false(camera_project(&c, (double[3]){0, -4, 0}, 0, px, &depth_m));
    assert_false(camera_project(&c, (double[3]){0, (double)NAN, 0}, 0, px, &depth_m));
    assert_true(px[0] == -7 && px[1] == -7 && depth_m == -7);
    assert_true(camera_project(&c, (double[3]){0, nextafter(2, 3), 0}, 2, px, NULL));
    assert_true(camera_project(&c, (double[3]){16, 4, 2}, 2, px, &depth_m)); /* outside, in front */
    assert_true(px[0] == 96 && px[1] == 8 && depth_m == 4);
    /* The left and upper border belong to the picture, the right and lower do not. */
    assert_true(camera_frames(&c, (double[3]){-8, 4, 4}, 0, &depth_m));
    assert_true(depth_m == 4);
    assert_false(camera_frames(&c, (double[3]){nextafter(-8, -9), 4, 4}, 0, NULL));
    assert_false(camera_frames(&c, (double[3]){-8, 4, nextafter(4, 5)}, 0, NULL));
    assert_false(camera_frames(&c, (double[3]){8, 4, 0}, 0, NULL));
    assert_false(camera_frames(&c, (double[3]){0, 4, -4}, 0, NULL));
    assert_true(camera_frames(&c, (double[3]){7.9375, 4, -3.9375}, 0, NULL));
    /* Behind, where the mirrored pixel would be in the middle; at the near plane. */
    assert_false(camera_frames(&c, (double[3]){0, -4, 0}, 0, NULL));
    assert_false(camera_frames(&c, (double[3]){0, 4, 0}, 4, NULL));
}

static void test_quaternions(void **state)
{
    for (uint64_t i = 0; i < 2000; i++) {
        double q[4], rot[9], back[4], n = 0;
        for (uint64_t k = 0; k < 4; k++) {
            q[k] = rng_normal(1, i, k);
            if (i % 5 == k) /* near the switches of Shepperd's method */
                q[k] *= 1e-9;
            n += q[k] * q[k];
        }
        double sign = (q[0] < 0 ? -1 : 1) / sqrt(n);
        for (int k = 0; k < 4; k++)
            q[k] *= sign;
        camera_quat_to_rot(q, rot);
        camera_rot_to_quat(rot, back);
        if (q[0] < 1e-6 && q[1] * back[1] + q[2] * back[2] + q[3] * back[3] < 0)
            for (int k = 0; k < 4; k++)
                back[k] = -back[k]; /* w = 0: q and -q are the same rotation */
        kit_near_d("quaternion", back, q, 4, 1e-7, 0);
    }
}

static const char good_json[] =
    "{\"width\":640,\"height\":480,\"fx\":500,\"fy\":501,\"cx\":320,\"cy\":240,"
    "\"world_to_camera\":[1,0,0,1, 0,-1,0,2, 0,0,-1,3, 0,0,0,1]}";

static enum err_code parse(const char *text, struct camera *c, struct err *e)
{
    json_t *o = NULL;
    enum err_code rc = jsonc_parse(text, strlen(text), "test", &o, e);
    if (!rc)
        rc = camera_from_json(o, c, e);
    json_decref(o);
    return rc;
}

static void test_json(void **state)
{
    struct camera c;
    struct err e = {0};
    kit_ok(parse(good_json, &c, &e), e);
    assert_int_equal(c.width_px, 640);
    assert_true(c.fy_px == 501 && c.rot[4] == -1 && c.trans[2] == 3);
    static const struct {
        const char *from, *to, *names;
    } bad[] = {
        {"640", "0", "width"},
        {"480", "99999", "height"},
        {"480", "4.5", "height"},
        {"500", "-1", "fx"},
        {"\"cx\":320,", "", "cx"},
        {"1,0,0,1,", "1,0,0,", "world_to_camera"},
        {"1,0,0,1,", "2,0,0,1,", "world_to_camera"},
        {"1,0,0,1,", "-1,0,0,1,", "mirror"},
        {"0,0,0,1]", "1,2,3,1]", "row"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        char text[512];
        const char *at = strstr(good_json, bad[i].from);
        assert_non_null(at);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - good_json), good_json, bad[i].to,
                 at + strlen(bad[i].from));
        kit_fails(parse(text, &c, &e), ERR_FORMAT, e, bad[i].names);
    }
}

/* A believable lens of each model for a 1000 x 800 picture. */
static struct lens lens_of(enum lens_model m)
{
    static const double params[LENS_COUNT][12] = {
        {700, 500, 400},
        {700, 710, 500, 400},
        {700, 500, 400, -0.12},
        {700, 500, 400, -0.15, 0.03},
        {700, 710, 505, 395, -0.11, 0.05, 0.001, -0.002},
        {420, 425, 505, 395, 0.02, -0.01, 0.003, -0.001},
        {700, 710, 505, 395, -0.2, 0.05, 0.001, -0.002, 0.01, -0.05, 0.02, 0.001},
        {700, 710, 500, 400, 0.9},
        {420, 500, 400, 0.02},
        {420, 500, 400, 0.02, -0.01},
        {420, 425, 505, 395, 0.02, -0.01, 0.001, 0.0007, 0.003, -0.001, 0.0005, -0.0003},
    };
    struct lens l = {.model = m, .width_px = 1000, .height_px = 800};
    memcpy(l.params, params[m], sizeof l.params);
    return l;
}

static void test_lens_round_trip(void **state)
{
    for (int m = 0; m < LENS_COUNT; m++) {
        struct lens l = lens_of((enum lens_model)m);
        for (double v = 0; v <= 800; v += 80)
            for (double u = 0; u <= 1000; u += 100) {
                double x, y, uv[2];
                const double want[2] = {u, v};
                if (!lens_undistort(&l, u, v, &x, &y))
                    fail_msg("%s: no inverse at %g %g", lens_name(l.model), u, v);
                lens_distort(&l, x, y, &uv[0], &uv[1]);
                kit_near_d(lens_name(l.model), uv, want, 2, tol_newton, 0);
            }
    }
}

/* Closed forms by hand, so that a round trip cannot hide a wrong formula. */
static void test_lens_values(void **state)
{
    const double x = 0.3, y = -0.2, r2 = x * x + y * y, r = sqrt(r2), th = atan(r);
    double got[2];
    struct lens l = lens_of(LENS_OPENCV);
    lens_distort(&l, x, y, &got[0], &got[1]);
    double d = 1 + -0.11 * r2 + 0.05 * r2 * r2;
    const double opencv[2] = {700 * (x * d + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)) + 505,
                              710 * (y * d + 2 * -0.002 * x * y + 0.001 * (r2 + 2 * y * y)) + 395};
    kit_near_d("OPENCV", got, opencv, 2, 1e-10, 0);
    l = lens_of(LENS_OPENCV_FISHEYE);
    lens_distort(&l, x, y, &got[0], &got[1]);
    double t2 = th * th, td = th * (1 + t2 * (0.02 + t2 * (-0.01 + t2 * (0.003 + t2 * -0.001))));
    const double fish[2] = {420 * x * td / r + 505, 425 * y * td / r + 395};
    kit_near_d("OPENCV_FISHEYE", got, fish, 2, 1e-10, 0);
    l = lens_of(LENS_FOV);
    lens_distort(&l, x, y, &got[0], &got[1]);
    double rd = atan(2 * r * tan(0.45)) / 0.9;
    const double fov[2] = {700 * x * rd / r + 500, 710 * y * rd / r + 400};
    kit_near_d("FOV", got, fov, 2, 1e-10, 0);
    l = lens_of(LENS_FULL_OPENCV);
    lens_distort(&l, x, y, &got[0], &got[1]);
    double r4 = r2 * r2, r6 = r4 * r2;
    d = (1 - 0.2 * r2 + 0.05 * r4 + 0.01 * r6) / (1 - 0.05 * r2 + 0.02 * r4 + 0.001 * r6);
    const double full[2] = {700 * (x * d + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)) + 505,
                            710 * (y * d + 2 * -0.002 * x * y + 0.001 * (r2 + 2 * y * y)) + 395};
    kit_near_d("FULL_OPENCV", got, full, 2, 1e-10, 0);
    l = lens_of(LENS_THIN_PRISM_FISHEYE);
    lens_distort(&l, x, y, &got[0], &got[1]);
    double a = x * th / r, b = y * th / r;
    d = 1 + t2 * (0.02 + t2 * (-0.01 + t2 * (0.003 + t2 * -0.001)));
    const double prism[2] = {
        420 * (a * d + 2 * 0.001 * a * b + 0.0007 * (t2 + 2 * a * a) + 0.0005 * t2) + 505,
        425 * (b * d + 2 * 0.0007 * a * b + 0.001 * (t2 + 2 * b * b) - 0.0003 * t2) + 395};
    kit_near_d("THIN_PRISM_FISHEYE", got, prism, 2, 1e-10, 0);
}

/* A picture of another size sees the same, whatever the model and however the aspect was rounded.
 */
static void test_lens_resize(void **state)
{
    for (int m = 0; m < LENS_COUNT; m++) {
        struct lens l = lens_of((enum lens_model)m), r = lens_resize(&l, 334, 265);
        double a[2], got[2];
        lens_distort(&l, 0.3, -0.2, &a[0], &a[1]);
        lens_distort(&r, 0.3, -0.2, &got[0], &got[1]);
        const double want[2] = {a[0] * 334 / 1000, a[1] * 265 / 800};
        kit_near_d(lens_name(l.model), got, want, 2, 1e-9, 0);
        assert_int_equal(lens_is_pinhole(&l), m == LENS_PINHOLE || m == LENS_SIMPLE_PINHOLE);
        assert_int_equal(lens_is_pinhole(&l), lens_is_pinhole(&r));
    }
    struct lens l = lens_of(LENS_OPENCV);
    memset(l.params + 4, 0, 4 * sizeof *l.params);
    assert_true(lens_is_pinhole(&l));
}

/* k1 = -0.5 folds back at r = sqrt(2/3): pixels beyond it belong to no direction. */
static void test_lens_without_inverse(void **state)
{
    struct lens l = {.model = LENS_SIMPLE_RADIAL,
                     .width_px = 1000,
                     .height_px = 800,
                     .params = {500, 500, 400, -0.5}};
    double edge = sqrt(2.0 / 3.0) * (1 - 0.5 * 2.0 / 3.0), x, y;
    assert_true(lens_undistort(&l, 500 + 500 * (edge - 0.01), 400, &x, &y));
    assert_true(x < sqrt(2.0 / 3.0));
    assert_false(lens_undistort(&l, 500 + 500 * (edge + 0.01), 400, &x, &y));
    assert_false(lens_undistort(&l, (double)NAN, 400, &x, &y));
    /* A fisheye pixel at 90 degrees or more is not in front of a pinhole. */
    l = lens_of(LENS_SIMPLE_RADIAL_FISHEYE);
    assert_false(lens_undistort(&l, 500 + 420 * 1.7, 400, &x, &y));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_look_at_conventions),
        cmocka_unit_test(test_heading_agrees_with_look_at),
        cmocka_unit_test(test_resize_keeps_the_view),
        cmocka_unit_test(test_project),
        cmocka_unit_test(test_project_edges),
        cmocka_unit_test(test_quaternions),
        cmocka_unit_test(test_json),
        cmocka_unit_test(test_lens_round_trip),
        cmocka_unit_test(test_lens_values),
        cmocka_unit_test(test_lens_resize),
        cmocka_unit_test(test_lens_without_inverse),
    };
    return cmocka_run_group_tests_name("camera", tests, NULL, NULL);
}
