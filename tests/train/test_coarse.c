/* Cells that begin from one coarse model of the whole scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/splat/gauss.h"
#include "scene/cells/cell.h"
#include "tests/kit.h"
#include "train/model/init.h"

/* A coarse model of 40 x 40 Gaussians a metre apart, in the order of their places, and a cell of 10
 * x 10 m in its south-west corner. One photograph is taken from 50 m above (14.5, 4.5); it shows
 * 40 x 20 m, which is east -5.5 to 34.5, north -5.5 to 14.5. */
enum { SIDE = 40, CELL = 10, SEEN_EAST = 35, SEEN_NORTH = 15, EMBED = 4, LIMIT = 25 };
static const struct cell corner = {.id = "x0y0",
                                   .min_enu_m = {-0.5, -0.5},
                                   .max_enu_m = {CELL - 0.5, CELL - 0.5},
                                   .edge_m = CELL,
                                   .extent_m = CELL,
                                   .scene_extent_m = CELL};
static const double origin_m[3] = {100.0, -200.0, 3.0};

struct fixture {
    struct scene scene;
    struct gauss coarse;
    struct init_input in;
};
static const uint32_t the_photograph[] = {0};

static int setup(void **state)
{
    static struct fixture f;
    struct err e = {0};
    f = (struct fixture){0};
    f.scene.n_images = 1;
    f.scene.images = arena_get(&f.scene.arena, 1, sizeof *f.scene.images);
    const double down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1}, at[3] = {14.5, 4.5, 50};
    struct camera *c = &f.scene.images[0].cam;
    *c = (struct camera){
        .width_px = 80, .height_px = 40, .fx_px = 100, .fy_px = 100, .cx_px = 40, .cy_px = 20};
    memcpy(c->rot, down, sizeof down);
    for (int a = 0; a < 3; a++)
        c->trans[a] = -(down[3 * a] * at[0] + down[3 * a + 1] * at[1] + down[3 * a + 2] * at[2]);
    kit_ok(gauss_alloc(&f.coarse, SIDE * SIDE, 0, EMBED, &e), e);
    memcpy(f.coarse.origin_enu_m, origin_m, sizeof origin_m);
    for (size_t i = 0; i < SIDE * SIDE; i++) {
        const double x[3] = {(double)(i % SIDE), (double)(i / SIDE), 0.0};
        for (int k = 0; k < 3; k++) {
            f.coarse.mean_m[3 * i + k] = (float)(x[k] - origin_m[k]);
            f.coarse.scale_log[3 * i + k] = 0.5f - (float)k;
        }
        f.coarse.quat_wxyz[4 * i] = 1.0f;
        f.coarse.opacity_logit[i] = (float)i;
        for (size_t k = 0; k < EMBED; k++)
            f.coarse.embed[EMBED * i + k] = (float)(i + k);
    }
    f.coarse.n = SIDE * SIDE;
    f.in = (struct init_input){.scene = &f.scene,
                               .images = the_photograph,
                               .n_images = 1,
                               .cell = &corner,
                               .limit = 1000,
                               .seed = 5};
    *state = &f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    gauss_free(&f->coarse);
    scene_free(&f->scene);
    return 0;
}

/* Rows keep all that was learnt; one that no photograph shows is left out. */
static void a_cell_begins_with_what_its_photographs_show(void **state)
{
    struct fixture *f = *state;
    struct gauss g;
    struct err e = {0};
    kit_ok(init_coarse(&f->in, &f->coarse, &g, &e), e);
    size_t around = SEEN_EAST * SEEN_NORTH - CELL * CELL, counted;
    kit_ok(init_count_around(&f->coarse, &f->scene, the_photograph, NULL, 1, &corner, &counted, &e),
           e);
    assert_int_equal(counted, around);
    assert_int_equal(g.n, CELL * CELL + around);
    assert_int_equal(g.embed_len, EMBED);
    for (size_t i = 0; i < g.n; i++) {
        size_t row = (size_t)g.opacity_logit[i];
        double east = g.origin_enu_m[0] + (double)g.mean_m[3 * i];
        double north = g.origin_enu_m[1] + (double)g.mean_m[3 * i + 1];
        assert_true(fabs(east - (double)(row % SIDE)) < 1e-4);
        assert_true(fabs(north - (double)(row / SIDE)) < 1e-4);
        assert_true(east < SEEN_EAST && north < SEEN_NORTH);
        assert_int_equal(i < CELL * CELL, east < CELL - 0.5 && north < CELL - 0.5);
        assert_memory_equal(g.scale_log + 3 * i, f->coarse.scale_log + 3 * row, 12);
        assert_memory_equal(g.embed + EMBED * i, f->coarse.embed + EMBED * row, 4 * EMBED);
    }
    gauss_free(&g);
}

/* More than the first level may have: an even choice, that covers as much as all did. */
static void thinned_gaussians_cover_what_all_did(void **state)
{
    struct fixture *f = *state;
    struct gauss g, again;
    struct err e = {0};
    size_t around = SEEN_EAST * SEEN_NORTH - CELL * CELL, west = 0;
    f->in.limit = LIMIT;
    kit_ok(init_coarse(&f->in, &f->coarse, &g, &e), e);
    assert_int_equal(g.n, LIMIT + around);
    for (size_t i = 0; i < g.n; i++) {
        size_t row = (size_t)g.opacity_logit[i];
        double longer =
            i < LIMIT ? log(2.0) : 0.0; /* a quarter of them, each of four times the area */
        for (size_t k = 0; k < 3; k++)
            assert_true(fabs((double)g.scale_log[3 * i + k] - longer - 0.5 + (double)k) < 1e-6);
        west += i < LIMIT && row % SIDE < CELL / 2;
    }
    assert_in_range(west, LIMIT / 4, 3 * LIMIT / 4);
    kit_ok(init_coarse(&f->in, &f->coarse, &again, &e), e);
    assert_memory_equal(g.opacity_logit, again.opacity_logit,
                        g.n * sizeof(float)); /* the same choice */
    gauss_free(&again);
    gauss_free(&g);
    f->in.limit = 1; /* not larger than four times, however few stay */
    kit_ok(init_coarse(&f->in, &f->coarse, &g, &e), e);
    assert_true(fabs((double)g.scale_log[0] - 0.5 - log(4.0)) < 1e-6);
    gauss_free(&g);
}

/* Nothing of the model is near: the caller begins from points. */
static void a_cell_elsewhere_has_none(void **state)
{
    struct fixture *f = *state;
    struct gauss g;
    struct err e = {0};
    struct cell far = corner;
    for (int k = 0; k < 2; k++) {
        far.min_enu_m[k] += 1000.0;
        far.max_enu_m[k] += 1000.0;
    }
    f->in.cell = &far;
    f->in.n_images = 0;
    kit_ok(init_coarse(&f->in, &f->coarse, &g, &e), e);
    assert_int_equal(g.n, 0);
    gauss_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_cell_begins_with_what_its_photographs_show, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(thinned_gaussians_cover_what_all_did, setup, teardown),
        cmocka_unit_test_setup_teardown(a_cell_elsewhere_has_none, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
