/* Properties of pictures of any scene: tiles change nothing, two runs give the same bits, distance
 * from the origin does not matter, backgrounds add up, buffers grow.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/draw_kit.h"

#include <math.h>

#include "render/frame.h"

/* Exact tiles and block masks only skip what draws nothing: the same bits as with bounding boxes
 * and no masks, for fewer intersections. */
static void test_culling_changes_nothing(void **state)
{
    struct gauss g;
    kit_gauss(91, 1500, 4.0, 1, 0, &g);
    for (size_t i = 0; i < g.n; i++)
        g.scale_log[3 * i + i % 3] += 2.0f; /* needles and discs, where boxes are wasteful */
    const double eyes[3][3] = {{9, 7, 5}, {-1, 2, 8}, {0.5, 0.2, 0.1}};
    for (int k = 0; k < 3; k++) {
        struct camera cam = view_from(eyes[k][0], eyes[k][1], eyes[k][2], 250, 187);
        struct picture exact = draw(&g, &cam, &PLAIN);
        uint64_t intersections = render_last_stats(render)->intersections;
        render->box_tiles = true;
        struct picture boxes = draw(&g, &cam, &PLAIN);
        render->box_tiles = false;
        assert_true(intersections < render_last_stats(render)->intersections);
        expect_same_bits("tile culling", &exact, &boxes);
        picture_free(&exact);
        picture_free(&boxes);
    }
    gauss_free(&g);
}

static bool mean_in_picture(const struct gauss *g, size_t i, const struct camera *cam)
{
    double at[3];
    for (int k = 0; k < 3; k++) {
        at[k] = cam->trans[k];
        for (int c = 0; c < 3; c++)
            at[k] +=
                cam->rot[3 * k + c] * ((double)g->mean_m[3 * i + (size_t)c] + g->origin_enu_m[c]);
    }
    double x = cam->fx_px * at[0] / at[2] + cam->cx_px, y = cam->fy_px * at[1] / at[2] + cam->cy_px;
    return at[2] > 0 && x > 0 && y > 0 && x < cam->width_px && y < cam->height_px;
}

/* A group of 16 whose means all lie outside is culled by a bound; beside one that lies inside each
 * Gaussian is looked at. Which Gaussians share a group must change nothing. */
static void test_groups_outside(void **state)
{
    const struct camera cam = view_from(3.2, -2.1, 1.6, 90, 60);
    for (unsigned round = 0; round < 6; round++) {
        struct gauss g, outside, apart;
        struct render_options o = PLAIN;
        struct err e = {0};
        struct picture mixed, grouped, rim;
        o.aa = (enum render_aa)(round % 3);
        kit_gauss(700 + round, 1600, 4.0, 1, 0, &g);
        for (size_t i = 0; i < 3 * g.n; i++)
            g.scale_log[i] += round < 3 ? 1.0f : -1.0f;
        kit_ok(gauss_alloc(&apart, g.n, g.sh_degree, 0, &e), e);
        kit_ok(gauss_alloc(&outside, g.n, g.sh_degree, 0, &e), e);
        for (int in = 0; in < 2; in++)
            for (size_t i = 0; i < g.n; i++)
                if (mean_in_picture(&g, i, &cam) == in)
                    gauss_copy_row(&apart, apart.n++, &g, i);
        for (size_t i = 0; i < apart.n && !mean_in_picture(&apart, i, &cam); i++)
            gauss_copy_row(&outside, outside.n++, &apart, i);
        mixed = draw(&g, &cam, &o);
        const uint32_t visible = render_last_stats(render)->visible;
        grouped = draw(&apart, &cam, &o);
        assert_int_equal(render_last_stats(render)->visible, visible);
        expect_same_bits("groups outside", &mixed, &grouped);
        rim = draw(&outside, &cam, &o);
        assert_true(render_last_stats(render)->visible > 0);
        assert_true(render_last_stats(render)->visible < outside.n);
        picture_free(&mixed);
        picture_free(&grouped);
        picture_free(&rim);
        gauss_free(&g);
        gauss_free(&outside);
        gauss_free(&apart);
    }
}

