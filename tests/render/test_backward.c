/* The backward kernels: they agree with the reference in double, decide as the forward pass does,
 * give the same bits for any number of threads, and report clear errors. test_step.c tests the
 * optimiser.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/render_ref.h"
#include "tests/render/backward_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* float against double: single gradients are sums of hundreds of products with cancellation. */
#define KERNEL_REL 2e-3
#define KERNEL_L2 2e-5 /* over all Gaussians: measured 4e-6 at worst */
/* Kernel gradients of s (unfused) into out, by kernels of this vector width (0: the device's own).
 */
static void kernel_gradients(struct render *r, const struct view_case *s, uint32_t width,
                             struct gauss *out)
{
    uint32_t own = dev_get()->vector_width;
    struct render_model m = {0};
    struct err e = {0};
    cl_mem grads;
    kernel_forward(r, s, &m);
    size_t bytes = (size_t)m.groups * m.planes * 16 * sizeof(float);
    float *junk = mem_array(bytes, 1);
    assert_non_null(junk);
    memset(junk, 0xFF, bytes); /* NaN: every plane must be written */
    kit_ok(dev_buffer(dev_get(), bytes, junk, &grads, &e), e);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = render_backward(r, &m, grads, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    gauss_like(&s->g, out);
    planes_read(&m, grads, out);
    dev_release(&grads);
    mem_free(junk);
    render_model_free(&m);
}

static void check_kernels(struct render *r, struct view_case *s, const char *what, uint32_t width)
{
    struct grads want = grads_make(&s->g);
    struct gauss got = {0};
    struct err e = {0};
    double sure = clear_ambiguous(s);
    if (sure < 0.5)
        fail_msg("%s: only %.2f of the pixels are away from every threshold", what, sure);
    want.r.moments_grad = s->moments_grad;
    kit_ok(render_ref_backward(&s->g, &s->cam, &s->o, s->rgb_grad, &want.r, &e), e);
    kernel_gradients(r, s, width, &got);
    for (size_t k = 0; k < 5; k++) {
        char name[96];
        const float *v = part_of(&got, k);
        double err2 = 0, ref2 = 0;
        for (size_t i = 0; i < want.count[k]; i++) {
            err2 += ((double)v[i] - want.part[k][i]) * ((double)v[i] - want.part[k][i]);
            ref2 += want.part[k][i] * want.part[k][i];
        }
        snprintf(name, sizeof name, "%s: %s", what, backward_part[k]);
        kit_near(name, v, want.part[k], want.count[k],
                 KERNEL_REL * rms(want.part[k], want.count[k]), KERNEL_REL);
        if (getenv("CITYSPLAT_TEST_VERBOSE"))
            print_message("%s: relative L2 %.2g, %.2f of the pixels\n", name, sqrt(err2 / ref2),
                          sure);
        if (!(sqrt(err2) <= KERNEL_L2 * sqrt(ref2)))
            fail_msg("%s: relative L2 error %g > %g", name, sqrt(err2 / ref2), KERNEL_L2);
    }
    gauss_free(&got);
    mem_free(want.block);
}

static void test_kernels_match_reference(void **state)
{
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    struct render *r;
    struct err e = {0};
    kit_ok(render_open(dev_get(), &r, &e), e);
    for (uint32_t i = 0; i < 3; i++) {
        char name[64];
        for (uint32_t degree = 0; degree < 4; degree++) {
            struct view_case s = view_case_make(20 + i, 15 + degree, modes[i], degree);
            snprintf(name, sizeof name, "mode %u, degree %u", i, degree);
            check_kernels(r, &s, name, 0);
            view_case_free(&s);
        }
        struct view_case s = view_case_saturated(modes[i]);
        check_kernels(r, &s, "saturated", 0);
        view_case_free(&s);
        s = view_case_outside(modes[i]);
        check_kernels(r, &s, "outside the picture", 0);
        view_case_free(&s);
        s = view_case_needles(modes[i]);
        check_kernels(r, &s, "needles", 0);
        view_case_free(&s);
    }
    struct view_case s = view_case_make(5, 300, RENDER_AA_2D, 3); /* many groups, long lists */
    check_kernels(r, &s, "300 Gaussians", 0);
    s.o.sh_degree = 1;
    check_kernels(r, &s, "degree 1 of 3", 0);
    view_case_free(&s);
    s = view_case_make(6, 40, RENDER_AA_2D, 1);
    view_case_split_background(&s);
    check_kernels(r, &s, "two backgrounds", 0);
    view_case_free(&s);
    render_close(&r);
}

/* Moments of depth of a frame against the reference, and their gradients. */
#define MOMENTS_ABS 2e-5 /* depths of 2 to 4 m in units of 2.5 m, in float */
static void check_moments(struct render *r, struct view_case *s, const char *what)
{
    size_t px = (size_t)s->cam.width_px * s->cam.height_px;
    struct render_model m = {0};
    struct err e = {0};
    double *want = mem_array(px, 3 * sizeof *want);
    assert_non_null(want);
    kernel_forward(r, s, &m);
    float *moments = floats_read(render_moments_buffer(r), 2 * px),
          *t = floats_read(render_transmittance_buffer(r), px);
    kit_ok(render_ref_moments(&s->g, &s->cam, &s->o, want, &e), e);
    (void)clear_ambiguous(s);
    double sum = 0;
    for (size_t i = 0; i < px; i++) {
        bool sure = s->moments_grad[3 * i] != 0;
        const double got[3] = {(double)moments[i], (double)moments[px + i], (double)t[i]};
        for (size_t c = 0; sure && c < 3; c++) {
            if (!(fabs(got[c] - want[3 * i + c]) <= MOMENTS_ABS))
                fail_msg("%s: pixel %zu, moment %zu: %.8g, reference %.8g", what, i, c, got[c],
                         want[3 * i + c]);
            sum += fabs(got[c]);
        }
    }
    assert_true(sum > 1);
    mem_free(moments);
    mem_free(t);
    mem_free(want);
    render_model_free(&m);
    check_kernels(r, s, what, 0);
}

static void test_moments_match_reference(void **state)
{
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    struct render *r;
    struct err e = {0};
    kit_ok(render_open(dev_get(), &r, &e), e);
    for (size_t i = 0; i < 3; i++) {
        struct view_case s[5] = {view_case_make(230 + i, 17, modes[i], 1),
                                 view_case_outside(modes[i]), view_case_needles(modes[i]),
                                 view_case_saturated(modes[i]),
                                 view_case_make(240 + i, 300, modes[i], 2)};
        static const char *const name[] = {"moments", "moments outside", "moments of needles",
                                           "moments, saturated", "moments of 300"};
        for (size_t k = 0; k < 5; k++) {
            view_case_moments(&s[k]);
            check_moments(r, &s[k], name[k]);
            if (k != 4) { /* of 300, few pixels are far enough from all kinks */
                mem_free(s[k].moments_grad);
                view_case_known(&s[k]);
                check_moments(r, &s[k], "about known depths");
            }
            view_case_free(&s[k]);
        }
    }
    render_close(&r);
}

static void test_known_errors(void **state)
{
    struct view_case s = view_case_make(1, 4, RENDER_AA_2D, 0);
    struct render_model m = {0};
    struct render *r;
    struct err e = {0};
    view_case_known(&s);
    kit_ok(render_open(dev_get(), &r, &e), e);
    kernel_forward(r, &s, &m);
    assert_non_null(render_known_buffer(r));
    const struct render_options keep = s.o;
    for (int i = 0; i < 3; i++) {
        static const double bad[] = {0, -1, (double)NAN};
        s.o.known_zeta = bad[i];
        kit_fails(render_forward(r, &m, &s.cam, &s.o, NULL, NULL, &e), ERR_ARG, e, "unit of depth");
    }
    s.o = keep;
    s.o.depth_unit_m = 0;
    kit_fails(render_forward(r, &m, &s.cam, &s.o, NULL, NULL, &e), ERR_ARG, e, "unit of depth");
    s.o = keep;
    s.o.known = NULL;
    kit_ok(render_forward(r, &m, &s.cam, &s.o, NULL, NULL, &e), e);
    assert_null(render_known_buffer(r));
    render_model_free(&m);
    render_close(&r);
    view_case_free(&s);
}

/* The kernels as a GPU gets them (one Gaussian or pixel a work-item), run here: those of the way
 * back are built on first use, so that the forward pass need not be narrow as well. */
static void test_narrow_kernels_match_reference(void **state)
{
    for (int i = 0; i < 7; i++) {
        struct view_case s = i % 3 == 0 ? view_case_make(60, 40, RENDER_AA_2D, 2)
                             : i == 1   ? view_case_saturated(RENDER_AA_MIP)
                                        : view_case_needles(RENDER_AA_NONE);
        if (i > 4)
            view_case_known(&s);
        else if (i > 2)
            view_case_moments(&s);
        struct render *r;
        struct err e = {0};
        kit_ok(render_open(dev_get(), &r, &e), e);
        check_kernels(r, &s, "narrow", 1);
        render_close(&r);
        view_case_free(&s);
    }
}

/* ---- thresholds: forward and backward must decide alike (F25) ---- */

/* The picture is linear in the colours: C - T background = sum_i w_i rgb_i, and dC/drgb_i = w_i. If
 * backward took in one splat more or less at one pixel, sum_i rgb_i dC/drgb_i would be off by 1/255
 * T rgb at least. So it is checked pixel by pixel, on splats of which many sit at the thresholds.
 */
#define LINEAR_REL 2e-5
static void test_same_decisions(void **state)
{
    struct render *r;
    struct render_model m = {0};
    struct err e = {0};
    struct view_case s = view_case_saturated(RENDER_AA_NONE);
    struct gauss g = {0};
    const size_t px = (size_t)PX_W * PX_H;
    float *rgb = mem_array(px, 3 * sizeof *rgb), *t = mem_array(px, sizeof *t),
          *g1 = mem_array(px, 3 * sizeof *g1);
    cl_mem grads;
    assert_true(rgb && t && g1);
    kit_ok(gauss_reserve(&s.g, 400, &e), e);
    for (size_t i = s.g.n; i < 400; i++) { /* faint splats: peaks within 2 % of 1/255 */
        gauss_copy_row(&s.g, i, &s.g, i % 12);
        s.g.opacity_logit[i] = (float)(log(1 / 254.0) + 0.04 * (rng_unit(3, 1, i) - 0.5));
        for (size_t a = 0; a < 3; a++) {
            s.g.mean_m[3 * i + a] = (float)(2 * rng_unit(3, 2 + a, i) - 1);
            s.g.scale_log[3 * i + a] = -1.0f;
        }
    }
    s.g.n = 400;
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(render_model_upload(r, &s.g, &m, &e), e);
    kit_ok(render_forward(r, &m, &s.cam, &s.o, rgb, t, &e), e);
    kit_ok(dev_buffer(dev_get(), (size_t)m.groups * m.planes * 64, NULL, &grads, &e), e);
    gauss_like(&s.g, &g);
    size_t stopped = 0;
    double worst = 0;
    for (uint64_t k = 0; k < 200; k++) {
        size_t at = (size_t)(rng_unit(4, 0, k) * (double)px);
        double sum = 0, want = 0;
        memset(g1, 0, px * 3 * sizeof *g1);
        for (size_t c = 0; c < 3; c++) {
            g1[3 * at + c] = 1;
            want += (double)rgb[3 * at + c] - (double)t[at] * (double)s.o.background[c];
        }
        kit_ok(render_set_color_grad(r, g1, &e), e);
        kit_ok(render_backward(r, &m, grads, &e), e);
        planes_read(&m, grads, &g);
        for (size_t i = 0; i < 3 * s.g.n; i++)
            sum += (0.5 + GAUSS_SH_C0 * (double)s.g.sh[i]) * (double)g.sh[i] / GAUSS_SH_C0;
        if (fabs(sum - want) > LINEAR_REL * fmax(want, 0.1))
            fail_msg("pixel %zu: colours give %.8g, backward took in %.8g", at, want, sum);
        stopped += t[at] <= LAYOUT_TRANSMITTANCE_MIN;
        worst = fmax(worst, fabs(sum - want) / fmax(want, 0.1));
    }
    assert_true(stopped > 5);
    kit_figure("F25", "pixels=200 stopped=%zu worst_relative=%.1e limit=%.0e", stopped, worst,
               LINEAR_REL);
    dev_release(&grads);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
    mem_free(rgb);
    mem_free(t);
    mem_free(g1);
    view_case_free(&s);
}

/* ---- same bits, errors ---- */

/* Parameters, moments and statistics after three steps on a picture of many tiles; `test_backward
 * digest` prints it so that runs with other numbers of worker threads can be compared. */
static void digest(char out[33])
{
    struct view_case s = view_case_make(41, 600, RENDER_AA_2D, 3);
    s.cam = camera_resize(&s.cam, 170, 130);
    mem_free(s.rgb_grad);
    s.rgb_grad = grad_make((size_t)170 * 130 * 3, 41);
    struct trainer t = trainer_make(&s.g);
    for (int i = 0; i < 3; i++)
        trainer_step(&t, &s);
    size_t words = (size_t)t.m.groups * t.m.planes * 16, lanes = (size_t)t.m.groups * 16;
    const cl_mem mems[5] = {t.m.params, t.adam.moments, t.stats.grad, t.stats.absg, t.stats.radius};
    struct buf all = {0};
    for (size_t i = 0; i < 5; i++) {
        float *v = floats_read(mems[i], i < 2 ? words : lanes);
        buf_add(&all, v, (i < 2 ? words : lanes) * sizeof *v);
        mem_free(v);
    }
    assert_false(all.failed);
    hash_text(hash_bytes(all.data, all.size), out);
    buf_free(&all);
    trainer_free(&t);
    view_case_free(&s);
}

static void test_same_bits(void **state)
{
    kit_same_bits(digest);
}

static void test_errors(void **state)
{
    struct view_case s = view_case_make(50, 4, RENDER_AA_NONE, 0);
    struct trainer t = trainer_make(&s.g);
    struct render_model other = t.m;
    struct err e = {0};
    float g[3] = {0};
    kit_fails(render_set_color_grad(t.r, g, &e), ERR_ARG, e, "no frame");
    assert_null(render_color_grad_buffer(t.r));
    t.adam.step = 1;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "no frame");
    kit_ok(render_forward(t.r, &t.m, &s.cam, &s.o, NULL, NULL, &e), e);
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "not given");
    kernel_forward(t.r, &s, &t.m);
    t.adam.step = 0;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "counts from 1");
    t.adam.step = 1;
    t.adam.beta2 = 1;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "betas");
    t.adam.beta2 = 0.999f;
    other.n = 3;
    kit_fails(render_backward_step(t.r, &other, &t.adam, NULL, &e), ERR_ARG, e, "others");
    kit_ok(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), e);
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "no frame");
    trainer_free(&t);
    view_case_free(&s);
}

