/* The forward kernels against the double-precision reference, and properties of any scene: tiles
 * change nothing, two runs give the same bits, distance from the origin does not matter, invalid
 * Gaussians are culled. It is one long file, because all of it draws with one device and compares
 * in one way.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/splat/payload.h"
#include "core/device/dev.h"
#include "core/splat/camera.h"
#include "render/frame.h"
#include "render/render_ref.h"

/* Float against double: typical pixels agree to a few rounding errors of sums of tens of terms. */
#define RMS_TOL 4e-6
/* A splat at the 1/255 cut-off may be drawn by one and not by the other: 0.004 of its colour (about
 * 1). */
#define MAX_TOL 6e-3
/* How many pixels may be off by more than rounding: those with a splat within 1e-5 of the cut-off.
 */
#define ROUNDING_TOL 5e-5
#define OUTLIERS_PER_VALUE 2e-3
/* Harmonics as halves have errors of 2^-12 of themselves. A colour is the sum of 16 of them, times
 * basis functions whose squares add up to 16 / (4 pi), and they are 0.8 and less here. */
#define HALVES_RMS_TOL 2e-4 /* 74 dB */

static struct dev dev;
static struct render *render;

static int setup(void **state)
{
    struct err e = {0};
    if (dev_open(NULL, &dev, &e) != ERR_OK || render_open(&dev, &render, &e) != ERR_OK) {
        print_error("%s\n", e.msg);
        return 1;
    }
    return 0;
}

static int teardown(void **state)
{
    render_close(&render);
    render_close(&render); /* idempotent */
    dev_close(&dev);
    return 0;
}

struct picture {
    float *rgb, *t;
    size_t pixels;
};

static void picture_free(struct picture *p)
{
    mem_free(p->rgb);
    mem_free(p->t);
    memset(p, 0, sizeof *p);
}

static struct picture draw_with(struct render *r, const struct gauss *g, const struct camera *cam,
                                const struct render_options *o)
{
    struct err e = {0};
    struct render_model m = {0};
    struct picture p = {.pixels = (size_t)cam->width_px * cam->height_px};
    p.rgb = mem_array(3 * p.pixels, sizeof *p.rgb);
    p.t = mem_array(p.pixels, sizeof *p.t);
    assert_non_null(p.rgb);
    assert_non_null(p.t);
    kit_ok(render_model_upload(r, g, &m, &e), e);
    kit_ok(render_forward(r, &m, cam, o, p.rgb, p.t, &e), e);
    render_model_free(&m);
    return p;
}

static struct picture draw(const struct gauss *g, const struct camera *cam,
                           const struct render_options *o)
{
    return draw_with(render, g, cam, o);
}

static void compare(const char *what, const float *got, const double *want, size_t n)
{
    double sum = 0, worst = 0;
    size_t at = 0, outliers = 0;
    for (size_t i = 0; i < n; i++) {
        double d = fabs((double)got[i] - want[i]);
        assert_true(isfinite(got[i]));
        if (d > worst) {
            worst = d;
            at = i;
        }
        if (d > ROUNDING_TOL)
            outliers++;
        else
            sum += d * d;
    }
    if (worst > MAX_TOL || sqrt(sum / (double)n) > RMS_TOL ||
        (double)outliers > 1 + OUTLIERS_PER_VALUE * (double)n)
        fail_msg(
            "%s: rms %.3g (limit %.3g), %zu of %zu beyond rounding, worst [%zu] got %.9g want %.9g",
            what, sqrt(sum / (double)n), RMS_TOL, outliers, n, at, (double)got[at], want[at]);
}

/* Device against reference for one view. */
static void check(const char *what, const struct gauss *g, const struct camera *cam,
                  const struct render_options *o)
{
    struct err e = {0};
    struct picture p = draw(g, cam, o);
    double *rgb = mem_array(3 * p.pixels, sizeof *rgb), *t = mem_array(p.pixels, sizeof *t);
    assert_non_null(rgb);
    assert_non_null(t);
    kit_ok(render_ref_forward(g, cam, o, rgb, t, &e), e);
    compare(what, p.rgb, rgb, 3 * p.pixels);
    compare(what, p.t, t, p.pixels);
    mem_free(rgb);
    mem_free(t);
    picture_free(&p);
}

static struct camera view_from(double x, double y, double z, uint32_t width, uint32_t height)
{
    const double eye[3] = {x, y, z}, target[3] = {0.2, -0.1, 0.1};
    return camera_look_at(eye, target, 0.9, width, height);
}

