/* Which differences are changes, on height fields whose truth is known: blocks and heaps of a known
 * volume, and two noisy copies of one surface.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "survey/changed.h"

enum { EDGE_PX = 384, PIXELS = EDGE_PX * EDGE_PX, PIECE_PX = 128, BLUR_PX = 3, RUNS = 20 };
static const double pixel_m = 0.25, gauss_m = 0.7;

struct field { /* [EDGE_PX][EDGE_PX] */
    float truth[PIXELS], noise[PIXELS];
    float pair[2 * PIXELS];
    double errs; /* errors are so many times the standard deviation that is said */
};

/* Errors that are alike over BLUR_PX, of a standard deviation of 1. */
static void errors(uint64_t seed, float *out)
{
    static float white[PIXELS], rows[PIXELS];
    double norm = 2 * BLUR_PX + 1; /* of a sum of its square of independent ones */
    for (size_t i = 0; i < PIXELS; i++)
        white[i] = (float)rng_normal(seed, 1, i);
    for (int pass = 0; pass < 2; pass++)
        for (size_t i = 0; i < PIXELS; i++) {
            double sum = 0;
            for (long k = -BLUR_PX; k <= BLUR_PX; k++) {
                size_t x = (size_t)((long)(i % EDGE_PX) + k + EDGE_PX) % EDGE_PX,
                       y = (size_t)((long)(i / EDGE_PX) + k + EDGE_PX) % EDGE_PX;
                sum += pass ? (double)rows[y * EDGE_PX + i % EDGE_PX]
                            : (double)white[i / EDGE_PX * EDGE_PX + x];
            }
            (pass ? out : rows)[i] = (float)(pass ? sum / norm : sum);
        }
}

/* A block of edge_m, with walls that are drawn out over half a metre; or a cone of that radius. */
static double block(double x, double y, double edge_m, double high_m)
{
    double in = 0.5 * edge_m - fmax(fabs(x), fabs(y));
    return high_m * fmin(fmax(0.5 + in / 0.5, 0), 1);
}

static double cone(double x, double y, double radius_m, double high_m)
{
    return high_m * fmax(1 - hypot(x, y) / radius_m, 0);
}

/* Level ground on one half, rough ground of four times its noise on the other. */
static void field_make(struct field *f, double level_m,
                       double (*shape)(double, double, double, double), double size_m,
                       double high_m)
{
    for (size_t i = 0; i < PIXELS; i++) {
        double x = ((double)(i % EDGE_PX) + 0.5 - EDGE_PX / 2.0) * pixel_m,
               y = ((double)(i / EDGE_PX) + 0.5 - EDGE_PX / 2.0) * pixel_m;
        bool rough = x > 0.25 * EDGE_PX * pixel_m;
        f->noise[i] = (float)(rough ? 4 * level_m : level_m);
        f->truth[i] = shape ? (float)shape(x, y, size_m, high_m) : 0;
    }
}

/* The difference as two surfaces would show it: noise, and at walls what lod/surface/surface.h
 * says. */
static void field_draw(struct field *f, uint64_t seed)
{
    static float error[PIXELS];
    errors(seed, error);
    for (size_t i = 0; i < PIXELS; i++) {
        float low = f->truth[i], high = low;
        for (long k = -2; k <= 2; k++)
            for (long m = -2; m <= 2; m++) {
                long x = (long)(i % EDGE_PX) + k, y = (long)(i / EDGE_PX) + m;
                if (x < 0 || y < 0 || x >= EDGE_PX || y >= EDGE_PX)
                    continue;
                low = fminf(low, f->truth[y * EDGE_PX + x]);
                high = fmaxf(high, f->truth[y * EDGE_PX + x]);
            }
        double step = 0.33 * fmax((double)(high - low) - 1.5 * gauss_m, 0);
        f->pair[2 * i] = f->truth[i] + (float)f->errs * f->noise[i] * error[i];
        f->pair[2 * i + 1] = (float)hypot((double)f->noise[i], step);
    }
}

static void find(const struct field *f, const char *polygons, struct changed_report *out)
{
    struct err e = {0};
    struct crs *crs;
    struct geotiff *map;
    struct changed *c;
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, kit_tmp, "changed.tif", &e), e);
    kit_ok(crs_open(32632, &crs, &e), e);
    const struct geotiff_info info = {.crs = crs,
                                      .west_m = 500000,
                                      .north_m = 5500000,
                                      .pixel_m = pixel_m,
                                      .width = EDGE_PX,
                                      .height = EDGE_PX,
                                      .heights = "difference",
                                      .rows = true};
    const struct changed_request r = {.path = path,
                                      .polygons = polygons,
                                      .about = "made",
                                      .least_m = 0.5,
                                      .least_m2 = 4 * gauss_m * gauss_m,
                                      .sigma_m = gauss_m};
    kit_ok(changed_begin(&r, &info, &c, &e), e);
    kit_ok(geotiff_create(path, GEOTIFF_SURFACE, &info, &map, &e), e);
    for (uint32_t y = 0; y < EDGE_PX; y += PIECE_PX)
        for (uint32_t x = 0; x < EDGE_PX; x += PIECE_PX) {
            static float pair[2 * PIECE_PX * PIECE_PX], noise[PIECE_PX * PIECE_PX];
            for (size_t v = 0; v < PIECE_PX; v++) {
                size_t from = (y + v) * EDGE_PX + x;
                memcpy(pair + 2 * v * PIECE_PX, f->pair + 2 * from, 2 * PIECE_PX * sizeof *pair);
                memcpy(noise + v * PIECE_PX, f->noise + from, PIECE_PX * sizeof *noise);
            }
            kit_ok(geotiff_write(map, x, y, PIECE_PX, PIECE_PX, pair, &e), e);
            kit_ok(changed_add(c, x, y, PIECE_PX, PIECE_PX, pair, noise, &e), e);
        }
    kit_ok(changed_tell(c, map, pixel_m * pixel_m, out, &e), e);
    changed_close(&c);
    changed_close(&c); /* idempotent */
    geotiff_close(&map);
    crs_close(&crs);
}

