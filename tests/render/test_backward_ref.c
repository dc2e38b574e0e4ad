/* render/render_ref_backward.c: the double reference against finite differences.
 *
 * The picture is piecewise smooth: it jumps where alpha crosses 1/255, where a pixel saturates,
 * where two splats change places. The differences therefore compare a signature of these decisions
 * and take a smaller step, or leave the parameter out and count it, when a step changed one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/render_ref.h"
#include "tests/render/backward_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Fourth-order differences with steps of 2^-12 and less in double: truncation (h / sigma)^4 / 30
 * with sigma
 * >= 0.03 is below 1e-7, rounding 1e-16 * |L| / h below 1e-10. */
#define FD_REL 1e-6
/* Relative to the rms of the same kind of parameter: many true gradients are nearly 0. */
#define FD_ABS 1e-6

/* The analytic gradient of every parameter of the scene against differences. */
static void check_reference(struct view_case *s, const char *what)
{
    struct grads want = grads_make(&s->g);
    struct err e = {0};
    float *const params[5] = {s->g.mean_m, s->g.scale_log, s->g.quat_wxyz, s->g.opacity_logit,
                              s->g.sh};
    double *rgb = view_case_colors(s);
    size_t skipped = 0, all = 0;
    want.r.moments_grad = s->moments_grad;
    kit_ok(render_ref_backward(&s->g, &s->cam, &s->o, s->rgb_grad, &want.r, &e), e);
    for (size_t k = 0; k < 5; k++) {
        double *fd = mem_array(want.count[k], sizeof *fd);
        char name[96];
        assert_non_null(fd);
        for (size_t i = 0; i < want.count[k]; i++, all++)
            if (!view_case_differentiate(s, &params[k][i], k == 0 ? rgb : NULL, &fd[i])) {
                fd[i] = want.part[k][i];
                skipped++;
            }
        snprintf(name, sizeof name, "%s: %s", what, backward_part[k]);
        kit_near_d(name, want.part[k], fd, want.count[k], FD_ABS * rms(fd, want.count[k]), FD_REL);
        mem_free(fd);
    }
    if (skipped * 8 > all)
        fail_msg("%s: %zu of %zu parameters could not be differentiated", what, skipped, all);
    mem_free(rgb);
    mem_free(want.block);
}

