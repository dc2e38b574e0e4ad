/* Bare earth of the procedural city, whose own is known: it stands on hills here, and its surface
 * has noise and holes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "scene/synth/synth.h"
#include "survey/bare.h"

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
    char line[] = "synth\0-o\0x\0--extent-m\0"
                  "160\0--seed\0"
                  "7",
         *argv[8] = {0}, *at = line;
    for (size_t i = 0; i < 7; i++, at += strlen(at) + 1)
        argv[i] = at;
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

/* What a class should be, of what a ray from above meets. */
static enum bare_class meant(const struct synth_hit *hit, double above_m)
{
    if (!hit->solid)
        return BARE_GROUND;
    if (hit->solid->material == SYNTH_HOUSE || hit->solid->material == SYNTH_SHED)
        return BARE_BUILDING;
    if (hit->solid->material == SYNTH_TREE)
        return above_m < 2 ? BARE_PLANT : BARE_HIGH_PLANT;
    return BARE_OTHER;
}

/* Classes of the city's own surface and colours over the ground that the filter finds. */
static void citys_classes_are_told(void **state)
{
    static struct field f;
    struct err e = {0};
    struct synth_city c = {0};
    const struct bare_rule rule = {0};
    const struct synth_light light = synth_shade_light();
    size_t n[BARE_BUILDING + 1] = {0}, right[BARE_BUILDING + 1] = {0};
    city(&c);
    survey(&c, 5, &f);
    kit_ok(bare_filter(f.height, EDGE, EDGE, 1, &rule, &e), e);
    for (size_t i = 0; i < EDGE * EDGE; i++) {
        double x = (double)(i % EDGE) + 0.5, y = (double)(i / EDGE) + 0.5;
        const double from[3] = {x - 0.5 * EDGE, y - 0.5 * EDGE, eye_m}, down[3] = {0, 0, -1};
        struct synth_hit hit;
        float rgb[3];
        synth_trace_ray(&c, NULL, from, down, &hit);
        synth_shade_hit(&c, NULL, &light, down, &hit, 0.2, rgb);
        for (size_t k = 0; k < 3; k++)
            rgb[k] = (float)synth_shade_encode(rgb[k]) / 255;
        double z = eye_m - hit.t_m;
        enum bare_class want = meant(&hit, z),
                        got = bare_class_of((float)(z + hills(x, y)) - f.height[i], rgb);
        n[want]++;
        right[want] += got == want;
    }
    printf("classes: of %zu ground %.1f %% right, of %zu building %.1f %%, of %zu high vegetation "
           "%.1f %%\n",
           n[BARE_GROUND], 100.0 * (double)right[BARE_GROUND] / (double)n[BARE_GROUND],
           n[BARE_BUILDING], 100.0 * (double)right[BARE_BUILDING] / (double)n[BARE_BUILDING],
           n[BARE_HIGH_PLANT], 100.0 * (double)right[BARE_HIGH_PLANT] / (double)n[BARE_HIGH_PLANT]);
    assert_true(20 * right[BARE_GROUND] > 19 * n[BARE_GROUND]);
    assert_true(10 * right[BARE_BUILDING] > 9 * n[BARE_BUILDING] && n[BARE_BUILDING] > 1000);
    assert_true(10 * right[BARE_HIGH_PLANT] > 9 * n[BARE_HIGH_PLANT] && n[BARE_HIGH_PLANT] > 100);
    synth_city_free(&c);
}

/* ---- the filter alone, on shapes whose ground is known ---- */

enum { W = 90, H = 70 };
struct shape {
    const char *name;
    double (*ground)(double x, double y);
    double (*above)(double x, double y); /* what stands on it */
    bool (*known)(double x, double y);
    double most_m; /* error, at most: where ground is seen, and under what stands on it */
    double most_under_m;
};

static double flat(double x, double y)
{
    (void)x;
    (void)y;
    return 0;
}

static double slope(double x, double y)
{
    return 0.2 * x - 0.1 * y;
}

/* 12 m high, steepest rise 0.28. */
static double hill(double x, double y)
{
    double r2 = (x - 45) * (x - 45) + (y - 35) * (y - 35);
    return 12 * exp(-r2 / (2 * 26.0 * 26.0));
}

/* Walls of 1.2 m every 12 m up to a plain. */
static double terraces(double x, double y)
{
    (void)y;
    return 1.2 * floor(fmin(x, 50) / 12);
}

static bool within(double x, double y, double x0, double y0, double x1, double y1)
{
    return x >= x0 && x < x1 && y >= y0 && y < y1;
}

/* One stands free, one at the border, one in a corner of the map. */
static double houses(double x, double y)
{
    return within(x, y, 20, 10, 35, 24)   ? 6
           : within(x, y, 0, 40, 12, 52)  ? 9
           : within(x, y, 78, 60, 90, 70) ? 4
                                          : 0;
}

/* Crowns of 6 m: domes 2 to 8 m above the ground. */
static double trees(double x, double y)
{
    double u = x - 12 * floor(x / 12) - 6, v = y - 14 * floor(y / 14) - 7, r2 = u * u + v * v;
    return r2 < 9 ? 2 + 6 * sqrt(1 - r2 / 9) : 0;
}

