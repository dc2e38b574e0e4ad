/* How well a pose is known: against what happens when photographs are placed again and again by
 * observations with noise, and for points that say little.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/pose_error.h"
#include "tests/kit.h"

#include <math.h>
#include <string.h>

#include "core/math/cholesky.h"

enum { POSE = 6, POINTS = 60, ROUNDS = 400, OTHERS = 30, SIDE = 3 };
static const double noise_px = 1.5, height = 100, focal_px = 1200;
/* 400 rounds tell a standard deviation to 4 %; the estimate takes it from the residuals of one
 * photograph in each round, whose median over the rounds is off by a few per cent. */
static const double round_tolerance = 0.12;

/* A camera above the origin that looks down, and OTHERS beside it, which see the same points. */
struct survey {
    struct colmap_camera camera;
    struct colmap_image images[1 + OTHERS];
    struct colmap_point points[POINTS];
    struct colmap_observation obs[1 + OTHERS][POINTS];
    struct colmap_model m;
};

static void survey_make(struct survey *s, double spread_m, double aside_m, size_t others)
{
    memset(s, 0, sizeof *s);
    s->camera.lens = (struct lens){.model = LENS_SIMPLE_PINHOLE,
                                   .width_px = 1600,
                                   .height_px = 1200,
                                   .params = {focal_px, 800, 600}};
    for (size_t p = 0; p < POINTS; p++) {
        double *x = s->points[p].xyz;
        x[0] = spread_m * ((double)(p % 10) / 9 - 0.5);
        x[1] = 0.75 * spread_m * ((double)(p / 10) / 5 - 0.5);
        x[2] = 5 * sin(1.7 * (double)p);
    }
    for (size_t i = 0; i <= others; i++) {
        double turn = (double)i,
               c[3] = {i ? aside_m * cos(turn) : 0, i ? aside_m * sin(turn) : 0, height};
        struct colmap_image *im = &s->images[i];
        *im = (struct colmap_image){.quat_wxyz = {0, 1, 0, 0}, .obs = s->obs[i], .n_obs = POINTS};
        im->trans[0] = -c[0]; /* half a turn about x: y and z change their signs */
        im->trans[1] = c[1];
        im->trans[2] = c[2];
        for (size_t p = 0; p < POINTS; p++) {
            const double *x = s->points[p].xyz;
            double z = c[2] - x[2];
            s->obs[i][p] = (struct colmap_observation){
                800 + focal_px * (x[0] - c[0]) / z, 600 - focal_px * (x[1] - c[1]) / z, (int64_t)p};
        }
    }
    s->m = (struct colmap_model){.cameras = &s->camera,
                                 .n_cameras = 1,
                                 .images = s->images,
                                 .n_images = 1 + others,
                                 .points = s->points,
                                 .n_points = POINTS};
}

static struct pose_error survey_first(const struct survey *s)
{
    struct pose_error all[1 + OTHERS];
    struct err e = {0};
    kit_ok(pose_error_find(&s->m, all, &e), e);
    return all[0];
}

/* Pixel of a point for the first camera after a small turn w and shift t of its frame. */
static void project(const double pose[POSE], const double x[3], double out[2])
{
    double a[3] = {x[0], -x[1], height - x[2]}, b[3];
    for (size_t k = 0; k < 3; k++) {
        size_t i = (k + 1) % 3, j = (k + 2) % 3;
        b[k] = a[k] + pose[i] * a[j] - pose[j] * a[i] + pose[3 + k];
    }
    out[0] = 800 + focal_px * b[0] / b[2];
    out[1] = 600 + focal_px * b[1] / b[2];
}

/* The pose that fits the observations best: one step of Gauss and Newton, as the noise is small. */
static void place_again(const struct survey *s, double pose[POSE])
{
    double a[POSE][POSE] = {{0}}, b[POSE] = {0};
    memset(pose, 0, POSE * sizeof *pose);
    for (size_t p = 0; p < POINTS; p++) {
        double j[2][POSE], at[2];
        const double *x = s->points[p].xyz;
        project(pose, x, at);
        for (size_t k = 0; k < POSE; k++) {
            double up[POSE] = {0}, down[POSE] = {0}, u[2], d[2];
            up[k] = 1e-5;
            down[k] = -1e-5;
            project(up, x, u);
            project(down, x, d);
            j[0][k] = (u[0] - d[0]) / 2e-5;
            j[1][k] = (u[1] - d[1]) / 2e-5;
        }
        double miss[2] = {s->obs[0][p].x_px - at[0], s->obs[0][p].y_px - at[1]};
        for (size_t k = 0; k < POSE; k++) {
            b[k] += j[0][k] * miss[0] + j[1][k] * miss[1];
            for (size_t l = 0; l < POSE; l++)
                a[k][l] += j[0][k] * j[0][l] + j[1][k] * j[1][l];
        }
    }
    assert_true(cholesky_factor(&a[0][0], POSE, POSE));
    cholesky_solve(&a[0][0], POSE, POSE, b, pose);
}