static void test_ref_all_parameters(void **state)
{
    static const struct {
        enum render_aa aa;
        uint32_t degree;
        const char *name;
    } cases[] = {{RENDER_AA_NONE, 0, "none, degree 0"},
                 {RENDER_AA_2D, 1, "2d, degree 1"},
                 {RENDER_AA_MIP, 2, "mip, degree 2"},
                 {RENDER_AA_2D, 3, "2d, degree 3"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct view_case s = view_case_make(100 + i, 7, cases[i].aa, cases[i].degree);
        check_reference(&s, cases[i].name);
        view_case_free(&s);
    }
}

/* Moments of depth, also of needles and of centres beyond the clamp of the Jacobian. */
static void test_ref_moments(void **state)
{
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    for (size_t i = 0; i < 3; i++) {
        struct view_case s[4] = {view_case_make(130 + i, 7, modes[i], 1),
                                 view_case_outside(modes[i]), view_case_needles(modes[i]),
                                 view_case_saturated(modes[i])};
        static const char *const name[] = {"moments", "moments outside", "moments of needles",
                                           "moments, saturated"};
        for (size_t k = 0; k < 4; k++) {
            view_case_moments(&s[k]);
            check_reference(&s[k], name[k]);
            view_case_free(&s[k]);
        }
    }
}

/* Sums about known depths, of the same. */
static void test_ref_known(void **state)
{
    struct view_case s[3] = {view_case_make(140, 7, RENDER_AA_2D, 1),
                             view_case_outside(RENDER_AA_MIP), view_case_needles(RENDER_AA_NONE)};
    static const char *const name[] = {"known", "known outside", "known of needles"};
    for (size_t k = 0; k < 3; k++) {
        view_case_known(&s[k]);
        check_reference(&s[k], name[k]);
        view_case_free(&s[k]);
    }
}

static void test_ref_split_background(void **state)
{
    struct view_case s = view_case_make(110, 7, RENDER_AA_2D, 1);
    struct grads one = grads_make(&s.g), two = grads_make(&s.g);
    struct err e = {0};
    kit_ok(render_ref_backward(&s.g, &s.cam, &s.o, s.rgb_grad, &one.r, &e), e);
    view_case_split_background(&s);
    check_reference(&s, "two backgrounds");
    kit_ok(render_ref_backward(&s.g, &s.cam, &s.o, s.rgb_grad, &two.r, &e), e);
    assert_true(memcmp(one.r.opacity_logit, two.r.opacity_logit, s.g.n * sizeof(double)) != 0);
    mem_free(one.block);
    mem_free(two.block);
    view_case_free(&s);
}

static void test_ref_saturated(void **state)
{
    struct view_case s = view_case_saturated(RENDER_AA_2D);
    struct err e = {0};
    double *rgb = mem_array((size_t)PX_W * PX_H, 3 * sizeof *rgb),
           *t = mem_array((size_t)PX_W * PX_H, sizeof *t);
    size_t stopped = 0;
    assert_true(rgb && t);
    kit_ok(render_ref_forward(&s.g, &s.cam, &s.o, rgb, t, &e), e);
    for (size_t i = 0; i < (size_t)PX_W * PX_H; i++)
        stopped += t[i] <= (double)LAYOUT_TRANSMITTANCE_MIN;
    assert_true(stopped > 50);
    check_reference(&s, "saturated");
    mem_free(rgb);
    mem_free(t);
    view_case_free(&s);
}

static void test_ref_outside(void **state)
{
    struct view_case s = view_case_outside(RENDER_AA_2D);
    struct ref_view v;
    struct ref_splat p;
    struct err e = {0};
    int clamped[2] = {0}, inside[2] = {0};
    kit_ok(ref_view_init(&s.g, &s.cam, &s.o, &v, &e), e);
    for (size_t i = 0; i < s.g.n; i++) {
        assert_true(ref_project(&v, &s.g, i, &p));
        for (int a = 0; a < 2; a++) {
            clamped[a] += !p.inside[a];
            inside[a] += p.inside[a];
        }
    }
    assert_true(clamped[0] >= 4 && clamped[1] >= 4 && inside[0] && inside[1]);
    check_reference(&s, "outside the picture");
    view_case_free(&s);
}

static void test_ref_needles(void **state)
{
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    for (size_t i = 0; i < 3; i++) {
        struct view_case s = view_case_needles(modes[i]);
        check_reference(&s, "needles");
        view_case_free(&s);
    }
}

/* An SH degree below the model's: the rest has no gradient. A culled Gaussian has none at all. */
static void test_ref_untouched(void **state)
{
    struct view_case s = view_case_make(12, 5, RENDER_AA_2D, 3);
    struct grads g = grads_make(&s.g);
    struct err e = {0};
    s.o.sh_degree = 1;
    for (size_t i = 0; i < s.g.n; i++) {
        for (size_t a = 0; a < 48; a++)
            s.g.sh[48 * i + a] = a < 3 ? 2.0f : 0.01f; /* no colour is clamped */
        for (size_t a = 0; a < 3; a++)
            s.g.mean_m[3 * i + a] *= 0.25f;
        s.g.opacity_logit[i] = 0.0f;
    }
    for (size_t a = 0; a < 3; a++)
        s.g.mean_m[a] = (float)(-9 * s.cam.rot[6 + a]); /* behind the camera */
    for (size_t i = 0; i < 5 * (11 + 48); i++)
        g.block[i] = 1e9; /* must be overwritten */
    kit_ok(render_ref_backward(&s.g, &s.cam, &s.o, s.rgb_grad, &g.r, &e), e);
    for (size_t i = 0; i < 5; i++)
        for (size_t k = 0; k < 48; k++)
            assert_true((g.r.sh[48 * i + k] != 0) == (i > 0 && k < 12));
    for (size_t k = 0; k < 3; k++)
        assert_true(g.r.mean[k] == 0 && g.r.scale_log[k] == 0 && g.r.quat_wxyz[k] == 0);
    mem_fail_at(1);
    kit_fails(render_ref_backward(&s.g, &s.cam, &s.o, s.rgb_grad, &g.r, &e), ERR_MEM, e, NULL);
    mem_fail_at(0);
    mem_free(g.block);
    view_case_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ref_all_parameters), cmocka_unit_test(test_ref_moments),
        cmocka_unit_test(test_ref_known),          cmocka_unit_test(test_ref_split_background),
        cmocka_unit_test(test_ref_saturated),      cmocka_unit_test(test_ref_outside),
        cmocka_unit_test(test_ref_needles),        cmocka_unit_test(test_ref_untouched),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