/* A block of 50 x 40 m and 14 m high around a court of 12 x 8 m and an alley of 2 m. */
static double courts(double x, double y)
{
    return within(x, y, 20, 15, 70, 55) && !within(x, y, 40, 30, 52, 38) &&
                   !within(x, y, 30, 15, 32, 55)
               ? 14
               : 0;
}

static double nothing(double x, double y)
{
    (void)x;
    (void)y;
    return 0;
}

static bool everywhere(double x, double y)
{
    (void)x;
    (void)y;
    return true;
}

/* A disc with a hole: edges that follow no axis. */
static bool ragged(double x, double y)
{
    double r2 = (x - 45) * (x - 45) + (y - 35) * (y - 35);
    return r2 < 34 * 34 && !within(x, y, 50, 20, 60, 30);
}

static void shape_is_told(const struct shape *s)
{
    static float z[W * H];
    double off[2] = {0};
    const struct bare_rule rule = {.widest_m = 60};
    struct err e = {0};
    for (size_t i = 0; i < W * H; i++) {
        double x = (double)(i % W) + 0.5, y = (double)(i / W) + 0.5;
        z[i] = s->known(x, y)
                   ? (float)(s->ground(x, y) + s->above(x, y) + 0.02 * rng_normal(9, 1, i))
                   : NAN;
    }
    kit_ok(bare_filter(z, W, H, 1, &rule, &e), e);
    for (size_t i = 0; i < W * H; i++) {
        double x = (double)(i % W) + 0.5, y = (double)(i / W) + 0.5,
               d = fabs((double)z[i] - s->ground(x, y));
        assert_true(isfinite(z[i]));
        if (!s->known(x, y)) /* filled, by nothing in particular */
            continue;
        off[s->above(x, y) > 0] = fmax(off[s->above(x, y) > 0], d);
    }
    printf("%s: off by at most %.3f m, %.3f m under what stands on it\n", s->name, off[0], off[1]);
    assert_true(off[0] <= s->most_m && off[1] <= s->most_under_m);
}

static void shapes_are_told(void **state)
{
    static const struct shape shapes[] = {
        {"flat", flat, nothing, everywhere, 0.1, 0},
        {"slope", slope, nothing, everywhere, 0.1, 0},
        {"hill", hill, nothing, everywhere, 0.1, 0},
        {"terraces", terraces, nothing, everywhere, 0.1, 0},
        {"houses", flat, houses, everywhere, 0.1, 0.1},
        {"houses on a slope", slope, houses, everywhere, 0.1, 2},
        {"houses on a hill", hill, houses, everywhere, 0.1, 2},
        {"trees", flat, trees, everywhere, 0.1, 0.1},
        {"trees on a hill", hill, trees, everywhere, 0.1, 0.5},
        {"courts", flat, courts, everywhere, 0.1, 0.1},
        {"courts on a slope", slope, courts, everywhere, 0.1, 1},
        {"slope, edge of what is known", slope, nothing, ragged, 0.1, 0},
        {"trees on a slope, edge of what is known", slope, trees, ragged, 0.1, 1},
    };
    for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++)
        shape_is_told(&shapes[i]);
}

/* A pit stays, holes are filled as the ground around goes on, and nothing known stays nothing. What
 * is wider than the rule stays ground. */
static void rest_is_told(void **state)
{
    static float z[W * H];
    const struct bare_rule rule = {.widest_m = 60}, narrow = {.widest_m = 10};
    struct err e = {0};
    for (size_t i = 0; i < W * H; i++) {
        double x = (double)(i % W), y = (double)(i / W);
        z[i] = within(x, y, 30, 30, 40, 40) ? NAN : (float)slope(x, y);
    }
    z[5 * W + 5] -= 4;
    kit_ok(bare_filter(z, W, H, 1, &rule, &e), e);
    for (size_t i = 0; i < W * H; i++) {
        double want = slope((double)(i % W), (double)(i / W)) - (i == 5 * W + 5 ? 4 : 0);
        if (fabs((double)z[i] - want) > 0.05)
            fail_msg("cell %zu,%zu: %.3f instead of %.3f", i % W, i / W, (double)z[i], want);
    }
    for (size_t i = 0; i < W * H; i++)
        z[i] = (float)houses((double)(i % W), (double)(i / W));
    kit_ok(bare_filter(z, W, H, 1, &narrow, &e), e);
    assert_float_equal(z[17 * W + 27], 6, 0.01);
    for (size_t i = 0; i < W * H; i++)
        z[i] = NAN;
    kit_ok(bare_filter(z, W, H, 1, &rule, &e), e);
    assert_true(isnan(z[0]) && isnan(z[W * H - 1]));
}

static void classes_are_told(void **state)
{
    const float green[3] = {0.2f, 0.4f, 0.2f}, gray[3] = {0.5f, 0.5f, 0.5f}, black[3] = {0, 0, 0};
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
        cmocka_unit_test(rest_is_told),
        cmocka_unit_test(classes_are_told),
        cmocka_unit_test(citys_classes_are_told),
    };
    return cmocka_run_group_tests_name("bare", tests, NULL, NULL);
}
