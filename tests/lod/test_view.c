/* Views of a store: the same bits whatever was drawn before and for any size of the cache, one
 * assembly while the same tiles are selected, baked appearances, damage that is named, and cameras
 * given as maps give them.
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
#include "lod/store/store.h"
#include "render/render.h"

enum { W = 96, H = 64 };

static const struct geo_origin origin = {8.6821, 50.1109, 160};

static int setup(void **state)
{
    static struct store_fixture f;
    struct gauss g;
    store_fixture_make(&f);
    kit_gauss(1, 3000, 120, 1, 4, &g);
    for (size_t i = 0; i < g.n; i++) {
        g.mean_m[3 * i + 2] *= 0.1f;
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] -= 1.0f;
    }
    const struct pyramid_config cfg = {.tile_edge_m = 60, .name = "view"};
    store_fixture_level(f.path, &origin, &g, &cfg, NULL);
    gauss_free(&g);
    store_fixture_draw(&f);
    *state = &f;
    return 0;
}

static int teardown(void **state)
{
    store_fixture_drop(*state);
    return 0;
}

static const struct render_options draw = {
    .aa = RENDER_AA_2D, .background = {0.1f, 0.2f, 0.3f}, .sh_degree = -1};

static struct camera camera_at(double east_m, double height_m, double pitch_deg)
{
    const double eye[3] = {east_m, -100, height_m};
    return camera_heading(eye, 10, pitch_deg, 0.9, W, H);
}

/* VIEW_SUPERSAMPLE_AUTO: finer from far away, as it is from near; never without anti-aliasing, and
 * not where the finer picture would be too large. */
static void small_splats_are_supersampled(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v;
    static float by_itself[W * H * 3], plain[W * H * 3], fine[W * H * 3];
    struct camera near = camera_at(0, 60, -30);
    const struct camera far = camera_at(0, 4000, -88);
    struct render_options o = draw;
    struct camera wide = far;
    wide.width_px = RENDER_SIZE_MAX_PX / 2 + 1;
    wide.height_px = 1;
    near.fx_px *= 10; /* as through a tele lens */
    near.fy_px *= 10;
    float *row = mem_array(wide.width_px, 3 * sizeof *row);
    assert_non_null(row);
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    for (int i = 0; i < 2; i++) {
        const struct camera *cam = i ? &far : &near;
        o.supersample = 1;
        kit_ok(view_render(v, cam, &o, NULL, plain, NULL, &e), e);
        o.supersample = 2;
        kit_ok(view_render(v, cam, &o, NULL, fine, NULL, &e), e);
        o.supersample = VIEW_SUPERSAMPLE_AUTO;
        kit_ok(view_render(v, cam, &o, NULL, by_itself, NULL, &e), e);
        assert_true(memcmp(plain, fine, sizeof plain) != 0);
        assert_memory_equal(by_itself, i ? fine : plain, sizeof plain);
    }
    kit_ok(view_render(v, &wide, &o, NULL, row, NULL, &e), e);
    o.aa = RENDER_AA_NONE;
    kit_ok(view_render(v, &far, &o, NULL, by_itself, NULL, &e), e);
    view_close(&v);
    mem_free(row);
}

static void drawn_again_it_is_the_same(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v, *tiny;
    struct view_stats st;
    static float first[W * H * 3], again[W * H * 3], other[W * H * 3];
    struct camera a = camera_at(0, 60, -30), b = camera_at(40, 900, -80);
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    kit_ok(view_open(f->path, f->render, 1, &tiny, &e), e); /* nothing stays resident */
    kit_ok(view_render(v, &a, &draw, NULL, first, &st, &e), e);
    assert_true(st.n_tiles > 3 && st.n_gaussians > 300);
    kit_ok(view_render(v, &b, &draw, NULL, other, &st, &e), e);
    assert_true(memcmp(first, other, sizeof first) != 0);
    kit_ok(view_render(v, &a, &draw, NULL, again, &st, &e), e);
    assert_memory_equal(first, again, sizeof first);
    for (int i = 0; i < 3; i++) {
        kit_ok(view_render(tiny, &b, &draw, NULL, again, &st, &e), e);
        assert_memory_equal(other, again, sizeof again);
        kit_ok(view_render(tiny, &a, &draw, NULL, again, &st, &e), e);
        assert_memory_equal(first, again, sizeof again);
    }
    view_close(&v);
    view_close(&v);
    view_close(&tiny);
}

