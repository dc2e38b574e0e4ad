/* Deferred steps: what a view lists is all that it shows, what groups are owed is what single steps
 * of Adam would have made, and a state goes on with the same bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/math/sort.h"
#include "render/defer.h"
#include "tests/render/backward_kit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { GAUSSIANS = 6011, TURNS = 12 };

/* Small Gaussians all around the camera, in the order of a curve, as training keeps them. */
static struct view_case around(uint64_t seed)
{
    struct view_case s = view_case_make(seed, GAUSSIANS, RENDER_AA_2D, 1);
    struct err e = {0};
    uint32_t *order = mem_array(GAUSSIANS, sizeof *order);
    float *mean = mem_array(3 * GAUSSIANS, sizeof *mean);
    double center[3];
    assert_true(order && mean);
    camera_center(&s.cam, center);
    for (size_t i = 0; i < GAUSSIANS; i++)
        for (size_t a = 0; a < 3; a++) {
            mean[3 * i + a] = (float)(center[a] + 3.0 * rng_normal(seed, 40 + a, i));
            s.g.scale_log[3 * i + a] -= 1.5f;
        }
    struct gauss shape = {.n = GAUSSIANS, .mean_m = mean};
    kit_ok(gauss_morton_order(&shape, order, &e), e);
    for (size_t i = 0; i < GAUSSIANS; i++)
        memcpy(s.g.mean_m + 3 * i, mean + 3 * (size_t)order[i], 3 * sizeof *mean);
    mem_free(order);
    mem_free(mean);
    return s;
}

/* The camera, turned about the world's z axis. */
static struct camera turned(const struct camera *c, double angle)
{
    struct camera out = *c;
    double center[3], k = cos(angle), s = sin(angle);
    camera_center(c, center);
    for (size_t i = 0; i < 3; i++) {
        const double *row = c->rot + 3 * i;
        out.rot[3 * i] = k * row[0] + s * row[1];
        out.rot[3 * i + 1] = k * row[1] - s * row[0];
    }
    for (size_t i = 0; i < 3; i++)
        out.trans[i] = -(out.rot[3 * i] * center[0] + out.rot[3 * i + 1] * center[1] +
                         out.rot[3 * i + 2] * center[2]);
    return out;
}

/* A step of the listed groups. check: its picture has the bits of a picture of all. Returns the
 * share of groups that were listed. */
static double step_listed(struct trainer *t, struct defer *d, const struct view_case *s,
                          uint32_t width, bool check)
{
    struct err e = {0};
    struct render_model seen;
    struct dev *dev = dev_get();
    uint32_t own = dev->vector_width;
    size_t bytes = (size_t)PX_W * PX_H * 3 * sizeof(float);
    float *all = mem_array(1, bytes), *listed = mem_array(1, bytes), *grad;
    assert_true(all && listed);
    dev->vector_width = width ? width : own;
    kit_ok(defer_see(d, &t->m, &t->adam, &s->cam, &s->o, &seen, &e), e);
    dev->vector_width = own;
    if (check)
        kit_ok(render_forward(t->r, &t->m, &s->cam, &s->o, all, NULL, &e), e);
    kit_ok(render_forward(t->r, &seen, &s->cam, &s->o, listed, NULL, &e), e);
    assert_true(!check || !memcmp(all, listed, bytes));
    grad = mem_array(1, bytes);
    assert_non_null(grad);
    for (size_t i = 0; i < bytes / sizeof(float); i++)
        grad[i] = (float)s->rgb_grad[i];
    kit_ok(render_set_color_grad(t->r, grad, &e), e);
    t->adam.step++;
    kit_ok(render_backward_step(t->r, &seen, &t->adam, &t->stats, &e), e);
    kit_ok(defer_stepped(d, &t->adam, &e), e);
    mem_free(all);
    mem_free(listed);
    mem_free(grad);
    return (double)seen.groups / t->m.groups;
}

