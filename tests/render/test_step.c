/* One step of training: Adam against a plain version, what it repairs and drops, shapes at the
 * limits of float, and the statistics for densification.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/render_ref.h"
#include "tests/render/backward_kit.h"

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
 * 1e-6 again. Moments that are stored have 16 bits, but the step is that of moments that were not
 * rounded, so its tolerance is that of floats. */
#define ADAM_REL 2e-5
#define ADAM_ABS 2e-6
#define ADAM_MOMENT 4e-6 /* of the terms that a new moment is the sum of */

/* Moments of step t->adam.step against those of adam_plain, m [2][words], before they are rounded.
 * was [2][words]: those of the step before. m becomes what is stored. */
static void check_moments(const struct trainer *t, size_t words, const float *was, double *m,
                          struct moment_rounding *rounding)
{
    float *got = moments_read(t->adam.moments, words);
    for (size_t i = 0; i < 2 * words; i++) {
        const double beta = (double)(i < words ? t->adam.beta1 : t->adam.beta2),
                     old = beta * fabs((double)was[i]), term = fabs(m[i] - beta * (double)was[i]);
        if (i % words / 16 / t->m.planes * 16 + i % 16 >= t->m.n)
            assert_true(got[i] == was[i]); /* padding lanes are nobody's */
        else if (m[i] == (double)was[i])
            assert_true(got[i] == was[i]); /* planes that the frame did not draw */
        else if (!moment_rounds(rounding, got[i], m[i], ADAM_MOMENT * (old + term)))
            fail_msg("moment %zu is %g, not next to %g", i, (double)got[i], m[i]);
        assert_true(i < words || !signbit(got[i]));
        m[i] = (double)got[i];
    }
    mem_free(got);
}

/* Random ones from before, also of the Gaussians that nobody sees. */
static float *moments_before(const struct trainer *t, size_t words)
{
    float *m = mem_array(words, 2 * sizeof *m);
    assert_non_null(m);
    for (size_t i = 0; i < words; i++) {
        m[i] = (float)(1e-3 * rng_normal(1, 1, i));
        m[words + i] = (float)(1e-6 * (0.1 + rng_unit(1, 2, i)));
    }
    moments_write(t->adam.moments, m, m + words, words);
    mem_free(m);
    return moments_read(t->adam.moments, words);
}

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
    struct moment_rounding rounding = {0};
    size_t words = (size_t)t.m.groups * t.m.planes * 16,
           used = gauss_sh_count(sh_degree < 0 ? 2 : (uint32_t)sh_degree);
    double *v = mem_array(words, 3 * sizeof *v), *p = v, *m = v + words;
    float *start = floats_read(t.m.params, words), *raw = mem_array(words, sizeof *raw);
    cl_mem grads;
    assert_true(v && raw);
    float *was = moments_before(&t, words);
    for (size_t i = 0; i < words; i++)
        p[i] = (double)start[i];
    for (size_t i = 0; i < 2 * words; i++)
        m[i] = (double)was[i];
    kit_ok(dev_buffer(d, words * sizeof *raw, NULL, &grads, &e), e);
    if (with_extra) {
        for (size_t i = 0; i < (size_t)t.m.groups * 112; i++)
            raw[i] = (float)(0.01 * rng_normal(1, 3, i));
        kit_ok(dev_buffer(d, (size_t)t.m.groups * 112 * sizeof *raw, raw, &t.adam.extra_grad, &e),
               e);
    }
    for (t.adam.step = 0; t.adam.step < 4;) {
        float *extra = with_extra ? floats_read(t.adam.extra_grad, (size_t)t.m.groups * 112) : NULL;
        kernel_forward(t.r, &s, &t.m);
        d->vector_width = width ? width : own;
        kit_ok(render_backward(t.r, &t.m, grads, &e), e);
        float *g = floats_read(grads, words);
        const size_t first = 3, planes = 7; /* sizes and rotation */
        for (size_t i = 0; extra && i < words; i++) {
            size_t plane = i / 16 % t.m.planes;
            if (plane >= first && plane < first + planes)
                g[i] += extra[(i / 16 / t.m.planes * planes + plane - first) * 16 + i % 16];
        }
        t.adam.step++;
        kit_ok(render_backward_step(t.r, &t.m, &t.adam, &t.stats, &e), e);
        d->vector_width = own;
        adam_plain(&t.adam, g, t.m.groups, t.m.planes, used, p, m, m + words);
        float *got = floats_read(t.m.params, words);
        for (size_t i = 0; i < words; i++) /* padding lanes are nobody's */
            if (i / 16 / t.m.planes * 16 + i % 16 >= t.m.n)
                p[i] = (double)got[i];
        kit_near("parameters", got, p, words, ADAM_ABS, ADAM_REL);
        check_moments(&t, words, was, m, &rounding);
        for (size_t i = 0; i < words; i++) /* then follow the kernel's rounding */
            p[i] = (double)got[i];
        for (size_t i = 0; i < 2 * words; i++)
            was[i] = (float)m[i];
        mem_free(got);
        mem_free(g);
        mem_free(extra);
    }
    moment_rounding_check(&rounding, 1000);
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
    mem_free(was);
    mem_free(v);
    dev_release(&grads);
    trainer_free(&t);
    view_case_free(&s);
}

static void test_step_is_adam(void **state)
{
    check_adam(false, -1, 0);
    check_adam(true, -1, 0);
    check_adam(false, 1, 0);
    check_adam(true, -1, 1); /* as a GPU has it */
}