/* The view sees more from frame to frame, so its pages grow; what they held stays. Beside it one
 * that keeps nothing. */
static void pages_grow_and_keep_their_tiles(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v, *tiny;
    struct view_stats st;
    static float kept[W * H * 3], anew[W * H * 3];
    const struct pick_options finest = {.no_lod = true};
    size_t first = 0;
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    for (int k = 0; k < 6; k++) {
        struct camera cam = camera_heading((double[3]){-40.0 + 8 * k, 0, 300}, 0, -90, 0.9, W, H);
        cam.fx_px *= 6.0 / (1 + k); /* a tele lens that opens */
        cam.fy_px *= 6.0 / (1 + k);
        kit_ok(view_render(v, &cam, &draw, &finest, kept, &st, &e), e);
        first = k ? first : st.n_tiles;
        kit_ok(view_open(f->path, f->render, 1, &tiny, &e), e);
        kit_ok(view_render(tiny, &cam, &draw, &finest, anew, NULL, &e), e);
        assert_memory_equal(kept, anew, sizeof kept);
        view_close(&tiny);
    }
    assert_true(first > 0 && st.n_tiles > 2 * first + 2); /* more than the first room held */
    view_close(&v);
}

/* view_model has the Gaussians of the same picture, one tile behind another. */
static void a_model_of_a_view(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v;
    struct view_stats st;
    const struct render_model *m;
    static float want[W * H * 3], got[W * H * 3];
    const double heights[] = {900, 60, 900, 400};
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    for (size_t i = 0; i < sizeof heights / sizeof *heights; i++) {
        const struct camera cam = camera_at(0, heights[i], -50);
        const struct pick_options whole = {.whole_tiles = true};
        kit_ok(view_render(v, &cam, &draw, &whole, want, NULL, &e), e);
        kit_ok(view_model(v, &cam, &whole, &m, &st, &e), e);
        struct render_options o = draw;
        o.supersample = 1;
        o.picture = true;
        kit_ok(render_forward(f->render, m, &cam, &o, got, NULL, &e), e);
        assert_true(st.n_tiles > 0 && m->n >= st.n_gaussians);
        assert_memory_equal(want, got, sizeof want);
    }
    view_close(&v);
}

/* Room for the indices of all tiles; free it. */
static uint32_t *tiles_of(const struct view *v)
{
    size_t n;
    store_tiles(view_store(v), &n);
    uint32_t *tile = calloc(n, sizeof *tile);
    assert_non_null(tile);
    return tile;
}

/* Tiles are those of the other camera, the picture is this one's. */
static void tiles_of_another_camera(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v;
    struct view_stats own, far;
    static float want[W * H * 3], got[W * H * 3];
    struct camera a = camera_at(0, 60, -30), high = camera_at(0, 60, -30);
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    uint32_t *tile = tiles_of(v);
    struct view_tiles picked = {.tile = tile};
    kit_ok(view_render(v, &a, &draw, NULL, want, &own, &e), e);
    kit_ok(pick_tiles(view_store(v), &a, &(struct pick_options){0}, tile, &picked.n, &e), e);
    kit_ok(view_render_tiles(v, &picked, &a, &draw, got, &far, &e), e);
    assert_memory_equal(want, got, sizeof want);
    /* From 3 km back along its own axis the same place needs fewer tiles. */
    high.trans[2] += 3000;
    kit_ok(pick_tiles(view_store(v), &high, &(struct pick_options){0}, tile, &picked.n, &e), e);
    kit_ok(view_render_tiles(v, &picked, &a, &draw, got, &far, &e), e);
    assert_true(far.n_tiles < own.n_tiles);
    assert_true(memcmp(want, got, sizeof want) != 0);
    free(tile);
    view_close(&v);
}