/* ---- tests ---- */

static struct field f;

/* A block of 10 x 10 x 4 m: the volume to 5 %, and within what it says of itself in 95 % of the
 * runs. */
static void a_block_is_measured(void **state)
{
    size_t within = 0;
    double worst = 0, half = 0;
    f.errs = 1;
    field_make(&f, 0.1, block, 10, 4);
    for (uint64_t seed = 0; seed < RUNS; seed++) {
        struct changed_report r;
        field_draw(&f, seed);
        find(&f, NULL, &r);
        assert_int_equal(r.regions, 1);
        assert_true(r.lost_m3 == 0 && r.lost_95_m3 == 0);
        worst = fmax(worst, fabs(r.gained_m3 - 400));
        half = fmax(half, r.gained_95_m3);
        within += fabs(r.gained_m3 - 400) < r.gained_95_m3;
    }
    printf("changed block: of 400 m3 at most %.1f off, said +- %.1f, within in %zu of %d runs\n",
           worst, half, within, RUNS);
    assert_true(worst < 0.05 * 400);
    assert_true(within >= RUNS - 2);
    assert_true(half < 0.3 * 400);
}

/* Two noisy copies of one surface. On rough ground errors are even twice what is said. */
static void noise_is_no_change(void **state)
{
    struct changed_report r;
    field_make(&f, 0.12, NULL, 0, 0);
    for (int times = 1; times <= 2; times++) {
        size_t raw = 0;
        f.errs = times;
        field_draw(&f, 7);
        find(&f, NULL, &r);
        for (size_t i = 0; i < PIXELS; i++)
            raw += fabsf(f.pair[2 * i]) > 0.5f;
        printf("changed noise x %d: %.4f %% called changed, %.2f %% differ by 0.5 m; alike over "
               "%.2f m\n",
               times, 100 * (double)r.pixels / PIXELS, 100 * (double)raw / PIXELS, r.correlation_m);
        assert_true((double)raw > 0.05 * PIXELS); /* or there was nothing to leave out */
        assert_true((double)r.pixels <= 0.005 * PIXELS);
    }
    /* A square of 2 BLUR_PX + 1 pixels of weights that fall linearly: its own area, as a circle. */
    assert_true(fabs(r.correlation_m / ((2 * BLUR_PX + 1) * pixel_m / sqrt(3.14159)) - 1) < 0.2);
}

/* What covers all of a neighbourhood does not become its noise; a heap without walls counts. */
static void large_changes_are_not_hidden(void **state)
{
    struct changed_report r;
    f.errs = 1;
    field_make(&f, 0.1, block, 40, 2);
    field_draw(&f, 3);
    find(&f, NULL, &r);
    assert_true(fabs(r.gained_m3 - 3200) < 0.05 * 3200);
    field_make(&f, 0.1, cone, 15, -3);
    field_draw(&f, 3);
    find(&f, NULL, &r);
    /* What is deeper than least_m, up to 12.5 m from the middle: 6 pi (r^2 / 2 - r^3 / 45). */
    double want = 6 * 3.14159265 * (12.5 * 12.5 / 2 - 12.5 * 12.5 * 12.5 / 45);
    printf("changed pit: lost %.1f +- %.1f of %.1f m3\n", r.lost_m3, r.lost_95_m3, want);
    assert_true(r.regions == 1 && r.gained_m3 == 0);
    assert_true(fabs(r.lost_m3 - want) < 0.05 * want);
}

/* Where few photographs look, a surface errs by three standard deviations now and then: a bump of
 * that height is none, a house is one. */
static void doubtful_ground_needs_more(void **state)
{
    struct changed_report r;
    f.errs = 0.3;
    field_make(&f, 0.5, cone, 6, 5); /* 3.7 standard deviations, those around among them */
    field_draw(&f, 3);
    find(&f, NULL, &r);
    assert_int_equal(r.regions, 0);
    field_make(&f, 0.5, block, 6, 7);
    field_draw(&f, 3);
    find(&f, NULL, &r);
    printf("changed on doubtful ground: %.1f +- %.1f of 252 m3\n", r.gained_m3, r.gained_95_m3);
    assert_int_equal(r.regions, 1);
    assert_true(fabs(r.gained_m3 - 252) < r.gained_95_m3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_block_is_measured),
        cmocka_unit_test(noise_is_no_change),
        cmocka_unit_test(large_changes_are_not_hidden),
        cmocka_unit_test(doubtful_ground_needs_more),
    };
    return cmocka_run_group_tests_name("changed", tests, kit_tmp_make, kit_tmp_remove);
}
