/* Bare earth of the procedural city, whose own is known: it stands on hills here, and its surface
 * has noise and holes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base.h"
#include "survey/bare.h"
#include "synth/synth.h"

enum { EDGE = 160 /* m, and cells */, SUB = 4 /* rays along a cell */ };
static const double noise_m = 0.05, eye_m = 1000;

/* Up to 8 m high, a slope of 0.2 at most. */
static double hills(double x, double y)
{
    return 5 * sin(x / 35) + 3 * cos(y / 50);
}

struct field {
    float height[EDGE * EDGE], truth[EDGE * EDGE];
    uint8_t covered[EDGE * EDGE]; /* no ray of the cell meets ground */
};

static void survey(const struct synth_city *c, uint64_t seed, struct field *f)
{
    for (size_t i = 0; i < EDGE * EDGE; i++) {
        f->height[i] = NAN;
        f->covered[i] = 1;
        f->truth[i] = (float)hills((double)(i % EDGE) + 0.5, (double)(i / EDGE) + 0.5);
        for (size_t k = 0; k < SUB * SUB; k++) {
            double x = (double)(i % EDGE) + ((double)(k % SUB) + 0.5) / SUB,
                   y = (double)(i / EDGE) + ((double)(k / SUB) + 0.5) / SUB;
            const double from[3] = {x - 0.5 * EDGE, y - 0.5 * EDGE, eye_m}, down[3] = {0, 0, -1};
            struct synth_hit hit;
            synth_trace_ray(c, NULL, from, down, &hit);
            double z =
                eye_m - hit.t_m + hills(x, y) + noise_m * rng_normal(seed, 2, i * SUB * SUB + k);
            f->covered[i] = f->covered[i] && hit.solid;
            f->height[i] = isfinite(f->height[i]) ? fminf(f->height[i], (float)z) : (float)z;
        }
        if (rng_unit(seed, 3, i) < 0.05)
            f->height[i] = NAN;
    }
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void city(struct synth_city *c)
{
    struct synth_config cfg = {0};
    struct options_args args;
    struct arena arena = {0};
    struct err e = {0};
    char *argv[] = {"synth", "-o", "x", "--extent-m", "160", "--seed", "7", NULL};
    kit_ok(options_parse(synth_options(), 7, argv, &cfg, &args, &arena, &e), e);
    kit_ok(synth_city_make(&cfg, c, &e), e);
    arena_free(&arena);
}

/* RMSE and LE90 of bare earth against the city's, where it is seen and below what stands on it. */
static void bare_earth_is_the_citys(void **state)
{
    static struct field f;
    static double error[2][EDGE * EDGE];
    struct err e = {0};
    struct synth_city c = {0};
    size_t n[2] = {0}, raised = 0;
    double square[2] = {0};
    const struct bare_rule rule = {0};
    (void)state;
    city(&c);
    survey(&c, 5, &f);
    for (size_t i = 0; i < EDGE * EDGE; i++)
        raised += f.height[i] > f.truth[i] + 1;
    kit_ok(bare_filter(f.height, EDGE, EDGE, 1, &rule, &e), e);
    for (size_t i = 0; i < EDGE * EDGE; i++) {
        size_t k = f.covered[i];
        double d = (double)f.height[i] - (double)f.truth[i];
        assert_true(isfinite(d));
        error[k][n[k]++] = fabs(d);
        square[k] += d * d;
    }
    for (size_t k = 0; k < 2; k++) {
        qsort(error[k], n[k], sizeof error[k][0], ascending);
        printf("bare earth, %s: %zu m2, RMSE %.3f m, LE90 %.3f m, at most %.2f m\n",
               k ? "covered" : "seen", n[k], sqrt(square[k] / (double)n[k]),
               error[k][n[k] * 9 / 10], error[k][n[k] - 1]);
    }
    printf("bare earth: %zu of %d m2 stand a metre above it\n", raised, EDGE * EDGE);
    assert_true(raised > EDGE * EDGE / 10);
    /* The least of 16 rays with noise lies 1.8 of its standard deviations low, and lower on a
     * slope. */
    assert_true(sqrt(square[0] / (double)n[0]) < 0.2 && error[0][n[0] * 9 / 10] < 0.25);
    assert_true(sqrt(square[1] / (double)n[1]) < 0.4 && error[1][n[1] * 9 / 10] < 0.6);
    synth_city_free(&c);
}

/* The filter alone: a plane stays itself to the last cell, a house goes, a pit stays, what is not
 * known is filled, and nothing known stays nothing. */
static void shapes_are_told(void **state)
{
    enum { W = 53, H = 31 };
    static float z[W * H];
    const struct bare_rule rule = {.widest_m = 20};
    struct err e = {0};
    (void)state;
    for (size_t i = 0; i < W * H; i++) {
        size_t x = i % W, y = i / W;
        z[i] = (float)(0.2 * (double)x - 0.1 * (double)y);
        if (x >= 20 && x < 35 && y >= 8 && y < 22)
            z[i] += 6; /* a house */
        if (x == 5 && y == 5)
            z[i] -= 4; /* a pit */
        if (x > 45 && y > 25)
            z[i] = NAN;
    }
    kit_ok(bare_filter(z, W, H, 1, &rule, &e), e);
    for (size_t i = 0; i < W * H; i++) {
        size_t x = i % W, y = i / W;
        double want = 0.2 * (double)x - 0.1 * (double)y - (x == 5 && y == 5 ? 4 : 0);
        if (fabs((double)z[i] - want) > (x > 45 && y > 25 ? 1.5 : 0.15))
            fail_msg("cell %zu,%zu: %.3f instead of %.3f", x, y, (double)z[i], want);
    }
    for (size_t i = 0; i < W * H; i++)
        z[i] = NAN;
    kit_ok(bare_filter(z, W, H, 1, &rule, &e), e);
    assert_true(isnan(z[0]) && isnan(z[W * H - 1]));
}

static void classes_are_told(void **state)
{
    const float green[3] = {0.2f, 0.4f, 0.2f}, gray[3] = {0.5f, 0.5f, 0.5f}, black[3] = {0, 0, 0};
    (void)state;
    assert_int_equal(bare_class_of(0.1f, green), BARE_GROUND);
    assert_int_equal(bare_class_of(0.4f, green), BARE_LOW_PLANT);
    assert_int_equal(bare_class_of(1.0f, green), BARE_PLANT);
    assert_int_equal(bare_class_of(8.0f, green), BARE_HIGH_PLANT);
    assert_int_equal(bare_class_of(8.0f, gray), BARE_BUILDING);
    assert_int_equal(bare_class_of(8.0f, black), BARE_BUILDING);
    assert_int_equal(bare_class_of(1.0f, gray), BARE_OTHER);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bare_earth_is_the_citys),
        cmocka_unit_test(shapes_are_told),
        cmocka_unit_test(classes_are_told),
    };
    return cmocka_run_group_tests_name("bare", tests, NULL, NULL);
}
