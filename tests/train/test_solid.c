/* The loss on solid surfaces: the reference in double against finite differences, the kernels in
 * both shapes against the reference, and values that can be worked out by hand.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/backward_kit.h"
#include "train/loss/solid.h"

#include <math.h>
#include <string.h>

#define FD_STEP 1e-6
#define FD_REL 2e-6 /* fourth-order differences in double, of a sum that other pixels dominate */
#define FD_ABS 2e-8
#define KERNEL_REL 2e-3 /* V is a difference of float moments of the order of 0.1 */
#define KERNEL_L2 1e-4

static uint8_t support[PX_H * PX_W];
static float known[PX_H * PX_W];

/* Weights that make the terms of the same order; half of the picture is supported, and depth is
 * known in a quarter of it. */
static struct solid_input input(void)
{
    for (size_t i = 0; i < sizeof support; i++)
        support[i] = i % PX_W > PX_W / 2 ? 3 : 0;
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        known[i] = i / PX_W > PX_H / 2 && i % 2 ? 0.9f : -1.0f;
    return (struct solid_input){.width_px = PX_W,
                                .height_px = PX_H,
                                .focal_px = 45,
                                .spread = 0.7,
                                .light = 1.3,
                                .light_known = 0.6,
                                .supported = support};
}

/* Sums that Gaussians could have made, A from 0 to 1. Moments: depths about 0 with steps. About
 * known depths: all sides. */
static double *sums_make(uint64_t seed, bool about)
{
    double *m = mem_array((size_t)PX_W * PX_H, 3 * sizeof *m);
    assert_non_null(m);
    for (size_t i = 0; i < (size_t)PX_W * PX_H; i++) {
        double a = i % 11 ? rng_unit(seed, 1, i) : 0.02, d = 0.1 * rng_normal(seed, 2, i / 3);
        double v = 4e-4 + 0.03 * rng_unit(seed, 3, i) * rng_unit(seed, 4, i);
        d += i % PX_W > 20 ? 0.4 : 0.0;
        m[3 * i] = a * (about ? rng_unit(seed, 5, i) - 0.5 : d);
        m[3 * i + 1] = a * (about ? rng_unit(seed, 6, i) : d * d + v);
        m[3 * i + 2] = 1 - a;
    }
    return m;
}

static double weighted(const struct solid_input *in, const double *sums, const double *held)
{
    struct solid_value v = solid_ref_value(in, sums, held);
    return in->spread * v.spread + in->light * v.light + in->light_known * v.light_known;
}

/* A pixel whose cover and variance are not within a step of their thresholds. */
static bool away(const struct solid_input *in, const double m[3])
{
    double a = 1 - m[2], d = m[0] / a, v = m[1] / a - d * d;
    return fabs(a - SOLID_COVER_MIN) > 1e-4 && (in->known || v > 1e-4);
}

static void test_differences(void **state)
{
    for (uint64_t seed = 1; seed <= 4; seed++) {
        struct solid_input in = input();
        in.known = seed % 2 ? known : NULL;
        size_t n = (size_t)3 * PX_W * PX_H, pulled = 0;
        double *m = sums_make(seed, in.known), *held = sums_make(seed, in.known),
               *grad = mem_array(n, sizeof *grad), *fd = mem_array(n, sizeof *fd);
        assert_true(grad && fd);
        solid_ref_grad(&in, m, grad);
        for (size_t i = 0; i < n; i++) {
            fd[i] = grad[i];
            pulled += i % 3 == 0 && grad[i] != 0;
            if (!away(&in, m + i / 3 * 3))
                continue;
            const double keep = m[i];
            double f[4];
            for (int k = 0; k < 4; k++) {
                static const double step[4] = {-2, -1, 1, 2};
                m[i] = keep + step[k] * FD_STEP;
                f[k] = weighted(&in, m, held);
            }
            fd[i] = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * FD_STEP);
            m[i] = keep;
        }
        assert_true(pulled > n / 6);
        kit_near_d("solid", grad, fd, n, FD_ABS, FD_REL);
        mem_free(m);
        mem_free(held);
        mem_free(grad);
        mem_free(fd);
    }
}

