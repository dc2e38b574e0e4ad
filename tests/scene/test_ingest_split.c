/* Which photographs test: one whose ground nobody else shows leaves its place to a neighbour.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/scene.h"
#include "scene/ingest/ingest_internal.h"
#include "tests/kit.h"

#include <math.h>
#include <string.h>

enum { PHOTOS = 16 };
static const double height_m = 100, step_m = 10;

/* Looks straight down from x, and shows 100 x 75 m of the ground. */
static void look_down(struct scene_image *im, double x_m)
{
    *im = (struct scene_image){.cam = {.width_px = 400,
                                       .height_px = 300,
                                       .fx_px = 400,
                                       .fy_px = 400,
                                       .cx_px = 200,
                                       .cy_px = 150,
                                       .rot = {1, 0, 0, 0, -1, 0, 0, 0, -1},
                                       .trans = {-x_m, 0, height_m}}};
}

/* A line of photographs, the first `away` metres before the others; every eighth tests. */
static void line_make(struct scene *s, struct scene_image images[PHOTOS], double away_m)
{
    static struct scene_point points[3];
    *s = (struct scene){.images = images, .n_images = PHOTOS, .points = points, .n_points = 3};
    points[0].enu_m[2] = (double)NAN; /* what is not known is no height */
    for (size_t i = 0; i < PHOTOS; i++) {
        look_down(&images[i], i ? step_m * (double)i : -away_m);
        images[i].split = i % 8 ? SCENE_TRAIN : SCENE_TEST;
    }
}

static size_t tests_of(const struct scene *s)
{
    size_t n = 0;
    for (size_t i = 0; i < s->n_images; i++)
        n += s->images[i].split == SCENE_TEST;
    return n;
}

static void ground_that_others_show_tests(void **state)
{
    struct scene_image images[PHOTOS];
    struct scene s;
    struct err e = {0};
    line_make(&s, images, 0);
    kit_ok(ingest_split_cover(&s, &e), e);
    assert_int_equal(images[0].split, SCENE_TEST);
    assert_int_equal(images[8].split, SCENE_TEST);
    assert_int_equal(tests_of(&s), 2);
}

static void ground_that_nobody_else_shows_trains(void **state)
{
    struct scene_image images[PHOTOS];
    struct scene s;
    struct err e = {0};
    line_make(&s, images, 1000);
    kit_ok(ingest_split_cover(&s, &e), e);
    assert_int_equal(images[0].split, SCENE_TRAIN);
    assert_int_equal(images[8].split, SCENE_TEST);
    assert_int_equal(tests_of(&s), 2); /* a neighbour tests instead */
    line_make(&s, images, 1000);
    for (size_t i = 1; i < PHOTOS; i++) /* all are alone: nobody is better */
        look_down(&images[i], 1000 * (double)i);
    kit_ok(ingest_split_cover(&s, &e), e);
    assert_int_equal(images[0].split, SCENE_TEST);
    assert_int_equal(tests_of(&s), 1);
}

/* Two others have to show it, from at most twice as far away. */
static void far_photographs_do_not_count(void **state)
{
    struct scene_image images[PHOTOS];
    struct scene s;
    struct err e = {0};
    line_make(&s, images, 1000);
    for (size_t i = 1; i < PHOTOS; i++)
        if (i != 8) { /* from 5 km, all of the line and photograph 0 in the picture */
            look_down(&images[i], -500);
            images[i].cam.trans[2] = 5000;
        }
    images[8].split = SCENE_TRAIN;
    for (size_t i = 1; i < 4; i++)
        look_down(&images[i], step_m * (double)i);
    kit_ok(ingest_split_cover(&s, &e), e);
    assert_int_equal(images[0].split, SCENE_TRAIN);
    assert_int_equal(tests_of(&s), 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ground_that_others_show_tests),
        cmocka_unit_test(ground_that_nobody_else_shows_trains),
        cmocka_unit_test(far_photographs_do_not_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