static const struct render_options PLAIN = {.aa = RENDER_AA_2D, .sh_degree = -1};

/* ---- against the reference ---- */

static void test_counts_and_sizes(void **state)
{
    static const size_t counts[] = {0, 1, 15, 16, 17, 300};
    static const uint32_t sizes[][2] = {{64, 48}, {1, 1}, {17, 33}, {50, 16}};
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
        for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
            struct gauss g;
            struct render_options o = PLAIN;
            char what[64];
            snprintf(what, sizeof what, "n %zu, %u x %u", counts[c], sizes[s][0], sizes[s][1]);
            o.background[0] = 0.25f;
            o.background[1] = 0.5f;
            o.background[2] = 1.0f;
            kit_gauss(11 + c, counts[c], 3.0, 3, 0, &g);
            struct camera cam = view_from(7, -5, 6, sizes[s][0], sizes[s][1]);
            check(what, &g, &cam, &o);
            gauss_free(&g);
        }
}

static void test_antialiasing_modes(void **state)
{
    for (int aa = RENDER_AA_NONE; aa <= RENDER_AA_MIP; aa++) {
        struct gauss g;
        struct render_options o = PLAIN;
        char what[32];
        snprintf(what, sizeof what, "aa %d", aa);
        o.aa = (enum render_aa)aa;
        kit_gauss(21, 250, 3.0, 1, 0, &g);
        for (size_t i = 0; i < g.n;
             i += 2) /* some smaller than a pixel: that is where the modes differ */
            for (int k = 0; k < 3; k++)
                g.scale_log[3 * i + k] -= 3.0f;
        struct camera cam = view_from(-8, 5, 4, 60, 44);
        check(what, &g, &cam, &o);
        gauss_free(&g);
    }
}

static void test_modes_differ(void **state)
{
    struct gauss g;
    struct picture p[3];
    struct camera cam = view_from(40, 20, 10, 48, 48); /* far: splats below a pixel */
    kit_gauss(22, 200, 3.0, 0, 0, &g);
    double mass[3] = {0};
    for (int aa = 0; aa < 3; aa++) {
        struct render_options o = PLAIN;
        o.aa = (enum render_aa)aa;
        p[aa] = draw(&g, &cam, &o);
        for (size_t i = 0; i < p[aa].pixels; i++)
            mass[aa] += 1.0 - (double)p[aa].t[i];
        picture_free(&p[aa]);
    }
    /* Without compensation the kernel adds mass; with it, both kernels keep about the same. */
    assert_true(mass[RENDER_AA_NONE] > 1.2 * mass[RENDER_AA_2D]);
    assert_true(fabs(mass[RENDER_AA_MIP] / mass[RENDER_AA_2D] - 1.0) < 0.25);
    gauss_free(&g);
}

static void test_sh_degrees(void **state)
{
    for (uint32_t has = 0; has <= 3; has++)
        for (int use = -1; use <= 3; use++) {
            struct gauss g;
            struct render_options o = PLAIN;
            char what[48];
            snprintf(what, sizeof what, "degree %u, limited to %d", has, use);
            o.sh_degree = use;
            kit_gauss(31 + has, 60, 3.0, has, 0, &g);
            for (size_t i = 0; i < g.n * 3 * gauss_sh_count(has); i++)
                g.sh[i] += (float)rng_normal(5, 6, i) * 0.5f; /* enough to reach the clamp at 0 */
            struct camera cam = view_from(6, 6, 3, 40, 32);
            check(what, &g, &cam, &o);
            gauss_free(&g);
        }
}

/* Rows of a group in the layout with halves. */
static void put_halves(const struct gauss *g, size_t i, float *row)
{
    const size_t n_sh = 3 * gauss_sh_count(g->sh_degree);
    uint16_t halves[3 * LAYOUT_SH_MAX];
    uint8_t *to = (uint8_t *)(row + LAYOUT_PLANE_SH * LAYOUT_LANES) - i % LAYOUT_LANES * 2;
    for (size_t k = 0; k < 3; k++) {
        row[(LAYOUT_PLANE_MEAN + k) * LAYOUT_LANES] = g->mean_m[3 * i + k];
        row[(LAYOUT_PLANE_SCALE + k) * LAYOUT_LANES] = g->scale_log[3 * i + k];
    }
    for (size_t k = 0; k < 4; k++)
        row[(LAYOUT_PLANE_QUAT + k) * LAYOUT_LANES] = g->quat_wxyz[4 * i + k];
    row[LAYOUT_PLANE_OPACITY * LAYOUT_LANES] = g->opacity_logit[i];
    payload_to_float16(g->sh + n_sh * i, n_sh, halves);
    for (size_t k = 0; k < n_sh; k++)
        memcpy(to + k * LAYOUT_LANES * 2, &halves[k], 2);
}