static double mean_of(const float *rgb)
{
    double sum = 0.0;
    for (size_t i = 0; i < (size_t)W * H * 3; i++)
        sum += (double)rgb[i] / (W * H * 3);
    return sum;
}

/* Over black, less opacity is less light; and none of it stays behind. */
static void tiles_in_part(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v;
    static float want[W * H * 3], got[W * H * 3];
    struct camera a = camera_at(0, 60, -30);
    const struct render_options black = {.aa = RENDER_AA_2D, .sh_degree = -1};
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    uint32_t *tile = tiles_of(v);
    struct view_tiles part = {.tile = tile};
    kit_ok(pick_tiles(view_store(v), &a, &(struct pick_options){0}, tile, &part.n, &e), e);
    float *weight = calloc(part.n, sizeof *weight);
    assert_non_null(weight);
    part.weight = weight;
    kit_ok(view_render(v, &a, &black, NULL, want, NULL, &e), e);
    double more = mean_of(want);
    for (int quarters = 3; quarters > 0; quarters--) {
        float w = 0.25f * (float)quarters;
        for (size_t i = 0; i < part.n; i++)
            weight[i] = w;
        kit_ok(view_render_tiles(v, &part, &a, &black, got, NULL, &e), e);
        double less = mean_of(got);
        assert_true(less > 0.1 * (double)w * more && less < more);
        more = less;
    }
    kit_ok(view_render(v, &a, &black, NULL, got, NULL, &e), e);
    assert_memory_equal(want, got, sizeof want);
    free(weight);
    free(tile);
    view_close(&v);
}

/* Against all leaves put together by hand. */
static void without_levels_it_is_the_finest(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v;
    struct gauss all;
    struct render_model m;
    static float got[W * H * 3], want[W * H * 3];
    struct camera cam = camera_at(0, 60, -30);
    const struct pick_options o = {.no_lod = true};
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    kit_ok(view_render(v, &cam, &draw, &o, got, NULL, &e), e);
    size_t n;
    struct store *s;
    kit_ok(store_open(f->path, &s, &e), e);
    const struct store_tile *t = store_tiles(s, &n);
    kit_ok(gauss_alloc(&all, 0, 1, 4, &e), e);
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        if (t[i].level != 3)
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        kit_ok(gauss_append(&all, &g, NULL, g.n, &e), e);
        gauss_free(&g);
    }
    assert_int_equal(all.n, 3000);
    kit_ok(render_model_upload(f->render, &all, &m, &e), e);
    kit_ok(render_forward(f->render, &m, &cam, &draw, want, NULL, &e), e);
    for (size_t i = 0; i < W * H * 3;
         i++) /* other origin, other order of equal depths: roundings */
        assert_true(fabsf(got[i] - want[i]) < 2e-3f);
    render_model_free(&m);
    gauss_free(&all);
    store_close(&s);
    view_close(&v);
}

static void looking_away_shows_the_background(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct view *v;
    struct view_stats st;
    static float rgb[W * H * 3];
    struct camera cam = camera_at(0, 500, 80);
    kit_ok(view_open(f->path, f->render, 0, &v, &e), e);
    kit_ok(view_render(v, &cam, &draw, NULL, rgb, &st, &e), e);
    assert_int_equal(st.n_tiles, 0);
    for (size_t i = 0; i < W * H * 3; i++)
        assert_true(rgb[i] == draw.background[i % 3]);
    view_close(&v);
}

