/* The forward kernels against the double-precision reference, in both shapes; the layout of what
 * they read, and what they refuse. Properties of any scene: test_render_properties.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/draw_kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/splat/payload.h"
#include "render/frame.h"

/* Harmonics as halves have errors of 2^-12 of themselves. A colour is the sum of 16 of them, times
 * basis functions whose squares add up to 16 / (4 pi), and they are 0.8 and less here. */
#define HALVES_RMS_TOL 2e-4 /* 74 dB */

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

/* An argument is a pattern of test names: what a simulator can do in time. */
int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_layout_on_device),   cmocka_unit_test(test_exp2),
        cmocka_unit_test(test_upload_download),    cmocka_unit_test(test_counts_and_sizes),
        cmocka_unit_test(test_antialiasing_modes), cmocka_unit_test(test_modes_differ),
        cmocka_unit_test(test_sh_degrees),         cmocka_unit_test(test_halves),
        cmocka_unit_test(test_camera_inside),      cmocka_unit_test(test_off_frustum),
        cmocka_unit_test(test_saturated),          cmocka_unit_test(test_large_splats),
        cmocka_unit_test(test_ties_are_by_index),  cmocka_unit_test(test_limits),
        cmocka_unit_test(test_hostile_parameters), cmocka_unit_test(test_near_plane),
        cmocka_unit_test(test_many_intersections), cmocka_unit_test(test_gpu_shapes),
        cmocka_unit_test(test_orthographic),
    };
    return cmocka_run_group_tests_name("render", tests, render_kit_open, render_kit_close);
}