/* One piece, as tiles of a store are placed. */
static void place_halves(const struct gauss *g, struct render_model *m)
{
    struct err e = {0};
    struct render_piece piece = {.n_groups = render_piece_groups(g->n)};
    struct render_placing placing;
    *m = (struct render_model){.sh_degree = g->sh_degree, .sh_halves = true};
    kit_ok(render_model_reserve(render, m, piece.n_groups, 0, &e), e);
    assert_int_equal(m->planes, layout_planes_halves(g->sh_degree, 0));
    kit_ok(render_place_open(render, m, &piece, 1, &placing, &e), e);
    for (size_t i = 0; i < g->n; i++)
        put_halves(g, i, piece.groups + layout_at(i, m->planes));
    render_piece_end(piece.groups, m->planes, g->n);
    kit_ok(render_place_close(render, m, &placing, ERR_OK, &e), e);
    kit_ok(render_model_list(render, NULL, piece.n_groups, m, &e), e);
}

/* Harmonics as halves are the same picture as their values in floats, and near that of the values
 * before they were rounded. There is no way back. */
static void expect_halves(const char *what, struct gauss *g, const struct render_options *o)
{
    struct err e = {0};
    struct render_model m;
    const struct camera cam = view_from(6, 6, 3, 40, 32);
    const size_t n_sh = g->n * 3 * gauss_sh_count(g->sh_degree), n = (size_t)3 * 40 * 32;
    static float got[3 * 40 * 32];
    static double exact[3 * 40 * 32], t[40 * 32];
    double sum = 0.0;
    uint16_t *halves = mem_array(n_sh, sizeof *halves);
    assert_non_null(halves);
    kit_ok(render_ref_forward(g, &cam, o, exact, t, &e), e);
    place_halves(g, &m);
    kit_ok(render_forward(render, &m, &cam, o, got, NULL, &e), e);
    for (size_t i = 0; i < n; i++)
        sum += ((double)got[i] - exact[i]) * ((double)got[i] - exact[i]);
    if (sqrt(sum / (double)n) > HALVES_RMS_TOL)
        fail_msg("%s: rms of halves %.3g (limit %.3g)", what, sqrt(sum / (double)n),
                 HALVES_RMS_TOL);
    payload_to_float16(g->sh, n_sh, halves);
    payload_from_float16(halves, n_sh, g->sh);
    struct picture floats = draw(g, &cam, o);
    if (memcmp(floats.rgb, got, sizeof got))
        fail_msg("%s: not the picture of the same values in floats", what);
    check(what, g, &cam, o);
    kit_ok(render_forward(render, &m, &cam, o, got, NULL, &e), e);
    kit_fails(render_backward(render, &m, m.params, &e), ERR_ARG, e, "16 bits");
    picture_free(&floats);
    mem_free(halves);
    render_model_free(&m);
}

static void check_halves(void)
{
    static const size_t counts[] = {1, 16, 60, 100};
    for (uint32_t has = 0; has <= 3; has++)
        for (int use = -1; use <= 3; use += 2) {
            struct gauss g;
            struct render_options o = PLAIN;
            char what[64];
            snprintf(what, sizeof what, "halves of degree %u, limited to %d", has, use);
            o.sh_degree = use;
            kit_gauss(37 + has, counts[has], 3.0, has, 0, &g);
            expect_halves(what, &g, &o);
            gauss_free(&g);
        }
}

static void test_halves(void **state)
{
    check_halves();
}

static void test_camera_inside(void **state)
{
    struct gauss g;
    kit_gauss(41, 300, 3.0, 2, 0, &g);
    struct camera cam = view_from(0.5, 0.4, 0.3, 64, 48);
    check("inside", &g, &cam, &PLAIN);
    struct render_options o = PLAIN;
    o.near_m = 1.5;
    check("inside, near plane at 1.5 m", &g, &cam, &o);
    gauss_free(&g);
}