/* Nothing to see is a picture too. */
static void test_empty(void **state)
{
    struct view_case s = view_case_make(51, 3, RENDER_AA_2D, 1);
    struct gauss before = {0}, after = {0};
    for (size_t i = 0; i < s.g.n; i++)
        for (size_t a = 0; a < 3; a++)
            s.g.mean_m[3 * i + a] = (float)(-9 * s.cam.rot[6 + a]);
    struct trainer t = trainer_make(&s.g);
    gauss_like(&s.g, &before);
    gauss_like(&s.g, &after);
    trainer_step(&t, &s);
    planes_read(&t.m, t.m.params, &after);
    assert_memory_equal(after.mean_m, s.g.mean_m, 3 * s.g.n * sizeof(float));
    assert_int_equal(trainer_repaired(&t), 0);
    trainer_free(&t);
    gauss_free(&before);
    gauss_free(&after);
    view_case_free(&s);
}

int main(int argc, char **argv)
{
    if (kit_digest(argc, argv, digest)) {
        dev_close(dev_get());
        return 0;
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_kernels_match_reference),
        cmocka_unit_test(test_moments_match_reference),
        cmocka_unit_test(test_known_errors),
        cmocka_unit_test(test_narrow_kernels_match_reference),
        cmocka_unit_test(test_same_decisions),
        cmocka_unit_test(test_same_bits),
        cmocka_unit_test(test_errors),
        cmocka_unit_test(test_empty),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