/* Steps on all sides. Means move by up to a third of a group's size between two looks at it. */
static void check_listed(uint32_t width)
{
    struct err e = {0};
    struct view_case s = around(51);
    const struct camera first = s.cam;
    struct trainer t = trainer_make(&s.g);
    struct defer *d;
    struct dev *dev = dev_get();
    uint32_t own = dev->vector_width;
    double most = 0.0, sum = 0.0;
    dev->vector_width = width ? width : own;
    kit_ok(defer_open(t.r, &d, &e), e);
    dev->vector_width = own;
    t.adam.lr_mean = 2e-2f;
    for (uint32_t i = 0; i < 3 * TURNS; i++) {
        s.cam = turned(&first, 2.0 * 3.14159265 * (i * 5 % TURNS) / TURNS);
        double share = step_listed(&t, d, &s, width, true);
        most = fmax(most, share);
        sum += share;
    }
    kit_figure("defer", "groups listed: mean %.2f, most %.2f", sum / (3 * TURNS), most);
    assert_true(sum / (3 * TURNS) < 0.6); /* or nothing is saved */
    assert_int_equal(trainer_repaired(&t), 0);
    defer_close(&d);
    trainer_free(&t);
    view_case_free(&s);
}

static void test_lists_what_shows(void **state)
{
    check_listed(0);
    check_listed(1); /* as a GPU has it */
}

/* ---- what is owed ---- */

static size_t rate_of(size_t plane)
{
    return plane < 3 ? 0 : plane < 6 ? 1 : plane < 10 ? 2 : plane < 11 ? 3 : plane < 14 ? 4 : 5;
}

static float lr_mean_at(uint32_t step)
{
    return 2e-2f * expf(-0.003f * (float)step);
}

/* Single steps with gradient 0, by the book and in double. */
static void plain_steps(struct render_adam a, uint32_t to, size_t words, size_t planes, double *p,
                        double *m1, double *m2)
{
    double b1 = (double)a.beta1, b2 = (double)a.beta2;
    for (a.step++; a.step <= to; a.step++) {
        const float lr[6] = {lr_mean_at(a.step), a.lr_scale, a.lr_quat,
                             a.lr_opacity,       a.lr_sh_dc, a.lr_sh_rest};
        double bias1 = 1 - pow(b1, a.step), bias2 = 1 - pow(b2, a.step);
        for (size_t i = 0; i < words; i++) {
            size_t plane = i / 16 % planes;
            m1[i] *= b1;
            m2[i] *= b2;
            p[i] -= (double)lr[rate_of(plane)] * (m1[i] / bias1) /
                    (sqrt(m2[i] / bias2) + (double)a.eps);
            if (plane >= 3 && plane < 6)
                p[i] = fmin(fmax(p[i], (double)a.scale_log_min), (double)a.scale_log_max);
        }
    }
}

/* Roundings of floats: of W, of the powers and of one addition. The plain loop rounds nothing. */
#define OWED_ABS 1e-7
#define OWED_REL 1e-6

/* Random moments, as after many steps. Every seventh is of one that never had a gradient. Returns
 * what is stored of them, [2][words]. */
static float *owed_moments(struct trainer *t, size_t words)
{
    float *raw = mem_array(words, 2 * sizeof *raw);
    assert_non_null(raw);
    for (size_t i = 0; i < words; i++) {
        bool real = i / 16 / t->m.planes * 16 + i % 16 < t->m.n && i % 7;
        raw[i] = real ? (float)(1e-3 * rng_normal(53, 1, i)) : 0.0f;
        raw[words + i] = real ? (float)(1e-6 * (0.1 + rng_unit(53, 2, i))) : 0.0f;
    }
    moments_write(t->adam.moments, raw, raw + words, words);
    mem_free(raw);
    return moments_read(t->adam.moments, words);
}

/* Moments that fell in one go are next to what single steps leave that round nothing. The first
 * group, which has made its steps one by one, and padding lanes are nobody's. A power of beta that
 * is nothing to a float may be 0. */
static void check_fallen(const struct trainer *t, size_t words, const double *want,
                         struct moment_rounding *rounding)
{
    float *got = moments_read(t->adam.moments, words);
    for (size_t i = 0; i < 2 * words; i++) {
        const size_t group = i % words / 16 / t->m.planes, row = group * 16 + i % 16;
        if (group && row < t->m.n &&
            !moment_rounds(rounding, got[i], want[i], OWED_REL * fabs(want[i]) + 1.2e-38))
            fail_msg("moment %zu is %g, not next to %g", i, (double)got[i], want[i]);
    }
    mem_free(got);
}