/* Behind, beside, and an off-centre principal point: both branches of the clamp in the Jacobian. */
static void test_off_frustum(void **state)
{
    struct gauss g;
    const double eye[3] = {0, -6, 1}, aside[3] = {9, 0, 1}, away[3] = {0, -20, 1};
    kit_gauss(51, 200, 3.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++)
        for (int k = 0; k < 3; k++)
            g.scale_log[3 * i + k] += 0.7f;
    struct camera cam = camera_look_at(eye, aside, 0.8, 64, 40);
    cam.cx_px = 12.25;
    cam.cy_px = 31.5;
    check("beside", &g, &cam, &PLAIN);
    cam = camera_look_at(eye, away, 0.8, 33, 31);
    struct picture p = draw(&g, &cam, &PLAIN);
    assert_int_equal(render_last_stats(render)->visible, 0);
    for (size_t i = 0; i < p.pixels; i++)
        assert_true(p.t[i] == 1.0f && p.rgb[3 * i] == 0.0f);
    picture_free(&p);
    gauss_free(&g);
}

static void test_saturated(void **state)
{
    struct gauss g;
    kit_gauss(61, 300, 1.5, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) {
        g.opacity_logit[i] = 12.0f; /* alpha runs into 0.99, pixels into the stop */
        for (int k = 0; k < 3; k++)
            g.scale_log[3 * i + k] += 1.2f;
    }
    struct camera cam = view_from(4, -3, 3, 64, 48);
    check("opaque", &g, &cam, &PLAIN);
    struct picture p = draw(&g, &cam, &PLAIN);
    size_t stopped = 0;
    for (size_t i = 0; i < p.pixels; i++)
        stopped += p.t[i] <= LAYOUT_TRANSMITTANCE_MIN ? 1 : 0;
    assert_true(stopped > p.pixels / 10); /* the case was reached */
    picture_free(&p);
    gauss_free(&g);
}

/* Splats taller than LAYOUT_BANDS tile rows, so that bands hold several; long diagonal needles
 * among them. */
static void test_large_splats(void **state)
{
    struct gauss g;
    kit_gauss(71, 24, 2.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) {
        g.scale_log[3 * i] = 0.3f;
        g.scale_log[3 * i + 1] = i % 2 ? -4.0f : -1.0f;
        g.scale_log[3 * i + 2] = -4.0f;
        g.opacity_logit[i] = -1.0f;
    }
    struct camera cam = view_from(3, -4, 3, 200, 344);
    check("tall", &g, &cam, &PLAIN);
    gauss_free(&g);
}

static void test_ties_are_by_index(void **state)
{
    struct gauss g;
    kit_gauss(81, 40, 2.0, 0, 0, &g);
    for (size_t i = 1; i < g.n; i++)
        memcpy(&g.mean_m[3 * i], g.mean_m, 3 * sizeof(float)); /* forty splats at one place */
    struct camera cam = view_from(5, 4, 3, 48, 48);
    check("ties", &g, &cam, &PLAIN);
    gauss_free(&g);
}

/* ---- properties ---- */

static void expect_same_bits(const char *what, const struct picture *a, const struct picture *b)
{
    if (memcmp(a->rgb, b->rgb, 3 * a->pixels * sizeof(float)) ||
        memcmp(a->t, b->t, a->pixels * sizeof(float)))
        fail_msg("%s: pictures differ", what);
}

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

static void test_limits(void **state)
{
    struct gauss g;
    struct err e = {0};
    struct render_model m;
    struct camera cam = view_from(6, -5, 5, 64, 48);
    float rgb[3 * 64 * 48];
    kit_gauss(141, 200, 3.0, 0, 0, &g);
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    uint64_t keep = render->intersection_max;
    render->intersection_max = 10;
    kit_fails(render_forward(render, &m, &cam, &PLAIN, rgb, NULL, &e), ERR_LIMIT, e,
              "intersections");
    assert_false(render->drawn);
    render->intersection_max = keep;
    kit_ok(render_forward(render, &m, &cam, &PLAIN, rgb, NULL, &e), e);
    struct camera bad = cam;
    bad.width_px = 0;
    kit_fails(render_forward(render, &m, &bad, &PLAIN, rgb, NULL, &e), ERR_ARG, e, "0 x 48");
    bad = cam;
    bad.height_px = 16385;
    kit_fails(render_forward(render, &m, &bad, &PLAIN, rgb, NULL, &e), ERR_ARG, e, "16385");
    bad = cam;
    bad.fx_px = -1;
    kit_fails(render_forward(render, &m, &bad, &PLAIN, rgb, NULL, &e), ERR_ARG, e, "focal");
    bad = cam;
    bad.trans[1] = (double)NAN;
    kit_fails(render_forward(render, &m, &bad, &PLAIN, rgb, NULL, &e), ERR_ARG, e, "not finite");
    render_model_free(&m);
    render_model_free(&m);
    gauss_free(&g);
}