/* Lists without slots and hits draw the same bits; nothing that needs those may follow. */
static void test_picture_alone(void **state)
{
    struct gauss g;
    struct render_model m;
    struct render_options alone = PLAIN;
    struct err e = {0};
    kit_gauss(103, 3000, 4.0, 1, 0, &g);
    for (size_t i = 0; i < g.n; i += 50)
        g.scale_log[3 * i] += 3.0f; /* rows of more tiles than are written at once */
    struct camera cam = view_from(8, -5, 5, 330, 170);
    alone.picture = true;
    struct picture full = draw(&g, &cam, &PLAIN), picture = draw(&g, &cam, &alone);
    expect_same_bits("the picture alone", &full, &picture);
    picture_free(&full);
    picture_free(&picture);
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, &alone, NULL, NULL, &e), e);
    kit_fails(render_backward(render, &m, m.params, &e), ERR_ARG, e, "only a picture");
    render_model_free(&m);
    gauss_free(&g);
}

static void test_repeatable(void **state)
{
    struct gauss g;
    struct camera cam = view_from(8, -5, 5, 130, 70);
    kit_gauss(101, 5000, 4.0, 3, 0, &g);
    struct picture a = draw(&g, &cam, &PLAIN), b = draw(&g, &cam, &PLAIN);
    expect_same_bits("two runs", &a, &b);
    picture_free(&a);
    picture_free(&b);
    gauss_free(&g);
}

/* F20: the origin carries large coordinates, floats never see them. */
static void test_far_from_origin(void **state)
{
    struct gauss g;
    struct camera cam = view_from(8, -5, 5, 64, 48);
    kit_gauss(111, 300, 4.0, 2, 0, &g);
    struct picture near = draw(&g, &cam, &PLAIN);
    const double far[3] = {1e6, -1e6, 500};
    for (int i = 0; i < 3; i++) {
        g.origin_enu_m[i] += far[i];
        for (int k = 0; k < 3; k++)
            cam.trans[i] -= cam.rot[3 * i + k] * far[k];
    }
    struct picture moved = draw(&g, &cam, &PLAIN);
    float worst = 0.0f;
    for (size_t i = 0; i < 3 * near.pixels; i++)
        worst = fmaxf(worst, fabsf(near.rgb[i] - moved.rgb[i]));
    kit_figure("F20", "moved_m=1e6 max_difference=%.6f limit=%.6f", (double)worst, 1.0 / 255);
    for (size_t i = 0; i < 3 * near.pixels; i++)
        /* 1e6 m in double is good to 1e-10 m: far below a pixel, so only rounding at cut-offs is
         * left */
        assert_true(fabsf(near.rgb[i] - moved.rgb[i]) <= 1.0f / 255);
    check("far from origin", &g, &cam, &PLAIN);
    picture_free(&near);
    picture_free(&moved);
    gauss_free(&g);
}

/* The whole chain is linear in colour: with T_final known, background enters as T * background. */
static void test_background(void **state)
{
    struct gauss g;
    struct camera cam = view_from(8, -5, 5, 70, 40);
    struct render_options o = PLAIN;
    kit_gauss(121, 200, 4.0, 0, 0, &g);
    struct picture black = draw(&g, &cam, &o);
    for (int c = 0; c < 3; c++)
        o.background[c] = 0.3f * (float)(c + 1);
    struct picture lit = draw(&g, &cam, &o);
    for (size_t i = 0; i < 3 * black.pixels; i++)
        assert_true(fabsf(black.rgb[i] + black.t[i / 3] * o.background[i % 3] - lit.rgb[i]) <
                    1e-6f);
    uint8_t where[70 * 40]; /* every third pixel has the other one behind it */
    assert_int_equal(black.pixels, sizeof where);
    for (size_t i = 0; i < sizeof where; i++)
        where[i] = i % 3 == 0;
    o.background_where = where;
    o.background_there[1] = 1.0f;
    struct picture two = draw(&g, &cam, &o);
    for (size_t i = 0; i < 3 * black.pixels; i++)
        assert_true(where[i / 3]
                        ? fabsf(black.rgb[i] + black.t[i / 3] * (i % 3 == 1) - two.rgb[i]) < 1e-6f
                        : two.rgb[i] == lit.rgb[i]);
    picture_free(&two);
    picture_free(&black);
    picture_free(&lit);
    gauss_free(&g);
}

/* What is left of opacities by a map from above, as the reference has it; outside of the map its
 * border counts. Of ones it changes nothing. */
