/* Harmonics of least size that look the same from the photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "core/splat/camera.h"
#include "core/splat/sh.h"
#include "tests/kit.h"
#include "train/model/harmonics.h"

enum { N = 40, SIDE = 5, CAMS = SIDE * SIDE, COUNT = LAYOUT_SH_MAX };
enum { PLANES = LAYOUT_PLANE_SH + 3 * COUNT };
#define HEIGHT 60.0
#define STEP 8.0 /* between photographs */
#define WEIGHT 0.03
/* Of how far the trained colours are from those without harmonics: what differs by less is nearer
 * to the one than to the other. */
#define NEARER 0.5

static const double origin[3] = {100.0, -40.0, 3.0};
static struct {
    struct camera cams[CAMS]; /* those of a flight */
    float *params, *before;   /* the same places */
} t;

static float *sh_of(float *params, size_t i, size_t k, size_t channel)
{
    return params + layout_at(i, PLANES) + (LAYOUT_PLANE_SH + 3 * k + channel) * LAYOUT_LANES;
}

/* Places on the ground under the flight, colours of every direction. */
static float *places(void)
{
    float *params = mem_array(layout_floats(N, PLANES), sizeof *params);
    assert_non_null(params);
    for (size_t i = 0; i < N; i++) {
        for (size_t a = 0; a < 2; a++)
            params[layout_at(i, PLANES) + a * LAYOUT_LANES] =
                (float)(20.0 * rng_unit(1, a, i) - 10.0);
        for (size_t k = 0; k < COUNT; k++)
            for (size_t c = 0; c < 3; c++)
                *sh_of(params, i, k, c) = (float)(rng_unit(2, 3 * k + c, i) - 0.5);
    }
    return params;
}

/* A flight that looks straight down. */
static void flight(struct camera cams[CAMS])
{
    for (size_t k = 0; k < CAMS; k++) {
        const double at[3] = {origin[0] + STEP * ((double)(k % SIDE) - 2),
                              origin[1] + STEP * ((double)(k / SIDE) - 2), origin[2] + HEIGHT};
        kit_camera_down(at, &cams[k]);
    }
}

/* All around a place, outside a sphere of N places, looking in. */
static void all_around(struct camera cams[CAMS])
{
    for (size_t k = 0; k < CAMS; k++) {
        double z = 1.0 - 2.0 * ((double)k + 0.5) / CAMS, turn = 2.4 * (double)k,
               r = 200.0 * sqrt(1.0 - z * z);
        const double eye[3] = {origin[0] + r * cos(turn), origin[1] + r * sin(turn),
                               origin[2] + 200.0 * z};
        cams[k] = camera_look_at(eye, origin, 1.0, 400, 300);
    }
}

static int setup(void **state)
{
    flight(t.cams);
    t.params = places();
    t.before = places();
    return 0;
}

static int teardown(void **state)
{
    mem_free(t.params);
    mem_free(t.before);
    return 0;
}

static void hold(float *params, double weight, uint32_t degree, const double origin_enu_m[3])
{
    struct err e = {0};
    const struct harmonics_rule rule = {t.cams, CAMS, weight, degree};
    kit_ok(harmonics_hold(&rule, params, N, PLANES, origin_enu_m, &e), e);
}

static void place_of(const float *params, size_t i, double x[3])
{
    for (size_t a = 0; a < 3; a++)
        x[a] = origin[a] + (double)params[layout_at(i, PLANES) + a * LAYOUT_LANES];
}

static void direction(const struct camera *cam, const double x[3], double dir[3])
{
    double center[3], length = 0.0;
    camera_center(cam, center);
    for (size_t a = 0; a < 3; a++) {
        dir[a] = x[a] - center[a];
        length += dir[a] * dir[a];
    }
    for (size_t a = 0; a < 3; a++)
        dir[a] /= sqrt(length);
}

static double dot(const double *y, const double *c)
{
    double sum = 0.0;
    for (size_t k = 0; k < COUNT; k++)
        sum += y[k] * c[k];
    return sum;
}

/* What is minimised, as train/model/harmonics.h has it. All photographs see all places here. */
static double objective(const struct camera *cams, const double x[3], const double *c,
                        const double *c0)
{
    double sum = 0.0;
    for (size_t k = 0; k < CAMS; k++) {
        double dir[3], y[COUNT];
        direction(&cams[k], x, dir);
        sh_basis(dir, 3, y);
        double off = dot(y, c) - dot(y, c0);
        sum += off * off;
    }
    for (size_t j = 1; j < COUNT; j++)
        sum += WEIGHT * CAMS * c[j] * c[j];
    return sum;
}

static void copy_of(float *params, size_t i, size_t channel, double *c)
{
    for (size_t k = 0; k < COUNT; k++)
        c[k] = (double)*sh_of(params, i, k, channel);
}