/* F2: whatever the parameters, pictures are finite; zero quaternions and needles still draw. */
static void test_hostile_parameters(void **state)
{
    static const float odd[] = {0.0f,   -0.0f,  1e-30f,   -1e-30f,   1e30f, -1e30f, 88.0f,
                                -88.0f, 200.0f, INFINITY, -INFINITY, NAN,   1.0f,   -7.0f};
    enum { ODD = sizeof odd / sizeof *odd, N = 4096 };
    struct gauss g;
    struct camera cam = view_from(6, -5, 5, 80, 60);
    kit_gauss(151, N, 3.0, 1, 0, &g);
    float *planes[] = {g.mean_m, g.scale_log, g.quat_wxyz, g.opacity_logit, g.sh};
    const size_t width[] = {3, 3, 4, 1, 12};
    for (size_t i = 0; i < N; i++) { /* one or two bad values each */
        for (uint64_t hit = 0; hit < 1 + i % 2; hit++) {
            size_t k = (size_t)(rng_u64(1, hit, i) % 5);
            planes[k][i * width[k] + rng_u64(2, hit, i) % width[k]] = odd[rng_u64(3, hit, i) % ODD];
        }
    }
    for (int aa = 0; aa < 3; aa++) {
        struct render_options o = PLAIN;
        o.aa = (enum render_aa)aa;
        struct picture p = draw(&g, &cam, &o);
        for (size_t i = 0; i < p.pixels; i++) {
            assert_true(p.t[i] >= 0.0f && p.t[i] <= 1.0f);
            assert_false(isnan(p.rgb[3 * i]) || isnan(p.rgb[3 * i + 1]) || isnan(p.rgb[3 * i + 2]));
        }
        picture_free(&p);
    }
    gauss_free(&g);

    kit_gauss(152, 32, 2.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) {
        for (int k = 0; k < 4; k++)
            g.quat_wxyz[4 * i + k] = i % 2 ? 0.0f : g.quat_wxyz[4 * i + k] * 1e-4f;
        g.scale_log[3 * i] = 1.0f;
        g.scale_log[3 * i + 1] = g.scale_log[3 * i + 2] = 1.0f - 13.8f; /* ratio 1e6 */
    }
    struct render_options o = PLAIN;
    o.aa = RENDER_AA_NONE;
    check("needles and zero quaternions", &g, &cam, &o);
    gauss_free(&g);
}

/* F3: a splat right before the lens does not cover the picture. */
static void test_near_plane(void **state)
{
    struct gauss g;
    const double eye[3] = {0, 0, 0}, target[3] = {0, 1, 0};
    kit_gauss(161, 2, 1.0, 0, 0, &g);
    const float mean[6] = {0, 0.3f, 0, 0, 0.19f, 0}; /* one just behind 0.2 m, one in front of it */
    memcpy(g.mean_m, mean, sizeof mean);
    for (int i = 0; i < 6; i++)
        g.scale_log[i] = 1.0f;
    struct camera cam = camera_look_at(eye, target, 0.9, 48, 32);
    struct picture p = draw(&g, &cam, &PLAIN);
    assert_int_equal(render_last_stats(render)->visible, 0);
    check("before the lens", &g, &cam, &PLAIN);
    picture_free(&p);
    gauss_free(&g);
}

/* F24: lists of many more intersections than Gaussians, against brute force. */
static void test_many_intersections(void **state)
{
    struct gauss g;
    struct camera cam = view_from(2, -2, 1.5, 400, 96);
    kit_gauss(171, 160, 2.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) {
        for (int k = 0; k < 3; k++)
            g.scale_log[3 * i + k] = 0.2f;
        g.opacity_logit[i] = -4.0f;
    }
    check("dense", &g, &cam, &PLAIN);
    assert_true(render_last_stats(render)->intersections > 50 * g.n);
    gauss_free(&g);
}

/* ---- model, lists and layout ---- */