static void check_kernels(uint32_t width, struct view_case *s, const struct solid_input *given)
{
    struct solid_input in = *given;
    size_t px = (size_t)PX_W * PX_H;
    uint32_t own = dev_get()->vector_width;
    struct render_model model = {0};
    struct render *r;
    struct solid *solid;
    struct err e = {0};
    double *m = mem_array(px, 3 * sizeof *m), *want = mem_array(px, 3 * sizeof *want);
    assert_true(m && want);
    kit_ok(render_open(dev_get(), &r, &e), e);
    kernel_forward(r, s, &model);
    float *moments = floats_read(render_moments_buffer(r), 2 * px),
          *t = floats_read(render_transmittance_buffer(r), px);
    for (size_t i = 0; i < px; i++) {
        m[3 * i] = (double)moments[i];
        m[3 * i + 1] = (double)moments[px + i];
        m[3 * i + 2] = (double)t[i];
    }
    dev_get()->vector_width = width ? width : own;
    kit_ok(solid_open(dev_get(), &solid, &e), e);
    kit_ok(solid_hand_over(solid, &in, &e), e);
    kit_ok(solid_run(solid, r, &in, &e), e);
    dev_get()->vector_width = own;
    float *grad = floats_read(render_moments_grad_buffer(r), 3 * px);
    solid_ref_grad(&in, m, want);
    struct solid_value v = solid_ref_value(&in, m, m);
    double err2 = 0, ref2 = 0;
    for (size_t i = 0; i < 3 * px; i++) {
        double g = (double)grad[i % 3 * px + i / 3], d = g - want[i];
        err2 += d * d;
        ref2 += want[i] * want[i];
        if (fabs(d) > KERNEL_REL * (fabs(want[i]) + rms(want, 3 * px)))
            fail_msg("pixel %zu, %zu: %g, reference %g", i / 3, i % 3, g, want[i]);
    }
    assert_true(sqrt(err2) <= KERNEL_L2 * sqrt(ref2));
    assert_true(v.spread > 0.05 && v.light > 0.05 && v.light_known >= (in.known ? 0.02 : 0.0));
    solid_close(&solid);
    render_model_free(&model);
    render_close(&r);
    mem_free(moments);
    mem_free(t);
    mem_free(grad);
    mem_free(m);
    mem_free(want);
}

static void test_kernels_match_reference(void **state)
{
    for (uint32_t width = 0; width < 2; width++)
        for (uint64_t seed = 301; seed <= 304; seed++) {
            struct view_case s = view_case_make(seed, 120, RENDER_AA_2D, 0);
            struct solid_input in = input();
            for (size_t i = 0; i < s.g.n; i++)
                s.g.opacity_logit[i] += 1.0f; /* few holes */
            view_case_moments(&s);
            for (size_t i = 0; seed % 2 && i < sizeof known / sizeof *known; i++)
                known[i] = (float)(0.9 + 0.2 * rng_unit(9, 1, i)) * known[i];
            s.o.known = in.known = seed % 2 ? known : NULL;
            s.o.known_zeta = 1.1;
            check_kernels(width, &s, &in);
            view_case_free(&s);
        }
}

/* An opaque plane has no spread and no light, and two sheets have their distance as spread. */
static void test_spread_by_hand(void **state)
{
    struct solid_input in = input();
    size_t px = (size_t)PX_W * PX_H;
    double *m = mem_array(px, 3 * sizeof *m);
    assert_non_null(m);
    for (size_t i = 0; i < px; i++) { /* 1/z linear in x and y; opaque */
        double q = 0.8 + 0.004 * (double)(i % PX_W) - 0.003 * (double)(i / PX_W), d = 1 / q - 1;
        m[3 * i] = d;
        m[3 * i + 1] = d * d;
    }
    struct solid_value v = solid_ref_value(&in, m, m);
    assert_true(v.spread < 1e-12 && v.light == 0.0);
    for (size_t i = 0; i < px; i++) { /* half of the light at 0, half of what is left at 0.2 */
        m[3 * i] = 0.25 * 0.2;
        m[3 * i + 1] = 0.25 * 0.2 * 0.2;
        m[3 * i + 2] = 0.25;
    }
    v = solid_ref_value(&in, m, m);
    double mean = 0.2 / 3, var = 0.04 / 3 - mean * mean, px_m = 45 / (1 + mean), soft = 0.25 / px_m;
    double s = px_m * (sqrt(var + soft * soft) - soft), r = s / SOLID_REACH_PX;
    assert_true(fabs(v.spread - 0.75 * 0.5 * (s / (1 + r * r) + SOLID_REACH_PX * atan(r))) < 1e-9);
    assert_true(fabs(v.light - (0.25 - SOLID_LIGHT_T / 2) * 19 / 40) < 1e-9);
    assert_true(v.light_known == 0.0);
    mem_free(m);
}

