/* One step of training: Adam against a plain version, what it repairs and drops, shapes at the
 * limits of float, and the statistics for densification.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/render_ref.h"
#include "tests/backward_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double lr_of(const struct render_adam *a, size_t plane)
{
    const float lr[6] = {a->lr_mean,    a->lr_scale, a->lr_quat,
                         a->lr_opacity, a->lr_sh_dc, a->lr_sh_rest};
    return (double)lr[plane < 3    ? 0
                      : plane < 6  ? 1
                      : plane < 10 ? 2
                      : plane < 11 ? 3
                      : plane < 14 ? 4
                                   : 5];
}

/* Adam by the book, over the planes of `used` coefficients. */
static void adam_plain(const struct render_adam *a, const float *grads, size_t groups,
                       size_t planes, size_t used, double *p, double *m1, double *m2)
{
    double b1 = (double)a->beta1, b2 = (double)a->beta2;
    for (size_t i = 0; i < groups * planes * 16; i++) {
        size_t plane = i / 16 % planes;
        double g = (double)grads[i];
        if (plane >= 11 + 3 * used)
            continue;
        m1[i] = b1 * m1[i] + (1 - b1) * g;
        m2[i] = b2 * m2[i] + (1 - b2) * g * g;
        double h1 = m1[i] / (1 - pow(b1, a->step)), h2 = m2[i] / (1 - pow(b2, a->step));
        p[i] -= lr_of(a, plane) * h1 / (sqrt(h2) + (double)a->eps);
        if (plane >= 3 && plane < 6)
            p[i] = fmin(fmax(p[i], (double)a->scale_log_min), (double)a->scale_log_max);
    }
}

/* float Adam against double: a rounding of 1e-7 in p and a few in the moments a step; where |g| is
 * far below what it was, m1 / sqrt(m2) keeps 1e-6. The unfused gradients come from another kernel:
 * 1e-6 again. */
#define ADAM_REL 2e-5
#define ADAM_ABS 2e-6

