/* Ground from sparse points in training: first Gaussians where there are no points, and none in
 * free space.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "scene/cells/cell.h"
#include "scene/cells/footprint.h"
#include "scene/cells/trim.h"
#include "tests/kit.h"
#include "train/base/schedule.h"
#include "train/base/stage.h"
#include "train/model/densify_plan.h"
#include "train/model/init.h"
#include "train/photographs/gallery.h"

enum { SIDE = 5, PLANES = 18 };
#define HEIGHT_M 50.0
#define GROUND_M 7.0
static const struct cell everything = {
    .id = "all", .whole = true, .edge_m = 200.0, .extent_m = 200.0, .scene_extent_m = 200.0};

/* A nadir flight over flat ground, 5 x 5 photographs 20 m apart, of 80 x 60 m each. Points every 4
 * m, green in the north and red in the south, and none east of x = 20. */
static void survey(struct scene *s)
{
    memset(s, 0, sizeof *s);
    s->n_images = SIDE * SIDE;
    s->images = arena_get(&s->arena, s->n_images, sizeof *s->images);
    s->points = arena_get(&s->arena, 51 * 51, sizeof *s->points);
    for (size_t i = 0; i < s->n_images; i++) {
        const double down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1},
                     at[3] = {20.0 * (double)(i % SIDE) - 40, 20.0 * (double)(i / SIDE) - 40,
                              GROUND_M + HEIGHT_M};
        struct camera *c = &s->images[i].cam;
        *c = (struct camera){
            .width_px = 80, .height_px = 60, .fx_px = 50, .fy_px = 50, .cx_px = 40, .cy_px = 30};
        memcpy(c->rot, down, sizeof down);
        for (int a = 0; a < 3; a++)
            c->trans[a] =
                -(down[3 * a] * at[0] + down[3 * a + 1] * at[1] + down[3 * a + 2] * at[2]);
    }
    for (size_t i = 0; i < 51 * 51; i++) {
        double x = 4.0 * (double)(i % 51) - 100, y = 4.0 * (double)(i / 51) - 100;
        if (x <= 20)
            s->points[s->n_points++] = (struct scene_point){
                .enu_m = {x, y, GROUND_M}, .rgb = {y < 0 ? 200 : 0, y < 0 ? 0 : 200, 0}};
    }
}

static bool seen(double x, double y)
{
    return fabs(x) < 80 && fabs(y) < 70; /* the union of the pictures has no holes */
}

static void ground_without_points_gets_gaussians(void **state)
{
    struct scene s;
    struct footprint f;
    struct gauss plain, g;
    struct err e = {0};
    uint32_t images[SIDE * SIDE];
    survey(&s);
    for (uint32_t i = 0; i < SIDE * SIDE; i++)
        images[i] = i;
    kit_ok(footprint_of(&s, &f, &e), e);
    struct init_input in = {.scene = &s,
                            .images = images,
                            .n_images = SIDE * SIDE,
                            .cell = &everything,
                            .limit = 10000,
                            .seed = 3};
    kit_ok(init_gauss(&in, &plain, &e), e);
    assert_int_equal(plain.n, s.n_points);
    in.ground = &f;
    in.ground_share = 1.0;
    kit_ok(init_gauss(&in, &g, &e), e);
    assert_true(g.n > plain.n);
    size_t east = 0, room = 0;
    for (size_t i = plain.n; i < g.n; i++) {
        double x = g.origin_enu_m[0] + (double)g.mean_m[3 * i],
               y = g.origin_enu_m[1] + (double)g.mean_m[3 * i + 1],
               z = g.origin_enu_m[2] + (double)g.mean_m[3 * i + 2];
        assert_true(seen(x, y) && fabs(z - GROUND_M) < 1e-3);
        east += x > 20;
        if (fabs(y) > 8) /* the nearest point's colour */
            assert_true((g.sh[3 * i] > 0) == (y < 0) && (g.sh[3 * i + 1] > 0) == (y > 0));
    }
    for (size_t i = 0; i < f.nx * f.ny; i++)
        room +=
            !f.has_points[i] && f.views[i] && f.corner_m[0] + (double)(i % f.nx) * f.cell_m > 20;
    print_message("%zu points, %zu places of ground, %zu of them in the east\n", plain.n,
                  g.n - plain.n, east);
    assert_true(east > 100 && east >= room);
    size_t all = g.n - plain.n;
    gauss_free(&g);
    in.limit = plain.n + all / 2; /* half of them, spread out */
    kit_ok(init_gauss(&in, &g, &e), e);
    assert_int_equal(g.n, in.limit);
    gauss_free(&g);
    in.limit = 10000;
    in.ground_share = 0.01;
    kit_ok(init_gauss(&in, &g, &e), e);
    assert_int_equal(g.n, plain.n + 100);
    gauss_free(&g);
    in.n_images = 1; /* only what that photograph sees: x -80 to 0, all with points */
    in.ground_share = 1.0;
    kit_ok(init_gauss(&in, &g, &e), e);
    for (size_t i = plain.n; i < g.n; i++)
        assert_true(g.origin_enu_m[0] + (double)g.mean_m[3 * i] < 0);
    gauss_free(&g);
    gauss_free(&plain);
    footprint_free(&f);
    arena_free(&s.arena);
}

