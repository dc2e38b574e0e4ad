/* dL/d(pose) of a photograph: the double reference against differences of moved and turned cameras,
 * the kernel against the reference in both its shapes, and that nobody's steps change for it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/render_ref.h"
#include "tests/backward_kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define FD_REL 1e-6
#define KERNEL_REL 1e-4 /* sums over all Gaussians, relative to the length of each half */

/* The camera with its centre moved by p[0..2] and turned by p[3..5]. */
static struct camera moved(const struct camera *cam, const double p[6])
{
    struct camera c = *cam;
    double eye[3], len = sqrt(p[3] * p[3] + p[4] * p[4] + p[5] * p[5]), half = 0.5 * len, turn[9];
    const double s = len > 0.0 ? sin(half) / len : 0.5,
                 q[4] = {cos(half), s * p[3], s * p[4], s * p[5]};
    camera_quat_to_rot(q, turn);
    camera_center(cam, eye);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            c.rot[3 * i + j] = 0.0;
            for (int k = 0; k < 3; k++)
                c.rot[3 * i + j] += cam->rot[3 * i + k] * turn[3 * k + j];
        }
    for (int i = 0; i < 3; i++) {
        c.trans[i] = 0.0;
        for (int k = 0; k < 3; k++)
            c.trans[i] -= c.rot[3 * i + k] * (eye[k] + p[k]);
    }
    return c;
}

/* Fourth-order differences; false when every step changes a decision of the picture. */
static bool differentiate(struct view_case *s, int axis, const double *rgb, double *out)
{
    static const double at[4] = {-2, -1, 1, 2};
    const struct camera keep = s->cam;
    uint64_t here, sig;
    (void)view_case_objective(s, rgb, &here);
    for (int bits = 12; bits <= 17; bits++) {
        const double h = ldexp(1, -bits);
        double f[4];
        bool same = true;
        for (int k = 0; k < 4 && same; k++) {
            double p[6] = {0};
            p[axis] = at[k] * h;
            s->cam = moved(&keep, p);
            f[k] = view_case_objective(s, rgb, &sig);
            same = sig == here;
        }
        s->cam = keep;
        if (same) {
            *out = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h);
            return true;
        }
    }
    return false;
}

/* Of the reference. */
static void gradient_of(const struct view_case *s, double out[6])
{
    struct grads g = grads_make(&s->g);
    struct err e = {0};
    kit_ok(render_ref_backward(&s->g, &s->cam, &s->o, s->rgb_grad, &g.r, &e), e);
    render_ref_pose_grad(&s->g, &s->cam, &g.r, out);
    mem_free(g.block);
}

/* A model whose origin is elsewhere and quaternions that are not of length 1. */
static void displace(struct view_case *s)
{
    for (size_t k = 0; k < 3; k++) {
        s->g.origin_enu_m[k] = 0.25 * (double)(k + 1);
        for (size_t j = 0; j < 3; j++)
            s->cam.trans[j] -= s->cam.rot[3 * j + k] * s->g.origin_enu_m[k];
    }
    for (size_t i = 0; i < 4 * s->g.n; i++)
        s->g.quat_wxyz[i] *= 1.0f + 0.25f * (float)(i / 4 % 3);
}

static void test_reference(void **state)
{
    (void)state;
    size_t skipped = 0, all = 0;
    for (uint64_t seed = 300; seed < 312; seed++) {
        static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
        struct view_case s = view_case_make(seed, 6, modes[seed % 3], (uint32_t)(seed % 4));
        double want[6], fd[6], *rgb = view_case_colors(&s);
        displace(&s);
        gradient_of(&s, want);
        for (int k = 0; k < 6; k++, all++)
            if (!differentiate(&s, k, rgb, &fd[k])) {
                fd[k] = want[k];
                skipped++;
            }
        kit_near_d("centre", want, fd, 3, FD_REL * rms(fd, 3), FD_REL);
        kit_near_d("turn", want + 3, fd + 3, 3, FD_REL * rms(fd + 3, 3), FD_REL);
        mem_free(rgb);
        view_case_free(&s);
    }
    print_message("%zu of %zu could not be differentiated\n", skipped, all);
    assert_true(skipped * 3 < all);
}

static void check_kernel(struct view_case *s, uint32_t width, const char *what)
{
    uint32_t own = dev_get()->vector_width;
    double want[6], got[6];
    float gotf[6];
    struct err e = {0};
    (void)clear_ambiguous(s);
    gradient_of(s, want);
    struct trainer t = trainer_make(&s->g);
    t.adam.pose_grad = got;
    t.adam.step = 1;
    kernel_forward(t.r, s, &t.m);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = render_backward_step(t.r, &t.m, &t.adam, &t.stats, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    for (int k = 0; k < 6; k++)
        gotf[k] = (float)got[k];
    kit_near(what, gotf, want, 3, KERNEL_REL * rms(want, 3), KERNEL_REL);
    kit_near(what, gotf + 3, want + 3, 3, KERNEL_REL * rms(want + 3, 3), KERNEL_REL);
    trainer_free(&t);
}

static void test_kernels(void **state)
{
    (void)state;
    for (uint32_t width = 0; width < 2; width++) {
        struct view_case s = view_case_make(320, 3000, RENDER_AA_2D, 3);
        displace(&s);
        check_kernel(&s, width, "3000 Gaussians");
        view_case_free(&s);
        s = view_case_needles(RENDER_AA_2D);
        check_kernel(&s, width, "needles");
        view_case_free(&s);
        s = view_case_outside(RENDER_AA_2D);
        check_kernel(&s, width, "outside");
        view_case_free(&s);
    }
}

/* Asking for it changes nothing else; what is not finite is left out as it is from the step. */
static void test_beside_the_step(void **state)
{
    (void)state;
    struct view_case s = view_case_make(330, 48, RENDER_AA_2D, 1);
    double pose[6];
    struct trainer a = trainer_make(&s.g), b = trainer_make(&s.g);
    s.rgb_grad[3 * (PX_W * 10 + 20)] = (double)NAN;
    b.adam.pose_grad = pose;
    size_t n = (size_t)a.m.groups * a.m.planes * LAYOUT_LANES;
    for (int k = 0; k < 3; k++) {
        trainer_step(&a, &s);
        trainer_step(&b, &s);
        for (int i = 0; i < 6; i++)
            assert_true(isfinite(pose[i]));
    }
    float *pa = floats_read(a.m.params, n), *pb = floats_read(b.m.params, n);
    assert_memory_equal(pa, pb, n * sizeof *pa);
    mem_free(pa);
    mem_free(pb);
    trainer_free(&a);
    trainer_free(&b);
    view_case_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_reference),
        cmocka_unit_test(test_kernels),
        cmocka_unit_test(test_beside_the_step),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
