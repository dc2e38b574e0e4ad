/* Pictures of a moving camera: tile lists with room make the same picture, and lists of an earlier
 * picture make one that is near to its own, from a renderer and from a store. What is refused, and
 * what ends the lists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/lod/store_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/geo/geo.h"
#include "core/splat/camera.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/make/pyramid.h"
#include "render/render.h"

enum { W = 192, H = 128, VALUES = 3 * W * H };

static const struct geo_origin origin = {8.6821, 50.1109, 160};
static const struct render_options draw = {
    .aa = RENDER_AA_2D, .background = {0.1f, 0.2f, 0.3f}, .sh_degree = -1, .picture = true};

struct fixture {
    struct store_fixture store;
    struct gauss g;
};

static int setup(void **state)
{
    static struct fixture f;
    store_fixture_make(&f.store);
    kit_gauss(1, 6000, 120, 1, 4, &f.g);
    for (size_t i = 0; i < f.g.n; i++) {
        f.g.mean_m[3 * i + 2] *= 0.1f;
        for (size_t k = 0; k < 3; k++)
            f.g.scale_log[3 * i + k] += i % 40 ? 0.5f : 2.0f;
    }
    const struct pyramid_config cfg = {.tile_edge_m = 60, .name = "moving"};
    store_fixture_level(f.store.path, &origin, &f.g, &cfg, NULL);
    store_fixture_draw(&f.store);
    *state = &f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    gauss_free(&f->g);
    store_fixture_drop(&f->store);
    return 0;
}

static double psnr(const float *a, const float *b)
{
    double sum = 1e-12;
    for (size_t i = 0; i < VALUES; i++) {
        double d = (double)a[i] - (double)b[i];
        sum += d * d;
    }
    return -10.0 * log10(sum / VALUES);
}

static struct camera camera_at(double east_m, double heading_deg)
{
    const double eye[3] = {east_m, -150, 60};
    return camera_heading(eye, heading_deg, -20, 0.9, W, H);
}

static struct camera camera_up(void) /* sees nothing */
{
    const double eye[3] = {0, -150, 100};
    return camera_heading(eye, 10, 80, 0.3, W, H);
}

static void check_lists(struct fixture *f, struct render *r)
{
    struct err e = {0};
    static float own[VALUES], beside_own[VALUES], got[VALUES], left[W * H];
    struct render_options room = draw, again = draw;
    room.list_room_px = again.list_room_px = 4;
    again.list_again = true;
    const struct camera cam = camera_at(0, 10), away = camera_up();
    struct camera beside = cam;
    beside.cx_px += 3;
    beside.cy_px -= 2;

    struct render_model m;
    kit_ok(render_model_upload(r, &f->g, &m, &e), e);
    kit_ok(render_forward(r, &m, &beside, &draw, beside_own, NULL, &e), e);
    kit_ok(render_forward(r, &m, &cam, &draw, own, NULL, &e), e);
    const uint64_t intersections = render_last_stats(r)->intersections;
    kit_ok(render_forward(r, &m, &cam, &room, got, NULL, &e), e);
    assert_memory_equal(own, got, sizeof own);
    const struct render_stats roomy = *render_last_stats(r);
    assert_true(roomy.intersections > intersections);

    for (int i = 0; i < 2; i++) { /* also lists that were used before */
        kit_ok(render_forward(r, &m, &cam, &again, got, NULL, &e), e);
        assert_memory_equal(own, got, sizeof own);
        assert_int_equal(render_last_stats(r)->visible, roomy.visible);
        kit_ok(render_forward(r, &m, &beside, &again, got, NULL, &e), e);
        const double db = psnr(beside_own, got);
        print_message("3 and 2 px beside: %.1f dB\n", db);
        assert_true(db > 83);
        /* what was seen is not any more: nothing of it stays */
        kit_ok(render_forward(r, &m, &away, &again, got, left, &e), e);
        for (size_t k = 0; k < W * H; k++)
            assert_true(left[k] == 1.0f);
    }
    /* Without room things are missing. */
    kit_ok(render_forward(r, &m, &cam, &draw, got, NULL, &e), e);
    again.list_room_px = 0;
    kit_ok(render_forward(r, &m, &beside, &again, got, NULL, &e), e);
    const double db = psnr(beside_own, got);
    print_message("without room: %.1f dB\n", db);
    assert_true(db < 80);
    render_model_free(&m);
}