/* p(q) by the midpoint rule. */
static double balance(double q)
{
    enum { STEPS = 100000 };
    double sum = 0, step = q / STEPS, e = SOLID_SOFT_SIDE;
    for (int i = 0; i < STEPS; i++) {
        double x = (i + 0.5) * step;
        sum += 4 * x * pow(1 - 4 * x * x, 2) / sqrt(x * x + e * e) * step;
    }
    return sum;
}

/* Light at the known depth is no loss; balance of light that is far off to one side has hardly any
 * gradient. */
static void test_balance_by_hand(void **state)
{
    const double side = (double)LAYOUT_SIDE_PX, away = (double)LAYOUT_AWAY_PX;
    struct solid_input in = input();
    size_t px = (size_t)PX_W * PX_H;
    double *m = mem_array(px, 3 * sizeof *m), *grad = mem_array(px, 3 * sizeof *grad);
    assert_true(m && grad);
    for (size_t i = 0; i < px; i++)
        known[i] = 1.0f;
    in.known = known;
    struct solid_value v = solid_ref_value(&in, m, m);
    assert_true(v.spread == 0.0 && v.light == 0.0 && v.light_known == 0.0); /* T is 0 */
    for (size_t i = 0; i < px; i++) { /* three quarters of the light, two footprints behind */
        m[3 * i] = 0.75 * 2 / (2 * (side + 2));
        m[3 * i + 2] = 0.25;
    }
    v = solid_ref_value(&in, m, m);
    assert_true(fabs(v.spread - 0.75 * balance(0.25)) < 1e-6);
    assert_true(v.light == 0.0 &&
                fabs(v.light_known - (0.25 - SOLID_LIGHT_T / 2) * 19 / 40) < 1e-9);
    for (size_t i = 0; i < px; i++) /* and as much away as that is */
        m[3 * i + 1] = 0.75 * (double)LAYOUT_AWAY_BEHIND * (2 - away) / (side + 2);
    assert_true(fabs(solid_ref_value(&in, m, m).spread - v.spread -
                     SOLID_AWAY * 0.75 * (double)LAYOUT_AWAY_BEHIND * (2 - away) / (side + 2)) <
                1e-9);
    solid_ref_grad(&in, m, grad);
    double near = grad[0];
    for (size_t i = 0; i < px; i++) /* 200 footprints behind */
        m[3 * i] = 0.75 * 200 / (2 * (side + 200));
    solid_ref_grad(&in, m, grad);
    assert_true(near > 0 && grad[0] > 0 && grad[0] < 1e-3 * near);
    mem_free(m);
    mem_free(grad);
}

static void test_errors(void **state)
{
    struct view_case s = view_case_make(1, 4, RENDER_AA_2D, 0);
    struct solid_input in = input();
    struct render_model model = {0};
    struct render *r;
    struct solid *solid;
    struct err e = {0};
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(solid_open(dev_get(), &solid, &e), e);
    kernel_forward(r, &s, &model);
    kit_fails(solid_run(solid, r, &in, &e), ERR_ARG, e, "of moments of depth");
    view_case_moments(&s);
    kernel_forward(r, &s, &model);
    in.known = known;
    kit_fails(solid_run(solid, r, &in, &e), ERR_ARG, e, "about known depths");
    s.o.orthographic = true;
    kit_fails(render_forward(r, &model, &s.cam, &s.o, NULL, NULL, &e), ERR_ARG, e, "perspective");
    solid_close(&solid);
    render_model_free(&model);
    render_close(&r);
    view_case_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_differences),    cmocka_unit_test(test_kernels_match_reference),
        cmocka_unit_test(test_spread_by_hand), cmocka_unit_test(test_balance_by_hand),
        cmocka_unit_test(test_errors),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