static void test_edge(void **state)
{
    struct gauss g;
    struct camera cam = view_from(8, -5, 5, 70, 40);
    struct render_options o = PLAIN;
    struct render_edge edge = {.middle_enu_m = {0.3, -0.2}, .side_m = 5};
    (void)state;
    kit_gauss(121, 200, 4.0, 1, 0, &g);
    o.picture = true;
    struct picture whole = draw(&g, &cam, &o);
    o.edge = &edge;
    for (int y = 0; y < LAYOUT_EDGE; y++)
        for (int x = 0; x < LAYOUT_EDGE; x++)
            edge.left[y][x] = 1;
    struct picture ones = draw(&g, &cam, &o);
    expect_same_bits("an edge of ones", &ones, &whole);
    for (int y = 0; y < LAYOUT_EDGE; y++) /* other along east than along north */
        for (int x = 0; x < LAYOUT_EDGE; x++)
            edge.left[y][x] = fminf(1, (float)(x * (y + 20)) / (LAYOUT_EDGE * LAYOUT_EDGE));
    struct picture faded = draw(&g, &cam, &o);
    double apart = 0;
    for (size_t i = 0; i < faded.pixels; i++)
        apart = fmax(apart, (double)(faded.t[i] - whole.t[i]));
    assert_true(apart > 0.2);
    check("an edge", &g, &cam, &o);
    o.picture = false;
    struct err e = {0};
    struct render_model m;
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e, "edge");
    render_model_free(&m);
    picture_free(&whole);
    picture_free(&ones);
    picture_free(&faded);
    gauss_free(&g);
}

/* Buffers grow when a frame needs more than the last, whatever the order of frames. */
static void test_growth(void **state)
{
    struct gauss small, large;
    struct err e = {0};
    struct render *fresh = NULL;
    struct camera cam = view_from(6, -5, 5, 40, 30), wide = view_from(6, -5, 5, 300, 200);
    kit_gauss(131, 10, 3.0, 0, 0, &small);
    kit_gauss(132, 3000, 3.0, 1, 0, &large);
    kit_ok(render_open(&dev, &fresh, &e), e);
    struct picture a = draw_with(fresh, &small, &cam, &PLAIN), b = draw(&small, &cam, &PLAIN);
    expect_same_bits("first frame", &a, &b);
    size_t room = fresh->intersection_splat.cap_bytes;
    struct picture c = draw_with(fresh, &large, &wide, &PLAIN), d = draw(&large, &wide, &PLAIN);
    expect_same_bits("grown", &c, &d);
    assert_true(fresh->intersection_splat.cap_bytes > room);
    picture_free(&a);
    a = draw_with(fresh, &small, &cam, &PLAIN);
    expect_same_bits("small again", &a, &b);
    render_close(&fresh);
    picture_free(&a);
    picture_free(&b);
    picture_free(&c);
    picture_free(&d);
    gauss_free(&small);
    gauss_free(&large);
}

static void test_stats(void **state)
{
    struct gauss g;
    struct camera cam = view_from(8, -5, 5, 130, 70);
    kit_gauss(201, 500, 4.0, 0, 0, &g);
    render_set_timing(render, true);
    struct picture p = draw(&g, &cam, &PLAIN);
    render_set_timing(render, false);
    const struct render_stats *s = render_last_stats(render);
    assert_true(s->visible > 0 && s->visible <= g.n);
    assert_true(s->intersections >= s->visible);
    assert_true(s->ms_project > 0 && s->ms_sort > 0 && s->ms_bin > 0 && s->ms_blend > 0);
    assert_true(s->ms_total >= s->ms_project + s->ms_sort + s->ms_bin + s->ms_blend);
    picture_free(&p);
    gauss_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_culling_changes_nothing),
        cmocka_unit_test(test_groups_outside),
        cmocka_unit_test(test_picture_alone),
        cmocka_unit_test(test_repeatable),
        cmocka_unit_test(test_far_from_origin),
        cmocka_unit_test(test_background),
        cmocka_unit_test(test_edge),
        cmocka_unit_test(test_growth),
        cmocka_unit_test(test_stats),
    };
    return cmocka_run_group_tests_name("render_properties", tests, render_kit_open,
                                       render_kit_close);
}