static void lists_again(void **state)
{
    struct fixture *f = *state;
    check_lists(f, f->store.render);
}

static void also_as_on_a_gpu(void **state)
{
    struct fixture *f = *state;
    struct dev *dev = &f->store.dev;
    const uint32_t own = dev->vector_width;
    struct render *r;
    struct err e = {0};
    dev->vector_width = 1;
    kit_ok(render_open(dev, &r, &e), e);
    check_lists(f, r);
    render_close(&r);
    dev->vector_width = own;
}

static void what_is_refused(void **state)
{
    struct fixture *f = *state;
    struct render *r = f->store.render;
    struct err e = {0};
    double depth_m;
    const struct camera cam = camera_at(0, 10), small = camera_resize(&cam, W - 16, H);
    struct render_options again = draw, bad[4];
    again.list_again = true;
    for (int i = 0; i < 4; i++)
        bad[i] = again;
    bad[0].picture = false;
    bad[1].depth_unit_m = 100;
    bad[2].list_room_px = -1;
    bad[3].list_room_px = NAN;
    struct render_model m;
    kit_ok(render_model_upload(r, &f->g, &m, &e), e);
    for (int i = 0; i < 4; i++) {
        kit_ok(render_forward(r, &m, &cam, &draw, NULL, NULL, &e), e);
        kit_fails(render_forward(r, &m, &cam, &bad[i], NULL, NULL, &e), ERR_ARG, e, "lists");
        /* and it has left nothing to go on with */
        kit_fails(render_forward(r, &m, &cam, &again, NULL, NULL, &e), ERR_ARG, e, "lists");
    }
    kit_ok(render_forward(r, &m, &cam, &draw, NULL, NULL, &e), e);
    kit_fails(render_forward(r, &m, &small, &again, NULL, NULL, &e), ERR_ARG, e, "size");
    kit_ok(render_forward(r, &m, &cam, &draw, NULL, NULL, &e), e);
    kit_ok(render_forward(r, &m, &cam, &again, NULL, NULL, &e), e);
    kit_fails(render_depth_quantile(r, 0.5, &depth_m, &e), ERR_ARG, e, "own");
    render_model_free(&m);
}

/* About half of what has its middle in the picture is nearer than the half's depth. */
static void depths_of_shares(void **state)
{
    struct fixture *f = *state;
    struct render *r = f->store.render;
    struct err e = {0};
    double depth_m[3];
    const struct camera cam = camera_at(0, 10);
    struct render_model m;
    kit_ok(render_model_upload(r, &f->g, &m, &e), e);
    kit_ok(render_forward(r, &m, &cam, &draw, NULL, NULL, &e), e);
    for (int i = 0; i < 3; i++)
        kit_ok(render_depth_quantile(r, 0.5 * i, &depth_m[i], &e), e);
    size_t seen = 0, nearer = 0;
    for (size_t i = 0; i < f->g.n; i++) {
        double at[3], z;
        for (int k = 0; k < 3; k++)
            at[k] = (double)f->g.mean_m[3 * i + k] + f->g.origin_enu_m[k];
        if (!camera_frames(&cam, at, RENDER_NEAR_M, &z))
            continue;
        seen++;
        nearer += z < depth_m[1];
    }
    assert_true(depth_m[0] < depth_m[1] && depth_m[1] < depth_m[2]);
    assert_in_range(nearer, seen / 3, seen * 2 / 3);
    const struct camera away = camera_up();
    kit_ok(render_forward(r, &m, &away, &draw, NULL, NULL, &e), e);
    kit_ok(render_depth_quantile(r, 0.5, &depth_m[0], &e), e);
    assert_true(isinf(depth_m[0]));
    render_model_free(&m);
}