/* Outside of a cell's box, ground gets as many as there is room for, to the last one. */
static void the_last_place_outside_is_used(void **state)
{
    const struct cell west = {.id = "w",
                              .min_enu_m = {-102, -102},
                              .max_enu_m = {-42, 102},
                              .edge_m = 200.0,
                              .extent_m = 200.0,
                              .scene_extent_m = 200.0};
    struct scene s;
    struct footprint f;
    struct err e = {0};
    uint32_t images[SIDE * SIDE];
    size_t beyond = 0;
    survey(&s);
    for (uint32_t i = 0; i < SIDE * SIDE; i++)
        images[i] = i;
    for (size_t i = 0; i < s.n_points; i++)
        beyond += cell_distance(&west, s.points[i].enu_m[0], s.points[i].enu_m[1]) > 0.0;
    kit_ok(footprint_of(&s, &f, &e), e);
    for (size_t room = 0; room < 5; room += 1 + room) {
        struct gauss g;
        struct init_input in = {.scene = &s,
                                .images = images,
                                .n_images = SIDE * SIDE,
                                .cell = &west,
                                .ground = &f,
                                .ground_share = 1.0,
                                .limit = 2 * (beyond + room),
                                .seed = 3};
        assert_true(in.limit > s.n_points + room);
        kit_ok(init_gauss(&in, &g, &e), e);
        size_t taken = 0;
        for (size_t i = s.n_points; i < g.n; i++)
            taken += cell_distance(&west, g.origin_enu_m[0] + (double)g.mean_m[3 * i],
                                   g.origin_enu_m[1] + (double)g.mean_m[3 * i + 1]) > 0.0;
        assert_int_equal(taken, room);
        gauss_free(&g);
    }
    footprint_free(&f);
    arena_free(&s.arena);
}

static void what_is_longer_than_pixels_on_the_ground_is_split(void **state)
{
    struct scene s;
    struct footprint f;
    struct err e = {0};
    uint32_t first = 0;
    survey(&s);
    kit_ok(footprint_of(&s, &f, &e), e);
    struct train_config cfg = {0};
    struct gallery g = {.cfg = &cfg, .scene = &s, .images = &first, .n_images = 1};
    struct site site = {.cell = {.extent_m = 40.0}, .ground = &f};
    const struct schedule fine = {.downsample = 1.0}, coarse = {.downsample = 4.0};
    double px_m = 1.0 / f.px_per_m;
    assert_true(fabs(gallery_split_above(&g, &site, &fine) - px_m) < 1e-9 * px_m);
    /* pictures of a quarter of the size have pixels four times as large, but for rounding */
    assert_true(fabs(gallery_split_above(&g, &site, &coarse) - 4.0 * px_m) < 0.05 * px_m);
    site.ground = NULL;
    assert_true(fabs(gallery_split_above(&g, &site, &fine) - 0.4) < 1e-12);
    footprint_free(&f);
    arena_free(&s.arena);
}