static void check_adam(bool with_extra, int sh_degree, uint32_t width)
{
    uint32_t own = dev_get()->vector_width;
    struct view_case s = view_case_make(31, 75, RENDER_AA_2D, 2);
    struct err e = {0};
    struct dev *d = dev_get();
    for (size_t i = 16; i < 36; i++) /* a whole group and more behind the camera */
        for (size_t a = 0; a < 3; a++)
            s.g.mean_m[3 * i + a] -= (float)(9 * s.cam.rot[6 + a]);
    s.o.sh_degree = sh_degree;
    struct trainer t = trainer_make(&s.g);
    size_t words = (size_t)t.m.groups * t.m.planes * 16,
           used = gauss_sh_count(sh_degree < 0 ? 2 : (uint32_t)sh_degree);
    double *v = mem_array(words, 3 * sizeof *v), *p = v, *m1 = v + words, *m2 = m1 + words;
    float *start = floats_read(t.m.params, words), *raw = mem_array(words, sizeof *raw);
    cl_mem grads;
    assert_true(v && raw);
    for (size_t i = 0; i < words;
         i++) { /* moments from before, also of the Gaussians that nobody sees */
        p[i] = (double)start[i];
        m1[i] = (double)(float)(1e-3 * rng_normal(1, 1, i));
        raw[i] = (float)m1[i];
    }
    kit_ok(dev_write(d, t.adam.m1, 0, words * sizeof *raw, raw, &e), e);
    for (size_t i = 0; i < words; i++) {
        m2[i] = (double)(float)(1e-6 * (0.1 + rng_unit(1, 2, i)));
        raw[i] = (float)m2[i];
    }
    kit_ok(dev_write(d, t.adam.m2, 0, words * sizeof *raw, raw, &e), e);
    kit_ok(dev_buffer(d, words * sizeof *raw, NULL, &grads, &e), e);
    if (with_extra) {
        for (size_t i = 0; i < (size_t)t.m.groups * 176; i++)
            raw[i] = (float)(0.01 * rng_normal(1, 3, i));
        kit_ok(dev_buffer(d, (size_t)t.m.groups * 176 * sizeof *raw, raw, &t.adam.extra_grad, &e),
               e);
    }
    for (t.adam.step = 0; t.adam.step < 4;) {
        float *extra = with_extra ? floats_read(t.adam.extra_grad, (size_t)t.m.groups * 176) : NULL;
        kernel_forward(t.r, &s, &t.m);
        d->vector_width = width ? width : own;
        kit_ok(render_backward(t.r, &t.m, grads, &e), e);
        float *g = floats_read(grads, words);
        t.adam.extra_shape = t.adam.step >= 2; /* the same floats as seven planes a group */
        size_t first = t.adam.extra_shape ? 3 : 0, planes = t.adam.extra_shape ? 7 : 11;
        for (size_t i = 0; extra && i < words; i++) {
            size_t plane = i / 16 % t.m.planes;
            if (plane >= first && plane < first + planes)
                g[i] += extra[(i / 16 / t.m.planes * planes + plane - first) * 16 + i % 16];
        }
        t.adam.step++;
        kit_ok(render_backward_step(t.r, &t.m, &t.adam, &t.stats, &e), e);
        d->vector_width = own;
        adam_plain(&t.adam, g, t.m.groups, t.m.planes, used, p, m1, m2);
        float *const got[3] = {floats_read(t.m.params, words), floats_read(t.adam.m1, words),
                               floats_read(t.adam.m2, words)};
        double *const want[3] = {p, m1, m2};
        static const char *const names[3] = {"parameters", "first moments", "second moments"};
        for (size_t k = 0; k < 3; k++) {
            for (size_t i = 0; i < words;
                 i++) { /* padding lanes are nobody's; then follow the kernel's rounding */
                if (i / 16 / t.m.planes * 16 + i % 16 >= t.m.n)
                    want[k][i] = (double)got[k][i];
            }
            kit_near(names[k], got[k], want[k], words, ADAM_ABS, ADAM_REL);
            for (size_t i = 0; i < words; i++)
                want[k][i] = (double)got[k][i];
            mem_free(got[k]);
        }
        mem_free(g);
        mem_free(extra);
    }
    float *end = floats_read(t.m.params, words);
    size_t moved = 0;
    for (size_t i = 0; i < words; i++) {
        size_t plane = i / 16 % t.m.planes, row = i / 16 / t.m.planes * 16 + i % 16;
        if (plane >= 11 + 3 * used || row >= t.m.n)
            assert_true(end[i] == start[i]);
        else
            moved += end[i] != start[i] && row >= 16 && row < 32;
    }
    assert_true(moved > 100); /* the unseen coast on their momentum */
    assert_int_equal(trainer_repaired(&t), 0);
    mem_free(end);
    mem_free(start);
    mem_free(raw);
    mem_free(v);
    dev_release(&grads);
    trainer_free(&t);
    view_case_free(&s);
}

static void test_step_is_adam(void **state)
{
    (void)state;
    check_adam(false, -1, 0);
    check_adam(true, -1, 0);
    check_adam(false, 1, 0);
    check_adam(true, -1, 1); /* as a GPU has it */
}

/* F1: what must never be in a model is repaired, and counted. */
static void test_repairs(void **state)
{
    (void)state;
    struct view_case s = view_case_make(32, 40, RENDER_AA_2D, 1);
    struct gauss out = {0};
    for (size_t a = 0; a < 4; a++) {
        s.g.quat_wxyz[4 * 3 + a] = 0.0f;
        s.g.quat_wxyz[4 * 7 + a] = a == 2 ? NAN : 0.5f;
        s.g.quat_wxyz[4 * 20 + a] = 1e-30f;
        s.g.quat_wxyz[4 * 21 + a] = a == 0 ? INFINITY : 0.0f;
    }
    struct trainer t = trainer_make(&s.g);
    trainer_step(&t, &s);
    assert_int_equal(trainer_repaired(&t), 4);
    gauss_like(&s.g, &out);
    planes_read(&t.m, t.m.params, &out);
    assert_int_equal(gauss_count_bad(&out, NULL), 0);
    static const size_t rows[] = {3, 7, 20, 21};
    for (size_t i = 0; i < 4; i++)
        assert_true(out.quat_wxyz[4 * rows[i]] == 1.0f && out.quat_wxyz[4 * rows[i] + 3] == 0.0f);
    trainer_step(&t, &s);
    assert_int_equal(trainer_repaired(&t), 4); /* once is enough */
    kit_figure("F1", "injected=4 repaired=%u bad_after=0", trainer_repaired(&t));
    gauss_free(&out);
    trainer_free(&t);
    view_case_free(&s);
}