static void test_upload_download(void **state)
{
    static const size_t counts[] = {0, 1, 16, 100};
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++) {
        struct gauss g, back = {0};
        struct err e = {0};
        struct render_model m;
        kit_gauss(181, counts[c], 3.0, 2, 0, &g);
        g.origin_enu_m[1] = 12345.0;
        kit_ok(render_model_upload(render, &g, &m, &e), e);
        assert_int_equal(m.groups, (counts[c] + 15) / 16);
        kit_ok(render_model_download(render, &m, &back, &e), e);
        assert_int_equal(back.n, g.n);
        assert_true(back.origin_enu_m[1] == g.origin_enu_m[1]);
        if (g.n) {
            assert_memory_equal(back.mean_m, g.mean_m, 3 * g.n * sizeof(float));
            assert_memory_equal(back.scale_log, g.scale_log, 3 * g.n * sizeof(float));
            assert_memory_equal(back.quat_wxyz, g.quat_wxyz, 4 * g.n * sizeof(float));
            assert_memory_equal(back.opacity_logit, g.opacity_logit, g.n * sizeof(float));
            assert_memory_equal(back.sh, g.sh, 27 * g.n * sizeof(float));
        }
        render_model_free(&m);
        gauss_free(&g);
        gauss_free(&back);
    }
}

static void test_layout_on_device(void **state)
{
    static const char text[] = "__kernel void sizes(__global uint *out)\n{\n"
                               "    out[0] = sizeof(struct layout_splat);\n"
                               "    out[1] = sizeof(struct layout_view);\n"
                               "    out[2] = sizeof(struct layout_counts);\n"
                               "    out[3] = sizeof(struct layout_adam);\n"
                               "    out[4] = sizeof(struct layout_scale_piece);\n}\n";
    const struct dev_source src = {"tests/sizes.cl", text};
    struct err e = {0};
    cl_program p;
    cl_kernel k;
    cl_mem m;
    uint32_t got[5];
    kit_ok(dev_build(&dev, &src, 1, NULL, &p, &e), e);
    kit_ok(dev_kernel(p, "sizes", &k, &e), e);
    kit_ok(dev_buffer(&dev, sizeof got, NULL, &m, &e), e);
    dev_arg(k, 0, m);
    kit_ok(dev_run(&dev, k, "sizes", 1, 1, &e), e);
    kit_ok(dev_read(&dev, m, 0, sizeof got, got, &e), e);
    assert_int_equal(got[0], sizeof(struct layout_splat));
    assert_int_equal(got[1], sizeof(struct layout_view));
    assert_int_equal(got[2], sizeof(struct layout_counts));
    assert_int_equal(got[3], sizeof(struct layout_adam));
    assert_int_equal(got[4], sizeof(struct layout_scale_piece));
    dev_release(&m);
    clReleaseKernel(k);
    clReleaseProgram(p);
}

/* The polynomial behind alpha, over its whole range. */
static void test_exp2(void **state)
{
    static const char text[] =
        "__kernel void powers(__global float *x)\n{\n    size_t i = get_global_id(0);\n"
        "#if VW == 16\n    vstore16(exp2_v(vload16(i, x)), i, x);\n#else\n    x[i] = "
        "exp2_v(x[i]);\n#endif\n}\n";
    const struct dev_source src[] = {FRAME_SOURCES, {"tests/powers.cl", text}};
    enum { N = 1 << 16 };
    struct err e = {0};
    cl_program p;
    cl_kernel k;
    cl_mem m;
    float *x = mem_array(N, sizeof *x), *y = mem_array(N, sizeof *y);
    for (int i = 0; i < N; i++)
        x[i] = -126.0f + 253.0f * (float)i / N;
    kit_ok(dev_build(&dev, src, sizeof src / sizeof *src, NULL, &p, &e), e);
    kit_ok(dev_kernel(p, "powers", &k, &e), e);
    kit_ok(dev_buffer(&dev, N * sizeof *x, x, &m, &e), e);
    dev_arg(k, 0, m);
    kit_ok(dev_run(&dev, k, "powers", N / dev.vector_width, 1, &e), e);
    kit_ok(dev_read(&dev, m, 0, N * sizeof *y, y, &e), e);
    for (int i = 0; i < N; i++)
        assert_true(fabs((double)y[i] / exp2((double)x[i]) - 1.0) <
                    2.5e-7); /* 7.5e-8 and two roundings */
    dev_release(&m);
    clReleaseKernel(k);
    clReleaseProgram(p);
    mem_free(x);
    mem_free(y);
}

/* The shapes for GPUs, on whatever device there is: one Gaussian a work-item, one tile a
 * work-group. */