static void what_floats_is_removed(void **state)
{
    /* at the ground, 4 m and 6 m above, 6 m below, 40 m up, and 40 m up where nothing is known */
    static const float mean[6][3] = {{0, 0, 7},  {10, 0, 11}, {-20, 10, 13},
                                     {0, 30, 1}, {5, 5, 47},  {9000, 0, 47}};
    static const uint32_t kept[3] = {0, 1, 5};
    enum { N = 6 };
    float params[LAYOUT_LANES * PLANES] = {0}, grad[N] = {0};
    struct scene s;
    struct footprint f;
    struct densify_plan plan;
    struct err e = {0};
    survey(&s);
    kit_ok(footprint_of(&s, &f, &e), e);
    for (size_t i = 0; i < N; i++) {
        for (uint32_t k = 0; k < 3; k++)
            params[k * LAYOUT_LANES + i] = mean[i][k] - (k == 2 ? 3.0f : 0.0f);
        params[6 * LAYOUT_LANES + i] = 1.0f;
    }
    struct densify_params p = {.cell = &everything,
                               .origin_enu_m = {0, 0, 3},
                               .cap_inside = 100,
                               .tau = 1.0,
                               .tau_outside = 4.0,
                               .split_above_m = 100.0,
                               .prune_opacity = 0.005,
                               .ground = &f,
                               .free_space_m = 5.0};
    struct densify_input in = {.params = params, .n = N, .planes = PLANES, .mean_grad = grad};
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, 3);
    for (size_t i = 0; i < plan.n; i++)
        assert_int_equal(plan.rows[i].source, kept[i]);
    densify_plan_free(&plan);
    p.ground = NULL;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, N);
    densify_plan_free(&plan);
    footprint_free(&f);
    arena_free(&s.arena);
}

/* Where the photographs end (x = 80, y = 70) what is large and sticks out is halved, gradient or
 * not, and what lies outside goes; where few look, heights are tight. */
static void what_sticks_out_is_split(void **state)
{
    /* large in the middle, at the edge, outside; small at the edge; 2 m up at the edge and not */
    static const float mean[6][3] = {{0, 0, 7},  {78, 0, 7},  {90, 0, 7},
                                     {79, 9, 7}, {76, 66, 9}, {9, 9, 9}};
    static const float sigma[6] = {3.0f, 3.0f, 0.5f, 0.5f, 0.5f, 0.5f};
    static const uint32_t rows[5] = {0, 1, 1, 3, 5};
    enum { N = 6 };
    float params[LAYOUT_LANES * PLANES] = {0}, grad[N] = {0};
    struct scene s;
    struct footprint f;
    struct trim t;
    struct densify_plan plan;
    struct err e = {0};
    survey(&s);
    kit_ok(footprint_of(&s, &f, &e), e);
    kit_ok(trim_open(&s, &f, 5, 5.0, &t, &e), e);
    for (size_t i = 0; i < N; i++) {
        for (uint32_t k = 0; k < 3; k++) {
            params[k * LAYOUT_LANES + i] = mean[i][k];
            params[(3 + k) * LAYOUT_LANES + i] = logf(k < 2 ? sigma[i] : 0.05f);
        }
        params[6 * LAYOUT_LANES + i] = 1.0f;
    }
    struct densify_params p = {.cell = &everything,
                               .cap_inside = 10,
                               .tau = 1.0,
                               .tau_outside = 4.0,
                               .split_above_m = 100.0,
                               .prune_opacity = 0.005,
                               .rim = &t,
                               .cut_above_m = 1.0};
    struct densify_input in = {.params = params, .n = N, .planes = PLANES, .mean_grad = grad};
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, 5);
    for (size_t i = 0; i < plan.n; i++) {
        assert_int_equal(plan.rows[i].source, rows[i]);
        assert_int_equal(plan.rows[i].kind, i == 1   ? DENSIFY_SPLIT_A
                                            : i == 2 ? DENSIFY_SPLIT_B
                                                     : DENSIFY_KEEP);
    }
    assert_true(plan.report.cut == 1 && plan.report.split == 1 && plan.report.pruned == 2);
    assert_true(plan.report.after == 5 && plan.report.inside == 5);
    densify_plan_free(&plan);
    p.cap_inside = 4; /* no room: it stays whole, and nothing is over the ceiling */
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_true(plan.n == 4 && !plan.report.cut);
    densify_plan_free(&plan);
    p.rim = NULL;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, N);
    densify_plan_free(&plan);
    trim_free(&t);
    footprint_free(&f);
    arena_free(&s.arena);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ground_without_points_gets_gaussians),
        cmocka_unit_test(the_last_place_outside_is_used),
        cmocka_unit_test(what_is_longer_than_pixels_on_the_ground_is_split),
        cmocka_unit_test(what_floats_is_removed),
        cmocka_unit_test(what_sticks_out_is_split),
    };
    return cmocka_run_group_tests_name("ground", tests, NULL, NULL);
}