/* A gradient that is not finite: those Gaussians stay as they are, the others move. */
static void test_dropped_updates(void **state)
{
    (void)state;
    struct view_case s = view_case_make(33, 48, RENDER_AA_2D, 1);
    s.rgb_grad[3 * (PX_W * 10 + 20)] = (double)NAN;
    s.rgb_grad[3 * (PX_W * 20 + 9) + 1] = (double)INFINITY;
    struct trainer t = trainer_make(&s.g);
    struct gauss out = {0};
    trainer_step(&t, &s);
    gauss_like(&s.g, &out);
    planes_read(&t.m, t.m.params, &out);
    assert_int_equal(gauss_count_bad(&out, NULL), 0);
    size_t kept = 0;
    for (size_t i = 0; i < s.g.n; i++)
        kept += !memcmp(out.mean_m + 3 * i, s.g.mean_m + 3 * i, 12) &&
                out.opacity_logit[i] == s.g.opacity_logit[i];
    uint32_t dropped = trainer_repaired(&t);
    assert_true(dropped > 0 && dropped < s.g.n && dropped <= kept && kept < s.g.n);
    gauss_free(&out);
    trainer_free(&t);
    view_case_free(&s);
}

/* F2: anything that Adam and densification can bring about stays finite, forwards and backwards. */
static void test_wild_shapes(void **state)
{
    (void)state;
    const size_t n = 20000;
    struct view_case s = view_case_make(34, n, RENDER_AA_2D, 0);
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < 3; a++) {
            s.g.scale_log[3 * i + a] =
                (float)(-14 + 18 * rng_unit(35, a, i)); /* 1e-6 m to 55 m: ratios to 6e7 */
            s.g.mean_m[3 * i + a] *= (float)exp(3 * rng_normal(35, 9, i));
        }
        s.g.opacity_logit[i] = (float)(8 * rng_normal(35, 4, i));
    }
    struct trainer t = trainer_make(&s.g);
    struct gauss out = {0};
    gauss_like(&s.g, &out);
    for (int k = 0; k < 3; k++) {
        struct err e = {0};
        cl_mem grads;
        kernel_forward(t.r, &s, &t.m);
        float *rgb = floats_read(render_color_buffer(t.r), (size_t)PX_W * PX_H * 3);
        for (size_t i = 0; i < (size_t)PX_W * PX_H * 3; i++)
            assert_true(isfinite(rgb[i]));
        mem_free(rgb);
        kit_ok(dev_buffer(dev_get(), (size_t)t.m.groups * t.m.planes * 64, NULL, &grads, &e), e);
        kit_ok(render_backward(t.r, &t.m, grads, &e), e);
        planes_read(&t.m, grads, &out);
        for (size_t i = 0; i < 4 * n; i++)
            assert_true(isfinite(out.quat_wxyz[i]) && isfinite(out.mean_m[i % (3 * n)]) &&
                        isfinite(out.scale_log[i % (3 * n)]) && isfinite(out.opacity_logit[i % n]));
        dev_release(&grads);
        trainer_step(&t, &s);
        planes_read(&t.m, t.m.params, &out);
        assert_int_equal(gauss_count_bad(&out, NULL), 0);
        for (size_t i = 0; i < 3 * n; i++)
            assert_true(out.scale_log[i] >= t.adam.scale_log_min &&
                        out.scale_log[i] <= t.adam.scale_log_max);
    }
    assert_int_equal(trainer_repaired(&t), 0);
    gauss_free(&out);
    trainer_free(&t);
    view_case_free(&s);
}

