/* What a photograph shows above the horizon, and above all points, is masked.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "scene/ingest/ingest_internal.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { WIDTH = 80, HEIGHT = 60 };

/* At 100 m, looks north and so many radians down, turned about the ray through its middle. */
static struct camera looking(double down, double roll)
{
    const double right[3] = {1, 0, 0}, ahead[3] = {0, cos(down), -sin(down)},
                 below[3] = {0, -sin(down), -cos(down)};
    struct camera c = {.width_px = WIDTH,
                       .height_px = HEIGHT,
                       .fx_px = 60,
                       .fy_px = 60,
                       .cx_px = 0.5 * WIDTH,
                       .cy_px = 0.5 * HEIGHT};
    for (int k = 0; k < 3; k++) {
        c.rot[k] = cos(roll) * right[k] + sin(roll) * below[k];
        c.rot[3 + k] = cos(roll) * below[k] - sin(roll) * right[k];
        c.rot[6 + k] = ahead[k];
    }
    for (int k = 0; k < 3; k++)
        c.trans[k] = -100 * c.rot[3 * k + 2];
    return c;
}

static void mark(const struct camera *c, uint8_t mask[HEIGHT][WIDTH])
{
    memset(mask, 255, sizeof(uint8_t[HEIGHT][WIDTH]));
    assert_true(ingest_sky_mark(c, 0, &mask[0][0]) > 0);
}

static void the_half_above_the_horizon_is_sky(void **state)
{
    struct camera level = looking(0, 0), turned = looking(0, 0.5 * 3.14159265358979), down;
    uint8_t mask[HEIGHT][WIDTH];
    mark(&level, mask);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            assert_int_equal(mask[y][x], y < HEIGHT / 2 ? 0 : 255);
    mark(&turned, mask);
    for (int y = 0; y < HEIGHT; y++) { /* of a picture that stands on its side: one side */
        assert_int_equal(mask[y][WIDTH / 4] + mask[y][3 * WIDTH / 4], 255);
        assert_int_equal(mask[y][0], mask[0][0]);
    }
    down = looking(0.2, 0); /* tan(0.2) of 60 px: 12.2 rows above the middle */
    mark(&down, mask);
    assert_int_equal(mask[17][0], 0);
    assert_int_equal(mask[18][0], 255);
}

static void what_stands_above_the_horizon_is_no_sky(void **state)
{
    struct scene_point points[3] = {
        {.enu_m = {0, 300, 3}}, {.enu_m = {0, 200, 120}}, {.enu_m = {50, 0, 90}}};
    struct scene s = {.points = points, .n_points = 3}, none = {0};
    struct camera level = looking(0, 0), steep = looking(0.5, 0);
    uint8_t mask[HEIGHT][WIDTH];
    assert_true(ingest_sky_looks_up(&level));
    assert_false(ingest_sky_looks_up(&steep)); /* its upper edge looks 2 degrees down */
    assert_true(fabs(ingest_sky_slope(&s, &level) - 0.1) < 1e-12); /* a tower of 120 m */
    memset(mask, 255, sizeof mask);
    assert_true(ingest_sky_mark(&level, 0.1, &mask[0][0]) > 0);
    assert_int_equal(mask[23][WIDTH / 2], 0); /* 0.1 of 60 px: 6 rows above the middle */
    assert_int_equal(mask[25][WIDTH / 2], 255);
    s.n_points = 1;
    assert_true(ingest_sky_slope(&s, &level) == 0);
    assert_true(isinf(ingest_sky_slope(&none, &level))); /* without points nothing is known */
    assert_int_equal(ingest_sky_mark(&level, HUGE_VAL, &mask[0][0]), 0);
}

/* What the photograph's own mask ignores stays ignored. */
static void a_mask_that_is_there_is_kept(void **state)
{
    struct err e = {0};
    struct scene_point ground = {0};
    const struct scene s = {.points = &ground, .n_points = 1};
    struct camera level = looking(0, 0), steep = looking(0.5, 0);
    struct image m = {0};
    bool seen;
    char dir[] = "/tmp/citysplat-sky-XXXXXX", path[64];
    assert_non_null(mkdtemp(dir));
    snprintf(path, sizeof path, "%s/a.png", dir);
    kit_ok(ingest_sky_mask(&s, &steep, path, false, &seen, &e), e);
    assert_false(seen);
    assert_false(file_exists(path));
    kit_ok(ingest_sky_mask(&s, &level, path, false, &seen, &e), e);
    assert_true(seen);
    kit_ok(mask_read(path, WIDTH, HEIGHT, &m, &e), e);
    assert_int_equal(m.px[0], 0);
    assert_int_equal(m.px[(HEIGHT - 1) * WIDTH], 255);
    memset(m.px, 255, (size_t)WIDTH * HEIGHT);
    m.px[(HEIGHT - 1) * WIDTH] = 0;
    kit_ok(image_write(path, &m, 0, NULL, &e), e);
    image_free(&m);
    kit_ok(ingest_sky_mask(&s, &level, path, true, &seen, &e), e);
    kit_ok(mask_read(path, WIDTH, HEIGHT, &m, &e), e);
    assert_int_equal(m.px[0], 0);
    assert_int_equal(m.px[(HEIGHT - 1) * WIDTH], 0);
    assert_int_equal(m.px[(HEIGHT - 1) * WIDTH + 1], 255);
    image_free(&m);
    (void)unlink(path);
    (void)rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_half_above_the_horizon_is_sky),
        cmocka_unit_test(what_stands_above_the_horizon_is_no_sky),
        cmocka_unit_test(a_mask_that_is_there_is_kept),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