static void test_gpu_shapes(void **state)
{
    static const size_t counts[] = {0, 17, 400};
    struct dev scalar = dev;
    struct render *wide = render;
    struct err e = {0};
    scalar.vector_width = dev.vector_width == 1 ? 16 : 1;
    kit_ok(render_open(&scalar, &render, &e), e);
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        struct gauss g;
        struct camera cam = view_from(5, -4, 4, 50, 37);
        struct render_options o = PLAIN;
        o.background[1] = 0.5f;
        kit_gauss(211, counts[i], 2.5, 3, 0, &g);
        for (size_t k = 0; k < g.n; k += 4)
            g.opacity_logit[k] = 10.0f;
        check("other shapes", &g, &cam, &o);
        gauss_free(&g);
    }
    check_halves();
    render_close(&render);
    render = wide;
}

/* Rays parallel to the axis: pixels a metre instead of a focal length. */
static void test_orthographic(void **state)
{
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    struct camera cam = view_from(8, -5, 9, 130, 70);
    struct err e = {0};
    struct gauss g;
    struct render_model m = {0};
    cam.fx_px = 14;
    cam.fy_px = 11;
    kit_gauss(77, 400, 4.0, 3, 0, &g);
    for (size_t i = 0; i < sizeof modes / sizeof *modes; i++) {
        struct render_options o = {.aa = modes[i], .sh_degree = -1, .orthographic = true};
        check("orthographic", &g, &cam, &o);
        o.kernel_px2 = 0.03;
        check("orthographic, with a narrow kernel", &g, &cam, &o);
    }
    /* Farther away along the axis it is the same picture. */
    struct render_options o = {.aa = RENDER_AA_2D, .sh_degree = -1, .orthographic = true};
    struct picture near = draw(&g, &cam, &o);
    cam.trans[2] += 500;
    struct picture far = draw(&g, &cam, &o);
    double *want = mem_array(3 * near.pixels, sizeof *want);
    assert_non_null(want);
    for (size_t i = 0; i < 3 * near.pixels; i++)
        want[i] = (double)near.rgb[i];
    compare("farther along the axis", far.rgb, want, 3 * near.pixels);
    mem_free(want);
    picture_free(&near);
    picture_free(&far);
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, &o, NULL, NULL, &e), e);
    kit_fails(render_backward(render, &m, m.params, &e), ERR_ARG, e, "orthographic");
    render_model_free(&m);
    gauss_free(&g);
}

/* ---- supersampling ---- */

/* The filter, by its definition: weights of both axes at once, in double. */
static void reduce(const double *fine, size_t width, size_t height, size_t factor, size_t channels,
                   double *out)
{
    double variance = 0.3 * (double)(factor * factor - 1);
    ptrdiff_t f = (ptrdiff_t)factor, w = (ptrdiff_t)width, h = (ptrdiff_t)height;
    ptrdiff_t reach = (ptrdiff_t)ceil(3.0 * sqrt(variance) - 0.5 * (double)f);
    for (ptrdiff_t i = 0; i < w * h; i++) {
        double sum[3] = {0}, all = 0.0;
        for (ptrdiff_t y = i / w * f - reach; y < (i / w + 1) * f + reach; y++)
            for (ptrdiff_t x = i % w * f - reach; x < (i % w + 1) * f + reach; x++) {
                double dx = (double)x + 0.5 - ((double)(i % w) + 0.5) * (double)f,
                       dy = (double)y + 0.5 - ((double)(i / w) + 0.5) * (double)f,
                       weight = exp(-0.5 * (dx * dx + dy * dy) / variance);
                if (x < 0 || y < 0 || x >= f * w || y >= f * h)
                    continue;
                all += weight;
                for (size_t c = 0; c < channels; c++)
                    sum[c] += weight * fine[(size_t)(y * f * w + x) * channels + c];
            }
        for (size_t c = 0; c < channels; c++)
            out[(size_t)i * channels + c] = sum[c] / all;
    }
}

