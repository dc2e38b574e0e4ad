/* The background in training: another colour at every step where ground is supported.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/options/options.h"
#include "core/splat/camera.h"
#include "render/render.h"
#include "scene/cells/footprint.h"
#include "tests/kit.h"
#include "train/base/config.h"
#include "train/base/stage.h"
#include "train/photographs/background.h"
#include "train/photographs/photo_loader.h"

/* Flat ground of 60 x 40 m with its corner in the origin, seen by three photographs up to x = 50
 * and by two behind; all of it is inside of the footprint. Flown 20 m above: 4 m of the border are
 * not deep enough. */
enum { NX = 60, NY = 40, THREE_SEE = 50, FLIGHT_M = 20 };
static const double DEEP_M = 0.2 * FLIGHT_M;

struct fixture {
    struct footprint ground;
    struct train_config cfg;
    struct arena arena;
    const struct footprint *known; /* the ground, or NULL */
    struct stage stage;
    struct background background;
};

static double least(double a, double b)
{
    return a < b ? a : b;
}

static double border_m(double x, double y)
{
    return least(least(x, NX - x), least(y, NY - y));
}

static int setup(void **state)
{
    static struct fixture f;
    struct err e = {0};
    f = (struct fixture){.ground = {.cell_m = 1.0, .nx = NX, .ny = NY, .height_m = FLIGHT_M}};
    struct footprint *g = &f.ground;
    g->inside = mem_array(NX * NY, 1);
    g->edge_m = mem_array(NX * NY, sizeof *g->edge_m);
    g->ground_m = mem_array(NX * NY, sizeof *g->ground_m);
    g->views = mem_array(NX * NY, sizeof *g->views);
    assert_true(g->inside && g->edge_m && g->ground_m && g->views);
    for (size_t i = 0; i < NX * NY; i++) {
        g->inside[i] = 1;
        g->edge_m[i] = -(float)border_m((double)(i % NX) + 0.5, (double)(i / NX) + 0.5);
        g->views[i] = i % NX < THREE_SEE ? 3 : 2;
    }
    kit_ok(options_defaults(train_options(), &f.cfg, &f.arena, &e), e);
    f.known = g;
    f.stage.n_levels = 1;
    *state = &f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    footprint_free(&f->ground);
    background_free(&f->background);
    arena_free(&f->arena);
    return 0;
}

/* From 20 m above the middle, 10 px a metre: 86 x 50 m in pictures whose sides are no multiple of a
 * block. */
static struct camera from_above(void)
{
    const double eye[3] = {NX / 2, NY / 2, FLIGHT_M};
    struct camera c = camera_heading(eye, 0.0, -90.0, 1.0, 861, 501);
    c.fx_px = c.fy_px = 10.0 * FLIGHT_M;
    return c;
}

static bool is_dark(uint32_t row)
{
    return row / 8 % 2 != 0;
}

/* Rows of the photograph are bright and dark in turn, 8 of each. */
static struct render_options chosen(struct fixture *f, uint32_t step, const struct camera *cam)
{
    static uint8_t px[861 * 501 * 3];
    struct err e = {0};
    struct photo p = {.cam = *cam, .px = px};
    for (size_t i = 0; i < sizeof px; i++)
        px[i] = is_dark((uint32_t)(i / 3 / cam->width_px)) ? 39 : i % 3 ? 20 : 40;
    struct render_options ro = {.background = {0.5f, 0.5f, 0.5f}};
    f->stage.step = step;
    const uint8_t *supported;
    kit_ok(background_support(&f->background, f->known, &p, &supported, &e), e);
    background_choose(&f->background, &f->cfg, supported, &f->stage, &p, &ro);
    return ro;
}

static void check_where(struct fixture *f, bool dark_alone)
{
    const struct camera cam = from_above();
    const struct render_options ro = chosen(f, 7, &cam);
    size_t n = 0, wrong = 0, unsure = 0;
    assert_non_null(ro.background_where);
    for (uint32_t y = 0; y < cam.height_px; y++)
        for (uint32_t x = 0; x < cam.width_px; x++) {
            double east = NX / 2 + ((double)x + 0.5 - cam.cx_px) / 10.0,
                   north = NY / 2 - ((double)y + 0.5 - cam.cy_px) / 10.0;
            bool want =
                border_m(east, north) >= DEEP_M && east < THREE_SEE && (is_dark(y) || !dark_alone);
            /* a cell and a block of pixels */
            double border = least(fabs(border_m(east, north) - DEEP_M), fabs(east - THREE_SEE));
            bool got = ro.background_where[(size_t)y * cam.width_px + x] != 0;
            n += got;
            unsure += border < 2.0;
            wrong += border >= 2.0 && got != want;
        }
    assert_int_equal(wrong, 0);
    assert_true(n > (dark_alone ? 50000 : 100000) && unsure < 100000);
    for (int c = 0; c < 3; c++) {
        assert_true(ro.background[c] == 0.5f); /* elsewhere it stays */
        assert_true(ro.background_there[c] >= 0.0f && ro.background_there[c] < 1.0f);
    }
}

static void another_colour_behind_supported_ground(void **state)
{
    struct fixture *f = *state;
    f->cfg.background_random = 2;
    check_where(f, false);
}

static void behind_dark_pixels_alone(void **state)
{
    check_where(*state, true);
}

static void nothing_is_behind_the_sky(void **state)
{
    struct fixture *f = *state;
    const double eye[3] = {NX / 2, NY / 2, FLIGHT_M};
    const struct camera cam = camera_heading(eye, 0.0, 60.0, 0.5, 64, 48);
    const struct render_options ro = chosen(f, 1, &cam);
    for (size_t i = 0; i < 64 * 48; i++)
        assert_int_equal(ro.background_where[i], 0);
}

static void colours_are_of_seed_and_step(void **state)
{
    struct fixture *f = *state;
    const struct camera cam = from_above();
    const struct render_options one = chosen(f, 1, &cam), again = chosen(f, 1, &cam),
                                two = chosen(f, 2, &cam);
    assert_memory_equal(one.background_there, again.background_there, sizeof one.background_there);
    assert_true(memcmp(one.background_there, two.background_there, sizeof one.background_there));
    f->cfg.seed++;
    const struct render_options other = chosen(f, 1, &cam);
    assert_true(memcmp(one.background_there, other.background_there, sizeof one.background_there));
}

static void behind_all_and_behind_none(void **state)
{
    struct fixture *f = *state;
    const struct camera cam = from_above();
    f->cfg.background_random = 0;
    struct render_options ro = chosen(f, 1, &cam);
    assert_true(!ro.background_where && ro.background[0] == 0.5f);
    f->cfg.background_random = 3;
    ro = chosen(f, 1, &cam);
    assert_true(!ro.background_where && ro.background[0] != ro.background[1]);
    f->cfg.background_random = 1;
    f->known = NULL; /* no ground is known */
    ro = chosen(f, 1, &cam);
    assert_true(!ro.background_where && ro.background[0] == 0.5f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(another_colour_behind_supported_ground, setup, teardown),
        cmocka_unit_test_setup_teardown(behind_dark_pixels_alone, setup, teardown),
        cmocka_unit_test_setup_teardown(nothing_is_behind_the_sky, setup, teardown),
        cmocka_unit_test_setup_teardown(colours_are_of_seed_and_step, setup, teardown),
        cmocka_unit_test_setup_teardown(behind_all_and_behind_none, setup, teardown)};
    return cmocka_run_group_tests_name("training_background", tests, NULL, NULL);
}