/* From step `from`, k steps in which only the first group is in view. */
static void check_owed(uint32_t from, uint32_t k, uint32_t width)
{
    struct err e = {0};
    struct view_case s = around(52);
    struct trainer t = trainer_make(&s.g);
    struct dev *dev = dev_get();
    uint32_t own = dev->vector_width;
    size_t planes = t.m.planes, words = (size_t)t.m.groups * planes * 16, moved = 0;
    double *v = mem_array(words, 3 * sizeof *v), *p = v, *m1 = v + words, *m2 = m1 + words;
    float *raw = owed_moments(&t, words), *start = floats_read(t.m.params, words);
    struct moment_rounding rounding = {0};
    struct render_model seen;
    struct defer *d;
    assert_non_null(v);
    for (size_t i = 0; i < words; i++) {
        p[i] = (double)start[i];
        m1[i] = (double)raw[i];
        m2[i] = (double)raw[words + i];
    }
    s.cam.trans[2] = -1e4;        /* everything is behind it */
    t.adam.scale_log_min = -4.3f; /* where the smallest are: momentum takes some beyond */
    t.adam.step = from;
    t.adam.lr_mean = lr_mean_at(from);
    plain_steps(t.adam, from + k, words, planes, p, m1, m2);
    dev->vector_width = width ? width : own;
    kit_ok(defer_open(t.r, &d, &e), e);
    assert_false(defer_owes(d));
    for (uint32_t i = 0; i < k; i++) {
        kit_ok(defer_see(d, &t.m, &t.adam, &s.cam, &s.o, &seen, &e), e);
        assert_int_equal(seen.groups, 1);
        assert_true(defer_owes(d));
        t.adam.step++;
        t.adam.lr_mean = lr_mean_at(t.adam.step);
        kit_ok(defer_stepped(d, &t.adam, &e), e);
    }
    kit_ok(defer_settle(d, &t.m, &t.adam, &e), e);
    assert_false(defer_owes(d));
    dev->vector_width = own;
    float *got = floats_read(t.m.params, words);
    for (size_t i = 0; i < words; i++) { /* the first group, and padding lanes, are nobody's */
        if (i / 16 / planes == 0 || i / 16 / planes * 16 + i % 16 >= t.m.n)
            p[i] = (double)got[i];
        moved += got[i] != start[i];
    }
    kit_near("parameters", got, p, words, OWED_ABS, OWED_REL);
    check_fallen(&t, words, m1, &rounding);
    moment_rounding_check(&rounding, 1000);
    mem_free(got);
    assert_true(moved > words / 2);
    defer_close(&d);
    mem_free(start);
    mem_free(raw);
    mem_free(v);
    trainer_free(&t);
    view_case_free(&s);
}

static void test_owed_is_single_steps(void **state)
{
    check_owed(1, 1, 0);
    check_owed(1, 40, 0);
    check_owed(5, 300, 0);
    check_owed(700, 1100, 0); /* the table grows, and the horizon is passed */
    check_owed(1, 40, 1);     /* as a GPU has it */
}

/* After k steps with another view, a step of this one: with `settle`, all make the steps that they
 * are owed before, not only the listed in passing. Returns parameters, first and second moments. */
static float *look_back(uint32_t k, bool settle, size_t *words)
{
    struct err e = {0};
    struct view_case s = around(55);
    const struct camera first = s.cam, back = turned(&first, 3.14159265);
    struct trainer t = trainer_make(&s.g);
    struct defer *d;
    kit_ok(defer_open(t.r, &d, &e), e);
    for (uint32_t i = 0; i < 3 + k; i++) {
        s.cam = i < 3 ? first : back;
        (void)step_listed(&t, d, &s, 0, false);
    }
    if (settle)
        kit_ok(defer_settle(d, &t.m, &t.adam, &e), e);
    s.cam = first;
    (void)step_listed(&t, d, &s, 0, false);
    kit_ok(defer_settle(d, &t.m, &t.adam, &e), e);
    *words = (size_t)t.m.groups * t.m.planes * 16;
    float *out = mem_array(*words, 3 * sizeof *out);
    float *moments = moments_read(t.adam.moments, *words);
    assert_non_null(out);
    kit_ok(dev_read(dev_get(), t.m.params, 0, *words * sizeof *out, out, &e), e);
    memcpy(out + *words, moments, 2 * *words * sizeof *out);
    mem_free(moments);
    defer_close(&d);
    trainer_free(&t);
    view_case_free(&s);
    return out;
}

/* What is settled in between is rounded once more: a parameter differs by what that changes in a
 * step, and moments become larger as often as smaller. Powers of beta that are forgotten or come
 * twice would make them all larger or smaller: 0.999^9 is 0.991, a step of 16 bits and more. */
#define PASSING_STEP 2e-3 /* the largest rate is 0.05 */