/* ---- how moments are stored ---- */

enum { COAST = 400, COAST_EXACT = 20, COAST_GAUSSIANS = 203 };
/* Each step moves a moment by less than half of a 16-bit step in the mean of squares, so after 400
 * of them single ones are a few hundredths off, and the mean of thousands is right. */
#define COAST_BIAS 0.003
#define COAST_SPREAD_LEAST 0.01
#define COAST_SPREAD_MOST 0.09

static uint32_t bits_of(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* render/adam.cl, said once more. */
static uint32_t word_plain(uint32_t step, uint32_t row, uint32_t plane, float first, float second)
{
    uint32_t x = row ^ step * 0x9e3779b9u;
    x = (x ^ x >> 16) * 0x7feb352du;
    x = (x ^ x >> 15) * 0x846ca68bu;
    x = (x ^ x >> 16) + plane * 0x9e3779b9u;
    return ((bits_of(first) + (x >> 16)) & 0xffff0000u) | (bits_of(second) + (x & 0xffff)) >> 16;
}

static void words_read(const struct trainer *t, uint32_t *out, size_t n)
{
    struct err e = {0};
    kit_ok(dev_read(dev_get(), t->adam.moments, 0, n * sizeof *out, out, &e), e);
}

/* Mean and spread of moments as shares of what they should be. */
static void check_coasted(const char *what, const float *was, const float *is, size_t n,
                          double factor)
{
    double sum = 0.0, squares = 0.0, count = 0.0;
    for (size_t i = 0; i < n; i++) {
        if (was[i] == 0.0f) {
            assert_true(is[i] == 0.0f);
            continue;
        }
        double share = (double)is[i] / ((double)was[i] * factor);
        sum += share;
        squares += share * share;
        count++;
    }
    const double mean = sum / count, spread = sqrt(squares / count - mean * mean);
    kit_figure("moments", "%s after %d steps: %.4f of the exact, spread %.4f", what, COAST, mean,
               spread);
    assert_true(count > 5000.0 && fabs(mean - 1.0) < COAST_BIAS);
    assert_true(spread > COAST_SPREAD_LEAST && spread < COAST_SPREAD_MOST);
}

/* Steps without gradient: moments fall as they should in the mean, although a step takes less from
 * the second than 16 bits can hold. Their bits are those of the plain code, for both widths. */
static void check_coast(uint32_t width)
{
    struct view_case s = view_case_make(37, COAST_GAUSSIANS, RENDER_AA_2D, 2);
    struct dev *d = dev_get();
    const uint32_t own = d->vector_width;
    s.cam.trans[2] = -1e4; /* everything is behind it */
    struct trainer t = trainer_make(&s.g);
    const size_t words = (size_t)t.m.groups * t.m.planes * 16;
    float *start = moments_before(&t, words);
    for (size_t i = 0; i < words; i += 7)
        start[i] = start[words + i] = 0.0f;
    for (size_t i = 0; i < words; i++)
        if (i / 16 / t.m.planes * 16 + i % 16 >= t.m.n)
            start[i] = start[words + i] = 0.0f;
    moments_write(t.adam.moments, start, start + words, words);
    uint32_t *is = mem_array(words, 2 * sizeof *is), *want = is + words;
    assert_non_null(is);
    words_read(&t, want, words);
    for (int k = 0; k < (width ? COAST_EXACT : COAST); k++) {
        struct err e = {0};
        kernel_forward(t.r, &s, &t.m); /* whose kernels have the device's own width */
        t.adam.step++;
        d->vector_width = width ? width : own;
        kit_ok(render_backward_step(t.r, &t.m, &t.adam, &t.stats, &e), e);
        d->vector_width = own;
        for (size_t i = 0; k < COAST_EXACT && i < words; i++) {
            const uint32_t row = (uint32_t)(i / 16 / t.m.planes * 16 + i % 16), high = want[i],
                           low = want[i] << 16;
            float first, second;
            memcpy(&first, &(uint32_t){high & 0xffff0000u}, sizeof first);
            memcpy(&second, &low, sizeof second);
            want[i] = word_plain(t.adam.step, row, (uint32_t)(i / 16 % t.m.planes),
                                 t.adam.beta1 * first, t.adam.beta2 * second);
        }
        if (k < COAST_EXACT) {
            words_read(&t, is, words);
            assert_memory_equal(is, want, words * sizeof *is);
        }
    }
    if (!width) {
        float *end = moments_read(t.adam.moments, words);
        check_coasted("first moments", start, end, words, pow((double)t.adam.beta1, COAST));
        check_coasted("second moments", start + words, end + words, words,
                      pow((double)t.adam.beta2, COAST));
        mem_free(end);
    }
    mem_free(is);
    mem_free(start);
    trainer_free(&t);
    view_case_free(&s);
}

static void test_moments_fall_as_they_should(void **state)
{
    check_coast(0);
    check_coast(1);
}

/* F1: what must never be in a model is repaired, and counted. */
static void test_repairs(void **state)
{
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
        cmocka_unit_test(test_step_is_adam),
        cmocka_unit_test(test_repairs),
        cmocka_unit_test(test_moments_fall_as_they_should),
        cmocka_unit_test(test_dropped_updates),
        cmocka_unit_test(test_wild_shapes),
        cmocka_unit_test(test_density_statistics),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