static void test_supersampling(void **state)
{
    static const uint32_t sizes[][2] = {{33, 20}, {1, 1}, {130, 3}}; /* 64 columns at a time */
    static double fine[4 * 4 * 33 * 20 * 3], fine_t[4 * 4 * 33 * 20], rgb[33 * 20 * 3], t[33 * 20];
    struct err e = {0};
    struct gauss g;
    kit_gauss(23, 200, 3.0, 1, 0, &g);
    for (uint32_t factor = 2; factor <= 4; factor++)
        for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
            uint32_t w = sizes[s][0], h = sizes[s][1];
            struct camera cam = view_from(20, 10, 5, w, h);
            const struct camera large = camera_resize(&cam, factor * w, factor * h);
            struct render_options o = PLAIN;
            o.background[1] = 0.5f;
            kit_ok(render_ref_forward(&g, &large, &o, fine, fine_t, &e), e);
            reduce(fine, w, h, factor, 3, rgb);
            reduce(fine_t, w, h, factor, 1, t);
            o.supersample = factor;
            struct picture p = draw(&g, &cam, &o);
            compare("supersampled colours", p.rgb, rgb, 3 * p.pixels);
            compare("supersampled transmittance", p.t, t, p.pixels);
            picture_free(&p);
        }
    struct render_options o = {.aa = RENDER_AA_NONE, .supersample = 2};
    struct camera cam = view_from(20, 10, 5, 8, 8), wide = view_from(20, 10, 5, 8193, 1);
    struct render_model m;
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e, "anti-aliased");
    o.aa = RENDER_AA_2D;
    o.supersample = 5;
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e, "1 to 4");
    o.supersample = 2;
    kit_fails(render_forward(render, &m, &wide, &o, NULL, NULL, &e), ERR_ARG, e, "at most 8192");
    o.background_where = (const uint8_t[8 * 8]){0};
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e,
              "another background");
    render_model_free(&m);
    gauss_free(&g);
}

/* Opaque splats that tile a wall hide what is behind it; smaller than a pixel, each is faint, and
 * drawn finer they hide more again. */
static void test_supersampling_hides_more(void **state)
{
    enum { SIDE = 120 };
    struct gauss g;
    double left[2] = {0};
    kit_gauss(24, (size_t)SIDE * SIDE, 1.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) {
        g.mean_m[3 * i] = 0.05f * ((float)(i % SIDE) - 0.5f * SIDE);
        g.mean_m[3 * i + 1] = 0.05f * ((float)(i / SIDE) - 0.5f * SIDE);
        g.mean_m[3 * i + 2] = 0.0f;
        g.opacity_logit[i] = 4.0f;
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] = logf(0.03f);
    }
    const double eye[3] = {0, 0, 40}, target[3] = {0};
    const struct camera cam = camera_look_at(eye, target, 0.12, 32, 32);
    for (uint32_t factor = 1; factor <= 2; factor++) {
        struct render_options o = PLAIN;
        o.supersample = factor;
        struct picture p = draw(&g, &cam, &o);
        for (size_t i = 0; i < p.pixels; i++)
            left[factor - 1] += (double)p.t[i] / (double)p.pixels;
        picture_free(&p);
    }
    assert_true(left[1] < 0.9 * left[0]);
    gauss_free(&g);
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

/* An argument is a pattern of test names: what a simulator can do in time. */
int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_layout_on_device),
        cmocka_unit_test(test_exp2),
        cmocka_unit_test(test_upload_download),
        cmocka_unit_test(test_counts_and_sizes),
        cmocka_unit_test(test_antialiasing_modes),
        cmocka_unit_test(test_modes_differ),
        cmocka_unit_test(test_sh_degrees),
        cmocka_unit_test(test_halves),
        cmocka_unit_test(test_camera_inside),
        cmocka_unit_test(test_off_frustum),
        cmocka_unit_test(test_saturated),
        cmocka_unit_test(test_large_splats),
        cmocka_unit_test(test_ties_are_by_index),
        cmocka_unit_test(test_culling_changes_nothing),
        cmocka_unit_test(test_groups_outside),
        cmocka_unit_test(test_picture_alone),
        cmocka_unit_test(test_repeatable),
        cmocka_unit_test(test_far_from_origin),
        cmocka_unit_test(test_background),
        cmocka_unit_test(test_edge),
        cmocka_unit_test(test_growth),
        cmocka_unit_test(test_limits),
        cmocka_unit_test(test_hostile_parameters),
        cmocka_unit_test(test_near_plane),
        cmocka_unit_test(test_many_intersections),
        cmocka_unit_test(test_gpu_shapes),
        cmocka_unit_test(test_orthographic),
        cmocka_unit_test(test_supersampling),
        cmocka_unit_test(test_supersampling_hides_more),
        cmocka_unit_test(test_stats),
    };
    return cmocka_run_group_tests_name("render", tests, setup, teardown);
}