static void test_listed_make_what_they_are_owed(void **state)
{
    size_t words = 0, same = 0;
    float *passing = look_back(9, false, &words), *settled = look_back(9, true, &words);
    double *want = mem_array(words, sizeof *want), larger[2] = {0.0}, n[2] = {0.0};
    assert_non_null(want);
    for (size_t i = 0; i < words; i++)
        want[i] = (double)settled[i];
    kit_near("parameters", passing, want, words, PASSING_STEP, OWED_REL);
    for (size_t i = 0; i < 3 * words; i++) {
        const double by = fabs((double)passing[i]) - fabs((double)settled[i]);
        same += passing[i] == settled[i];
        if (i >= words && by != 0.0) {
            larger[i / words - 1] += by > 0.0 ? 1.0 : -1.0;
            n[i / words - 1]++;
        }
    }
    assert_true(same > words); /* of the listed: the same bits */
    for (size_t k = 0; k < 2; k++) {
        kit_figure("passing", "moments of %.0f differ, larger less smaller: %.0f", n[k], larger[k]);
        assert_true(n[k] > 1000.0 && fabs(larger[k]) < 5.0 * sqrt(n[k]));
    }
    mem_free(passing);
    mem_free(settled);
    mem_free(want);
}

/* ---- frames that are only drawn ---- */

/* The frame of a look, and its sums of each Gaussian, have the bits of a frame of all. Returns the
 * share of groups that it shows. */
static double check_look(struct trainer *t, struct defer *d, const struct view_case *s,
                         struct render_importance *of)
{
    struct err e = {0};
    struct render_model seen;
    size_t bytes = (size_t)PX_W * PX_H * 3 * sizeof(float), n = t->m.n, shown = 0;
    float *all = mem_array(1, bytes), *some = mem_array(1, bytes);
    float *want = mem_array(n, LAYOUT_IMPORTANCE_SUMS * sizeof *want);
    const float *sums;
    cl_mem weight = NULL;
    assert_true(all && some && want);
    kit_ok(dev_buffer(dev_get(), bytes / 3, all, &weight, &e), e); /* zeros */
    kit_ok(render_forward(t->r, &t->m, &s->cam, &s->o, all, NULL, &e), e);
    kit_ok(render_importance_run(of, &t->m, weight, &sums, &e), e);
    memcpy(want, sums, n * LAYOUT_IMPORTANCE_SUMS * sizeof *want);
    kit_ok(defer_look(d, &t->m, &t->adam, &s->cam, &s->o, &seen, &e), e);
    assert_false(defer_owes(d));
    kit_ok(render_forward(t->r, &seen, &s->cam, &s->o, some, NULL, &e), e);
    assert_memory_equal(all, some, bytes);
    kit_ok(render_importance_run(of, &seen, weight, &sums, &e), e);
    uint32_t *groups = mem_array(seen.groups, sizeof *groups);
    assert_non_null(groups);
    kit_ok(dev_read(dev_get(), seen.list, 0, seen.groups * sizeof *groups, groups, &e), e);
    for (size_t i = 0; i < seen.n; i++) {
        float *own = want + LAYOUT_IMPORTANCE_SUMS *
                                (groups[i / LAYOUT_LANES] * LAYOUT_LANES + i % LAYOUT_LANES);
        shown += own[LAYOUT_IMPORTANCE_PIXELS] > 0.0f;
        assert_memory_equal(sums + LAYOUT_IMPORTANCE_SUMS * i, own,
                            LAYOUT_IMPORTANCE_SUMS * sizeof *own);
        memset(own, 0, LAYOUT_IMPORTANCE_SUMS * sizeof *own);
    }
    for (size_t i = 0; i < LAYOUT_IMPORTANCE_SUMS * n; i++)
        assert_true(want[i] == 0.0f); /* what is not listed shows nothing */
    assert_true(shown > 0);
    mem_free(groups);
    mem_free(all);
    mem_free(some);
    mem_free(want);
    dev_release(&weight);
    return (double)seen.groups / t->m.groups;
}