static void a_damaged_tile_spoils_only_the_views_that_need_it(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct view *v;
    size_t n;
    static float rgb[W * H * 3];
    kit_ok(store_open(f->path, &s, &e), e);
    const struct store_tile *t = store_tiles(s, &n);
    const struct key bad = t[n - 1].key; /* one of the finest */
    char name[64], path[FILE_PATH_MAX];
    snprintf(name, sizeof name, "tile %u/%u/%u", bad.z, bad.x, bad.y);
    store_close(&s);
    kit_ok(file_join(path, f->dir, "damaged.tiles", &e), e);
    store_fixture_damage(f->path, bad, path);
    kit_ok(view_open(path, f->render, 0, &v, &e), e);
    struct camera far = camera_at(0, 3000, -88);
    const struct pick_options all = {.no_lod = true};
    struct camera near = camera_heading((double[3]){0, 0, 1500}, 0, -90, 0.9, W, H);
    kit_fails(view_render(v, &near, &draw, &all, rgb, NULL, &e), ERR_FORMAT, e, name);
    kit_ok(view_render(v, &far, &draw, NULL, rgb, NULL, &e), e);
    kit_fails(view_render(v, &near, &draw, &all, rgb, NULL, &e), ERR_FORMAT, e, name);
    view_close(&v);
}

/* 80 km north-east of the origin, where the ground leans by 0.7 degrees: a point 500 m ahead by the
 * map is in the middle of the picture. */
static void cameras_by_heading_and_pitch(void **state)
{
    struct err e = {0};
    const double place[3][2] = {{8.6821, 50.1109}, {9.5, 50.6}, {7.9, 49.5}};
    for (size_t i = 0; i < 3; i++) {
        const struct geo_origin here = {place[i][0], place[i][1], 300};
        const struct view_pose pose = {here.lon_deg,           here.lat_deg, here.h_m,
                                       30.0 + 100 * (double)i, -20,          60};
        struct camera cam;
        double eye[3], want[3], got[3], lon, lat, h, x[3];
        kit_ok(view_camera(&origin, &pose, 800, 600, &cam, &e), e);
        camera_center(&cam, got);
        kit_ok(geo_to_enu(&origin, here.lon_deg, here.lat_deg, here.h_m, eye, &e), e);
        kit_near_d("eye", got, eye, 3, 1e-6, 0);
        double heading = pose.heading_deg * 3.14159265358979323846 / 180,
               pitch = -20 * 3.14159265358979323846 / 180;
        const double ahead[3] = {500 * sin(heading) * cos(pitch), 500 * cos(heading) * cos(pitch),
                                 500 * sin(pitch)};
        kit_ok(geo_from_enu(&here, ahead, &lon, &lat, &h, &e), e);
        kit_ok(geo_to_enu(&origin, lon, lat, h, want, &e), e);
        for (size_t r = 0; r < 3; r++)
            x[r] = cam.rot[3 * r] * want[0] + cam.rot[3 * r + 1] * want[1] +
                   cam.rot[3 * r + 2] * want[2] + cam.trans[r];
        const double middle[3] = {0, 0, 500};
        kit_near_d("point ahead", x, middle, 3, 1e-5, 0);
        assert_true(fabs(cam.fy_px - 300 / tan(30 * 3.14159265358979323846 / 180)) < 1e-9);
    }
    struct view_pose bad = {0, 0, 0, 0, -91, 60};
    struct camera cam;
    kit_fails(view_camera(&origin, &bad, 8, 6, &cam, &e), ERR_ARG, e, "pitch");
    bad = (struct view_pose){0, 0, 0, 0, 0, 0};
    kit_fails(view_camera(&origin, &bad, 8, 6, &cam, &e), ERR_ARG, e, "field of view");
    bad = (struct view_pose){0, 95, 0, 0, 0, 60};
    kit_fails(view_camera(&origin, &bad, 8, 6, &cam, &e), ERR_ARG, e, "latitude");
}

int main(void)
{
    progress_quiet(true);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(drawn_again_it_is_the_same),
        cmocka_unit_test(pages_grow_and_keep_their_tiles),
        cmocka_unit_test(a_model_of_a_view),
        cmocka_unit_test(small_splats_are_supersampled),
        cmocka_unit_test(tiles_of_another_camera),
        cmocka_unit_test(tiles_in_part),
        cmocka_unit_test(without_levels_it_is_the_finest),
        cmocka_unit_test(looking_away_shows_the_background),
        cmocka_unit_test(a_damaged_tile_spoils_only_the_views_that_need_it),
        cmocka_unit_test(cameras_by_heading_and_pitch),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