/* ---- densification statistics ---- */

/* Per pixel sum_c g_c C_c of splats as they are given. */
static void composite(const struct view_case *s, const struct ref_view *v,
                      const struct ref_splat *splats, size_t n, double *out)
{
    for (size_t at = 0; at < (size_t)PX_W * PX_H; at++) {
        double t = 1, d[2], alpha;
        bool clamped;
        out[at] = 0;
        for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            if (!ref_alpha(&splats[i], (double)(at % PX_W) + 0.5, (double)(at / PX_W) + 0.5, d,
                           &alpha, &clamped))
                continue;
            for (size_t c = 0; c < 3; c++)
                out[at] += splats[i].rgb[c] * alpha * t * s->rgb_grad[3 * at + c];
            t *= 1 - alpha;
        }
        for (size_t c = 0; c < 3; c++)
            out[at] += t * v->background[c] * s->rgb_grad[3 * at + c];
    }
}

/* Moving one splat on the screen by 1e-6 px either way gives its gradient in every pixel. */
#define STAT_STEP 1e-6
#define STAT_REL 1e-4

static void test_density_statistics(void **state)
{
    (void)state;
    struct view_case s = view_case_make(36, 20, RENDER_AA_2D, 0);
    struct ref_view v;
    struct ref_splat *splats;
    size_t n;
    struct err e = {0};
    double *up = mem_array((size_t)PX_W * PX_H, 2 * sizeof *up), *down = up + (size_t)PX_W * PX_H;
    double want[4][20] = {{0}};
    assert_non_null(up);
    (void)clear_ambiguous(&s);
    kit_ok(ref_view_init(&s.g, &s.cam, &s.o, &v, &e), e);
    kit_ok(ref_project_all(&v, &s.g, &splats, &n, &e), e);
    for (size_t i = 0; i < n; i++) {
        double g[2] = {0}, a[2] = {0};
        for (size_t k = 0; k < 2; k++) {
            double keep = splats[i].mean_px[k];
            splats[i].mean_px[k] = keep + STAT_STEP;
            composite(&s, &v, splats, n, up);
            splats[i].mean_px[k] = keep - STAT_STEP;
            composite(&s, &v, splats, n, down);
            splats[i].mean_px[k] = keep;
            for (size_t at = 0; at < (size_t)PX_W * PX_H; at++) {
                double d = (up[at] - down[at]) / (2 * STAT_STEP);
                g[k] += d;
                a[k] += fabs(d);
            }
        }
        size_t row = splats[i].index;
        want[0][row] = 3 * hypot(PX_W / 2 * g[0], PX_H / 2 * g[1]);
        want[1][row] = 2 * hypot(PX_W / 2 * a[0], PX_H / 2 * a[1]);
        want[2][row] = 3;
        want[3][row] = fmax(splats[i].half_px[0], splats[i].half_px[1]);
    }
    struct trainer t = trainer_make(&s.g);
    t.adam.lr_mean = t.adam.lr_scale = t.adam.lr_quat = t.adam.lr_opacity = t.adam.lr_sh_dc = 0;
    trainer_step(&t, &s);
    trainer_step(&t, &s); /* the same again: sums grow, the radius does not */
    cl_mem absg = t.stats.absg;
    t.stats.absg = NULL; /* and once without moduli */
    trainer_step(&t, &s);
    t.stats.absg = absg;
    const cl_mem mems[4] = {t.stats.grad, t.stats.absg, t.stats.count, t.stats.radius};
    static const char *const names[4] = {"gradient", "absolute gradient", "count", "radius"};
    for (size_t k = 0; k < 4; k++) {
        float *got = floats_read(mems[k], 20);
        kit_near(names[k], got, want[k], 20, STAT_REL * rms(want[k], 20), STAT_REL);
        mem_free(got);
    }
    trainer_free(&t);
    mem_free(splats);
    mem_free(up);
    view_case_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_step_is_adam),       cmocka_unit_test(test_repairs),
        cmocka_unit_test(test_dropped_updates),    cmocka_unit_test(test_wild_shapes),
        cmocka_unit_test(test_density_statistics),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