static void it_is_the_minimum(void **state)
{
    const double h = 1e-4;
    hold(t.params, WEIGHT, 3, origin);
    for (size_t i = 0; i < N; i++)
        for (size_t ch = 0; ch < 3; ch++) {
            double c[COUNT], c0[COUNT], x[3];
            copy_of(t.params, i, ch, c);
            copy_of(t.before, i, ch, c0);
            place_of(t.params, i, x);
            assert_true(objective(t.cams, x, c, c0) < objective(t.cams, x, c0, c0));
            for (size_t k = 0; k < COUNT; k++) {
                double was = c[k];
                c[k] = was + h;
                double up = objective(t.cams, x, c, c0);
                c[k] = was - h;
                double down = objective(t.cams, x, c, c0);
                c[k] = was;
                assert_true(fabs((up - down) / (2.0 * h)) < 1e-4); /* float32 coefficients */
            }
        }
}

/* Root mean squares: in the cone of the photographs, of the change of colours; from the horizon, of
 * what colours differ by from the base colour. Each against harmonics as trained. */
static void looks_alike_from_above_and_calm_from_the_side(void **state)
{
    double above = 0.0, above_trained = 0.0, side = 0.0, side_trained = 0.0;
    hold(t.params, WEIGHT, 3, origin);
    for (size_t i = 0; i < N; i++) {
        double c[COUNT], c0[COUNT], x[3], dir[3], y[COUNT];
        copy_of(t.params, i, 0, c);
        copy_of(t.before, i, 0, c0);
        place_of(t.params, i, x);
        for (size_t k = 0; k < CAMS; k++) {
            direction(&t.cams[k], x, dir);
            sh_basis(dir, 3, y);
            above += pow(dot(y, c) - dot(y, c0), 2.0) / (N * CAMS);
            above_trained += pow(dot(y, c0) - y[0] * c0[0], 2.0) / (N * CAMS);
        }
        for (size_t k = 0; k < CAMS; k++) {
            const double level[3] = {cos(0.25 * (double)k), sin(0.25 * (double)k), 0.0};
            sh_basis(level, 3, y);
            side += pow(dot(y, c) - y[0] * c[0], 2.0) / (N * CAMS);
            side_trained += pow(dot(y, c0) - y[0] * c0[0], 2.0) / (N * CAMS);
        }
    }
    print_message("change of colours from above: %.4f, without harmonics %.3f; harmonics from the "
                  "side: %.3f, before %.3f\n",
                  sqrt(above), sqrt(above_trained), sqrt(side), sqrt(side_trained));
    assert_true(sqrt(above) < NEARER * sqrt(above_trained));
    assert_true(sqrt(side) < NEARER * sqrt(side_trained));
}

static void what_was_seen_from_all_around_stays(void **state)
{
    all_around(t.cams);
    hold(t.params, 1e-7, 3, origin);
    for (size_t i = 0; i < layout_floats(N, PLANES); i++)
        assert_true(fabsf(t.params[i] - t.before[i]) < 1e-4f);
}

static void what_nobody_saw_has_its_base_colour(void **state)
{
    const double away[3] = {origin[0] + 500.0, origin[1], origin[2]};
    hold(t.params, WEIGHT, 3, away);
    for (size_t i = 0; i < N; i++)
        for (size_t c = 0; c < 3; c++) {
            assert_true(*sh_of(t.params, i, 0, c) == *sh_of(t.before, i, 0, c));
            for (size_t k = 1; k < COUNT; k++)
                assert_true(*sh_of(t.params, i, k, c) == 0.0f);
        }
}

/* Only what is in use is touched, only colours, and the same twice. */
static void the_rest_stays(void **state)
{
    float *again = places();
    hold(t.params, WEIGHT, 1, origin);
    hold(again, WEIGHT, 1, origin);
    assert_memory_equal(t.params, again, layout_floats(N, PLANES) * sizeof *again);
    for (size_t i = 0; i < N; i++)
        for (size_t p = 0; p < PLANES; p++) {
            size_t at = layout_at(i, PLANES) + p * LAYOUT_LANES;
            bool used = p >= LAYOUT_PLANE_SH && p < LAYOUT_PLANE_SH + 12;
            assert_true(used ? t.params[at] != t.before[at] : t.params[at] == t.before[at]);
        }
    mem_free(again);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(it_is_the_minimum, setup, teardown),
        cmocka_unit_test_setup_teardown(looks_alike_from_above_and_calm_from_the_side, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(what_was_seen_from_all_around_stays, setup, teardown),
        cmocka_unit_test_setup_teardown(what_nobody_saw_has_its_base_colour, setup, teardown),
        cmocka_unit_test_setup_teardown(the_rest_stays, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