static void how_far_pixels_move(void **state)
{
    const struct camera cam = camera_at(0, 10), small = camera_resize(&cam, W - 16, H);
    struct camera b = cam;
    assert_true(camera_moved_px(&cam, &b, 10) < 1e-9);
    b.cx_px += 3;
    b.cy_px -= 4;
    assert_true(fabs(camera_moved_px(&cam, &b, 10) - 5) < 1e-9);
    b = cam; /* a metre to the side, at 20 m */
    b.trans[0] -= 1;
    assert_true(fabs(camera_moved_px(&cam, &b, 20) - cam.fx_px / 20) < 1e-9);
    b = camera_at(0, 10.1); /* turned: more at the corners than in the middle */
    double turned = camera_moved_px(&cam, &b, 1e9), middle = cam.fx_px * tan(0.1 * M_PI / 180);
    assert_true(turned > middle * cos(20 * M_PI / 180) && turned < 2 * middle);
    b = camera_at(0, 190);
    assert_true(isinf(camera_moved_px(&cam, &b, 10)));
    assert_true(isinf(camera_moved_px(&cam, &small, 10)));
}

/* A slow flight over a store: near to every picture's own, and most have lists of an earlier one.
 */
static void a_flight(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct view *v, *alone;
    static float own[VALUES], got[VALUES];
    double worst_db = 99;
    size_t n_again = 0;
    kit_ok(view_open(f->store.path, f->store.render, 0, &v, &e), e);
    for (int k = 0; k < 20; k++) {
        const struct camera cam = camera_at(0.4 * k, 10 + 0.15 * k);
        struct view_stats st = {0};
        const uint64_t before = render_frames(f->store.render);
        kit_ok(view_render_moving(v, &cam, &draw, NULL, got, &st, &e), e);
        assert_int_equal(render_frames(f->store.render), before + 1);
        assert_true(st.n_visible > 0 && st.n_tiles > 0);
        n_again += st.ms_pick == 0.0;
        /* Another renderer, or it would end the lists. */
        struct render *other;
        kit_ok(render_open(&f->store.dev, &other, &e), e);
        kit_ok(view_open(f->store.path, other, 0, &alone, &e), e);
        kit_ok(view_render(alone, &cam, &draw, NULL, own, NULL, &e), e);
        view_close(&alone);
        render_close(&other);
        worst_db = fmin(worst_db, psnr(own, got));
    }
    print_message("%zu of 20 pictures from lists of an earlier one; at least %.1f dB\n", n_again,
                  worst_db);
    assert_in_range(n_again, 8, 18);
    assert_true(worst_db > 45);
    view_close(&v);
}

/* Whatever else happens between two pictures, none is of other Gaussians than its own. */
static void what_ends_the_lists(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct view *v, *second;
    static float own[VALUES], got[VALUES];
    const struct camera cam = camera_at(0, 10), near = camera_at(0.01, 10);
    const struct pick_options coarse = {.error_px = 40};
    struct render_options more = draw, other = draw;
    struct view_stats st;
    const struct render_model *flat;
    more.supersample = 2;
    other.aa = RENDER_AA_MIP;
    kit_ok(view_open(f->store.path, f->store.render, 0, &v, &e), e);
    kit_ok(view_open(f->store.path, f->store.render, 0, &second, &e), e);
    for (int k = 0; k < 8; k++) {
        const struct render_options *ro = k == 4 ? &more : k == 5 ? &other : &draw;
        const struct pick_options *po = k == 6 ? &coarse : NULL;
        kit_ok(view_render_moving(v, &cam, &draw, NULL, got, &st, &e), e);
        if (k == 1)
            kit_ok(view_render(second, &cam, &draw, NULL, got, NULL, &e), e);
        if (k == 2)
            view_shrink(v);
        if (k == 3)
            kit_ok(view_model(v, &cam, NULL, &flat, &st, &e), e);
        if (k == 7)
            kit_ok(view_render(v, &cam, &draw, &coarse, got, NULL, &e), e);
        st.ms_pick = 0;
        kit_ok(view_render_moving(v, &near, ro, po, got, &st, &e), e);
        const bool again = st.ms_pick == 0.0;
        assert_int_equal(again, k == 0);
        if (again)
            continue;
        kit_ok(view_render(v, &near, ro, po, own, NULL, &e), e);
        assert_memory_equal(own, got, sizeof own);
    }
    view_close(&second);
    view_close(&v);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lists_again),         cmocka_unit_test(also_as_on_a_gpu),
        cmocka_unit_test(what_is_refused),     cmocka_unit_test(depths_of_shares),
        cmocka_unit_test(how_far_pixels_move), cmocka_unit_test(a_flight),
        cmocka_unit_test(what_ends_the_lists),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