/* Mean square over the picture of what moved, in pixels. */
static double picture_moved(const double pose[POSE])
{
    static const double none[POSE], at[SIDE] = {0.02, 0.5, 0.98};
    double sum = 0;
    for (size_t k = 0; k < SIDE * SIDE; k++) {
        double x[3] = {(at[k % SIDE] * 1600 - 800) / focal_px * height,
                       -(at[k / SIDE] * 1200 - 600) / focal_px * height, 0},
               was[2], is[2];
        project(none, x, was);
        project(pose, x, is);
        sum += (is[0] - was[0]) * (is[0] - was[0]) + (is[1] - was[1]) * (is[1] - was[1]);
    }
    return sum / (SIDE * SIDE);
}

/* Points that 30 others hold: the pose is off as far as is said, wherever the points lie. */
static void test_rounds(void **state)
{
    static const double spreads_m[] = {120, 30};
    static struct survey s;
    for (size_t k = 0; k < 2; k++) {
        double moved = 0, said = 0;
        for (size_t round = 0; round < ROUNDS; round++) {
            double pose[POSE];
            survey_make(&s, spreads_m[k], 60, OTHERS);
            for (size_t p = 0; p < POINTS; p++) {
                s.obs[0][p].x_px += noise_px * rng_normal(k, round, 2 * p);
                s.obs[0][p].y_px += noise_px * rng_normal(k, round, 2 * p + 1);
            }
            place_again(&s, pose);
            moved += picture_moved(pose);
            said += pow(survey_first(&s).picture_px, 2);
        }
        moved = sqrt(moved / ROUNDS);
        said = sqrt(said / ROUNDS);
        print_message("points over %g m: off by %.3f px, said %.3f\n", spreads_m[k], moved, said);
        assert_true(fabs(said / moved - 1) < round_tolerance);
    }
}

static void test_little(void **state)
{
    static struct survey s;
    survey_make(&s, 120, 60, OTHERS);
    struct pose_error good = survey_first(&s);
    assert_int_equal(good.n_points, POINTS);
    assert_true(good.reprojection_px < 1e-6);
    assert_true(pose_error_known(&good, &s.camera.lens));

    survey_make(&s, 6, 60, OTHERS); /* all in a spot: corners of the picture may be anywhere */
    struct pose_error spot = survey_first(&s);
    assert_true(spot.picture_px > 5 * good.picture_px);
    assert_false(pose_error_known(&spot, &s.camera.lens));

    survey_make(&s, 120, 60, 0); /* seen by nobody else */
    struct pose_error alone = survey_first(&s);
    assert_int_equal(alone.n_points, POINTS);
    assert_false(pose_error_known(&alone, &s.camera.lens));

    /* One other photograph: each point tells its epipolar line alone, and the distance between
     * the two not at all; but the other's pose is held, so the rest is known. */
    survey_make(&s, 120, 60, 1);
    assert_true(survey_first(&s).picture_px > good.picture_px);

    survey_make(&s, 120, 60, OTHERS);
    for (size_t p = 3; p < POINTS; p++)
        s.obs[0][p].point = -1;
    assert_false(isfinite(survey_first(&s).picture_px));

    survey_make(&s, 120, 60, OTHERS);
    for (size_t i = 0; i <= OTHERS; i++)
        s.images[i].n_obs = 0;
    struct pose_error none = survey_first(&s);
    assert_true(none.n_points == 0 && isinf(none.picture_px));
}

/* Pictures larger than those that train may be off by as much in these. */
static void test_most(void **state)
{
    struct lens small = {.width_px = 320, .height_px = 240},
                large = {.width_px = 3000, .height_px = 4800};
    assert_true(pose_error_most_px(&small) == 2);
    assert_true(pose_error_most_px(&large) == 6);
}

int main(void)
{
    static const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rounds),
        cmocka_unit_test(test_little),
        cmocka_unit_test(test_most),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