/* Looks between steps. */
static void test_looks_show_all_there_is(void **state)
{
    struct err e = {0};
    struct view_case s = around(56);
    const struct camera first = s.cam;
    struct trainer t = trainer_make(&s.g);
    struct defer *d;
    struct render_importance *of;
    double sum = 0.0;
    kit_ok(defer_open(t.r, &d, &e), e);
    kit_ok(render_importance_open(t.r, &of, &e), e);
    for (uint32_t i = 0; i < TURNS; i++) {
        s.cam = turned(&first, 2.0 * 3.14159265 * (i * 5 % TURNS) / TURNS);
        sum += check_look(&t, d, &s, of); /* the first looks at what has made no step */
        for (uint32_t k = 0; k < 3; k++)
            (void)step_listed(&t, d, &s, 0, false);
        kit_ok(defer_settle(d, &t.m, &t.adam, &e), e);
        sum += check_look(&t, d, &s, of);
    }
    assert_true(sum / (2 * TURNS) < 0.6);
    /* Fewer rows are those that are known; what has moved is not. */
    t.m.n -= 5 * LAYOUT_LANES + 3;
    t.m.groups = (t.m.n + LAYOUT_LANES - 1) / LAYOUT_LANES;
    (void)check_look(&t, d, &s, of);
    float *params = floats_read(t.m.params, (size_t)t.m.groups * t.m.planes * LAYOUT_LANES);
    for (size_t i = 0; i < t.m.n; i++) /* to the other side */
        for (size_t k = 0; k < 2; k++)
            params[layout_at(i, t.m.planes) + k * LAYOUT_LANES] *= -1.0f;
    kit_ok(dev_write(dev_get(), t.m.params, 0,
                     (size_t)t.m.groups * t.m.planes * LAYOUT_LANES * sizeof *params, params, &e),
           e);
    defer_moved(d);
    (void)check_look(&t, d, &s, of);
    mem_free(params);
    render_importance_close(&of);
    defer_close(&d);
    trainer_free(&t);
    view_case_free(&s);
}

/* ---- states ---- */

/* What is owed after `done` steps is saved, closed, and read again. */
static void go_on(struct trainer *t, struct defer **d, uint32_t done)
{
    struct err e = {0};
    cl_mem at;
    uint32_t from;
    kit_ok(defer_save(*d, &t->m, &t->adam, &at, &e), e);
    uint32_t *settled = mem_array(t->m.groups, sizeof *settled);
    assert_non_null(settled);
    kit_ok(dev_read(dev_get(), at, 0, t->m.groups * sizeof *settled, settled, &e), e);
    defer_close(d);
    kit_ok(defer_open(t->r, d, &e), e);
    kit_ok(defer_restore(*d, &t->m, settled, &from, &e), e);
    assert_true(from < done);
    for (t->adam.step = from; t->adam.step <= done; t->adam.step++) {
        t->adam.lr_mean = lr_mean_at(t->adam.step);
        kit_ok(defer_stepped(*d, &t->adam, &e), e);
    }
    t->adam.step = done;
    mem_free(settled);
}

/* Steps 1 to `n` in pieces, saved after `save` of them (0: never). Returns the parameters. */
static float *in_pieces(uint32_t n, uint32_t save, size_t *words)
{
    struct err e = {0};
    struct view_case s = around(54);
    const struct camera first = s.cam;
    struct trainer t = trainer_make(&s.g);
    struct defer *d;
    kit_ok(defer_open(t.r, &d, &e), e);
    for (uint32_t i = 0; i < n; i++) {
        if (i == save && save)
            go_on(&t, &d, i);
        s.cam = turned(&first, 2.0 * 3.14159265 * (i * 5 % TURNS) / TURNS);
        t.adam.lr_mean = lr_mean_at(i + 1);
        (void)step_listed(&t, d, &s, 0, false);
    }
    kit_ok(defer_settle(d, &t.m, &t.adam, &e), e);
    *words = (size_t)t.m.groups * t.m.planes * 16;
    float *out = floats_read(t.m.params, *words);
    defer_close(&d);
    trainer_free(&t);
    view_case_free(&s);
    return out;
}

static void test_goes_on_with_the_same_bytes(void **state)
{
    size_t words = 0;
    float *whole = in_pieces(30, 0, &words), *parts = in_pieces(30, 17, &words),
          *again = in_pieces(30, 1, &words);
    assert_memory_equal(whole, parts, words * sizeof *whole);
    assert_memory_equal(whole, again, words * sizeof *whole);
    mem_free(whole);
    mem_free(parts);
    mem_free(again);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_lists_what_shows),
        cmocka_unit_test(test_owed_is_single_steps),
        cmocka_unit_test(test_listed_make_what_they_are_owed),
        cmocka_unit_test(test_looks_show_all_there_is),
        cmocka_unit_test(test_goes_on_with_the_same_bytes),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
