/* Effects of single Gaussians on a frame: F2 (any shape stays finite), F3 (a camera inside the
 * cloud), F24 (millions of intersections, and Gaussians behind the camera), F26 (kernel shapes
 * agree).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/frame.h"
#include "render/render_ref.h"
#include "tests/render/backward_kit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* ---- F2 ---- */

enum { SHAPES = 1000000, SHAPE_BATCH = 100000 };

/* Any size from 1e-6 m to 55 m on each axis, needles of 1e6 : 1 among them, any rotation, opacities
 * to the ends of float, places inside and far outside the view. */
static void wild(struct gauss *g, uint64_t batch)
{
    for (size_t i = 0; i < g->n; i++) {
        uint64_t at = batch * SHAPE_BATCH + i;
        for (size_t a = 0; a < 3; a++) {
            g->scale_log[3 * i + a] =
                (float)(-14 + (at % 64 ? 12 : 18) * rng_unit(35, a, at)); /* few cover all */
            g->mean_m[3 * i + a] =
                (float)(exp(2 * rng_normal(35, 9, at)) * (2 * rng_unit(35, 10 + a, at) - 1));
        }
        if (at % 16 == 0)
            for (size_t a = 0; a < 3; a++)
                g->scale_log[3 * i + a] = a ? (float)log(1e-6) : 0.0f;
        g->opacity_logit[i] = (float)(8 * rng_normal(35, 4, at) - 6);
    }
}

static size_t bad_values(const float *v, size_t n)
{
    size_t bad = 0;
    for (size_t i = 0; i < n; i++)
        bad += !isfinite(v[i]);
    return bad;
}

static void a_million_shapes_stay_finite(void **state)
{
    struct err e = {0};
    struct gauss out = {0};
    size_t bad = 0, moved = 0;
    for (uint64_t batch = 0; batch < SHAPES / SHAPE_BATCH; batch++) {
        struct view_case s = view_case_make(34 + batch, SHAPE_BATCH, RENDER_AA_2D, 0);
        cl_mem grads;
        wild(&s.g, batch);
        struct trainer t = trainer_make(&s.g);
        if (!out.n)
            gauss_like(&s.g, &out);
        kernel_forward(t.r, &s, &t.m);
        float *rgb = floats_read(render_color_buffer(t.r), (size_t)PX_W * PX_H * 3);
        bad += bad_values(rgb, (size_t)PX_W * PX_H * 3);
        mem_free(rgb);
        kit_ok(dev_buffer(dev_get(), (size_t)t.m.groups * t.m.planes * 64, NULL, &grads, &e), e);
        kit_ok(render_backward(t.r, &t.m, grads, &e), e);
        planes_read(&t.m, grads, &out);
        bad += bad_values(out.mean_m, 3 * out.n) + bad_values(out.scale_log, 3 * out.n) +
               bad_values(out.quat_wxyz, 4 * out.n) + bad_values(out.opacity_logit, out.n);
        for (size_t i = 0; i < out.n; i++)
            moved += out.opacity_logit[i] != 0.0f;
        dev_release(&grads);
        trainer_step(&t, &s);
        planes_read(&t.m, t.m.params, &out);
        bad += gauss_count_bad(&out, NULL) + trainer_repaired(&t);
        trainer_free(&t);
        view_case_free(&s);
    }
    gauss_free(&out);
    kit_figure("F2", "shapes=%d not_finite=%zu limit=0 with_gradient=%zu", SHAPES, bad, moved);
    assert_int_equal(bad, 0);
    assert_true(moved > 1000); /* enough of them were looked at */
}

/* ---- F3 ---- */

#define F3_COST 5.0    /* of a frame, in medians */
#define F3_GRAD 1000.0 /* of a gradient's norm, in medians */
enum { CLOUD = 20000, CLOUD_VIEWS = 24, CLOUD_W = 320, CLOUD_H = 240 };
#define CLOUD_HALF_M 10.0

static int by_value(const void *a, const void *b)
{
    const double *x = a, *y = b;
    return *x < *y ? -1 : *x > *y;
}

static double median(const double *v, size_t n)
{
    double sorted[CLOUD_VIEWS];
    memcpy(sorted, v, n * sizeof *v);
    qsort(sorted, n, sizeof *sorted, by_value);
    return sorted[n / 2];
}

/* Views 0 .. n-1: around the cloud, or from places inside it. */
static struct camera cloud_camera(size_t i, bool inside)
{
    double angle = 2.399963 * (double)i, eye[3], target[3] = {0, 0, 0};
    for (size_t k = 0; k < 3; k++)
        eye[k] = 0.8 * CLOUD_HALF_M * (2 * rng_unit(51, k, i) - 1);
    if (!inside) {
        eye[0] = 2.5 * CLOUD_HALF_M * cos(angle);
        eye[1] = 2.5 * CLOUD_HALF_M * sin(angle);
        eye[2] = CLOUD_HALF_M;
    } else {
        for (size_t k = 0; k < 3; k++)
            target[k] = eye[k] + rng_normal(51, 3 + k, i);
    }
    return camera_look_at(eye, target, 1.0, CLOUD_W, CLOUD_H);
}

struct cloud_frame {
    double pairs, ms, grad;
};

static struct cloud_frame cloud_frame(struct trainer *t, struct view_case *s, cl_mem grads,
                                      struct gauss *out)
{
    struct err e = {0};
    struct cloud_frame f = {.ms = HUGE_VAL};
    for (int k = 0; k < 3; k++) {
        clock_t from = clock(); /* of the processor: others may be at work */
        kernel_forward(t->r, s, &t->m);
        f.ms = fmin(f.ms, 1e3 * (double)(clock() - from) / CLOCKS_PER_SEC);
    }
    f.pairs = (double)render_last_stats(t->r)->intersections;
    kit_ok(render_backward(t->r, &t->m, grads, &e), e);
    planes_read(&t->m, grads, out);
    for (size_t i = 0; i < 3 * out->n; i++)
        f.grad += (double)out->mean_m[i] * (double)out->mean_m[i] +
                  (double)out->scale_log[i] * (double)out->scale_log[i];
    f.grad = sqrt(f.grad);
    return f;
}

static void a_camera_inside_the_cloud_is_no_catastrophe(void **state)
{
    struct err e = {0};
    struct view_case s = {.o = {.aa = RENDER_AA_2D, .sh_degree = -1}};
    struct gauss out = {0};
    cl_mem grads;
    double pairs[2][CLOUD_VIEWS], ms[2][CLOUD_VIEWS], grad[2][CLOUD_VIEWS];
    double worst_ms = 0.0, worst_pairs = 0.0, worst_grad = 0.0;
    kit_gauss(50, CLOUD, CLOUD_HALF_M, 0, 0, &s.g);
    s.rgb_grad = grad_make((size_t)CLOUD_W * CLOUD_H * 3, 50);
    s.cam = cloud_camera(0, false);
    struct trainer t = trainer_make(&s.g);
    gauss_like(&s.g, &out);
    kit_ok(dev_buffer(dev_get(), (size_t)t.m.groups * t.m.planes * 64, NULL, &grads, &e), e);
    for (int in = 0; in < 2; in++)
        for (size_t i = 0; i < CLOUD_VIEWS; i++) {
            s.cam = cloud_camera(i, in);
            struct cloud_frame f = cloud_frame(&t, &s, grads, &out);
            pairs[in][i] = f.pairs;
            ms[in][i] = f.ms;
            grad[in][i] = f.grad;
            assert_true(isfinite(f.grad));
        }
    for (size_t i = 0; i < CLOUD_VIEWS; i++) {
        worst_pairs = fmax(worst_pairs, pairs[1][i] / median(pairs[0], CLOUD_VIEWS));
        worst_ms = fmax(worst_ms, ms[1][i] / median(ms[0], CLOUD_VIEWS));
        worst_grad = fmax(worst_grad, grad[1][i] / median(grad[0], CLOUD_VIEWS));
    }
    kit_figure("F3", "worst_pairs=%.2f limit=%.1f worst_time=%.2f worst_gradient=%.1f limit=%.0f",
               worst_pairs, F3_COST, worst_ms, worst_grad, F3_GRAD);
    assert_true(worst_pairs < F3_COST && worst_ms < F3_COST);
    assert_true(worst_grad < F3_GRAD);
    dev_release(&grads);
    gauss_free(&out);
    trainer_free(&t);
    view_case_free(&s);
}

/* ---- F24 ---- */

/* Splats that each cover much of the picture, opacity a little above the 1/255 that counts, half of
 * them behind the camera. `want` pairs at least, or the test fails. */
static void many_intersections(size_t n, uint32_t width, uint32_t height, uint64_t want,
                               size_t samples)
{
    struct err e = {0};
    struct gauss g = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    struct ref_view v;
    struct ref_splat *splats = NULL;
    size_t n_splats = 0;
    const double eye[3] = {0, 0, 0}, target[3] = {0, 1, 0};
    struct camera cam = camera_look_at(eye, target, 0.9, width, height);
    struct render_options o = {.aa = RENDER_AA_NONE, .sh_degree = -1, .background = {0, 1, 0}};
    float *rgb = mem_array((size_t)width * height * 3, sizeof *rgb);
    assert_non_null(rgb);
    kit_gauss(70, n, 1.0, 0, 0, &g);
    for (size_t i = 0; i < n; i++) {
        double side = i % 2 ? 1.0 : -1.0;
        g.mean_m[3 * i + 1] = (float)(side * (20.0 + 10.0 * rng_unit(71, 0, i)));
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] = (float)log(20.0 + 10.0 * rng_unit(71, 1, i));
        double opacity = 0.006 + 0.004 * rng_unit(71, 2, i);
        g.opacity_logit[i] = (float)log(opacity / (1.0 - opacity));
    }
    kit_ok(render_open(dev_get(), &r, &e), e); /* fresh: every buffer has to grow to its size */
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    r->intersection_max = want / 2;
    kit_fails(render_forward(r, &m, &cam, &o, rgb, NULL, &e), ERR_LIMIT, e, "intersections");
    r->intersection_max = UINT64_MAX;
    kit_ok(render_forward(r, &m, &cam, &o, rgb, NULL, &e), e);
    uint64_t pairs = render_last_stats(r)->intersections;
    kit_ok(ref_view_init(&g, &cam, &o, &v, &e), e);
    kit_ok(ref_project_all(&v, &g, &splats, &n_splats, &e), e);
    double worst = 0.0;
    for (uint64_t k = 0; k < samples; k++) {
        size_t at = (size_t)(rng_unit(72, 0, k) * (double)width * height);
        double t = 1.0, sum[3] = {0, 0, 0}, d[2], alpha;
        bool clamped;
        for (size_t i = 0; i < n_splats && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            if (!ref_alpha(&splats[i], (double)(at % width) + 0.5, (double)(at / width) + 0.5, d,
                           &alpha, &clamped))
                continue;
            for (size_t c = 0; c < 3; c++)
                sum[c] += splats[i].rgb[c] * alpha * t;
            t *= 1 - alpha;
        }
        for (size_t c = 0; c < 3; c++)
            worst = fmax(worst, fabs(sum[c] + t * v.background[c] - (double)rgb[3 * at + c]));
    }
    kit_figure("F24", "pairs=%llu splats=%zu max_difference=%.6f limit=%.6f pixels=%zu",
               (unsigned long long)pairs, n_splats, worst, 1.0 / 255, samples);
    assert_true(pairs >= want);
    assert_int_equal(render_last_stats(r)->visible, n_splats);
    assert_true(n_splats <= n / 2);
    assert_true(worst <= 1.0 / 255);
    mem_free(splats);
    mem_free(rgb);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
}

static void a_frame_of_a_million_intersections_is_brute_force(void **state)
{
    many_intersections(8000, 320, 240, 1000000, 300);
}

/* In the long run only: 2 GB. */
static void a_frame_of_fifty_million_intersections_is_brute_force(void **state)
{
    many_intersections(14000, 1920, 1080, 50000000, 300);
}

/* ---- F26 ---- */

#define F26_REL 1e-5 /* of the norm of each part: kernels in CPU and in GPU shape */

static struct gauss gradients_at_width(uint32_t width, const struct view_case *s)
{
    struct err e = {0};
    struct dev *d = dev_get();
    uint32_t keep = d->vector_width;
    struct render *r = NULL;
    struct render_model m = {0};
    struct gauss out = {0};
    cl_mem grads;
    d->vector_width = width ? width : keep;
    kit_ok(render_open(d, &r, &e), e);
    kernel_forward(r, s, &m);
    kit_ok(dev_buffer(d, (size_t)m.groups * m.planes * 64, NULL, &grads, &e), e);
    kit_ok(render_backward(r, &m, grads, &e), e);
    gauss_like(&s->g, &out);
    planes_read(&m, grads, &out);
    dev_release(&grads);
    render_model_free(&m);
    render_close(&r);
    d->vector_width = keep;
    return out;
}

static void kernels_of_both_shapes_agree_and_repeat(void **state)
{
    struct view_case s = view_case_make(80, 400, RENDER_AA_2D, 2);
    (void)clear_ambiguous(&s);
    struct gauss a = gradients_at_width(0, &s), b = gradients_at_width(0, &s),
                 c = gradients_at_width(1, &s);
    const size_t per_row[5] = {3, 3, 4, 1, 27};
    double worst = 0.0;
    for (size_t part = 0; part < 5; part++) {
        const float *x = part_of(&a, part), *y = part_of(&b, part), *z = part_of(&c, part);
        size_t n = per_row[part] * s.g.n;
        double diff = 0.0, norm = 0.0;
        assert_memory_equal(x, y, n * sizeof *x);
        for (size_t i = 0; i < n; i++) {
            diff += ((double)x[i] - (double)z[i]) * ((double)x[i] - (double)z[i]);
            norm += (double)x[i] * (double)x[i];
        }
        worst = fmax(worst, sqrt(diff / norm));
    }
    kit_figure("F26", "repeat=bit-equal shapes_relative=%.1e limit=%.0e", worst, F26_REL);
    assert_true(worst <= F26_REL);
    gauss_free(&a);
    gauss_free(&b);
    gauss_free(&c);
    view_case_free(&s);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest usual[] = {
        cmocka_unit_test(a_million_shapes_stay_finite),
        cmocka_unit_test(a_camera_inside_the_cloud_is_no_catastrophe),
        cmocka_unit_test(a_frame_of_a_million_intersections_is_brute_force),
        cmocka_unit_test(kernels_of_both_shapes_agree_and_repeat),
    };
    const struct CMUnitTest large[] = {
        cmocka_unit_test(a_frame_of_fifty_million_intersections_is_brute_force),
    };
    int failed = argc > 1 && !strcmp(argv[1], "large")
                     ? cmocka_run_group_tests_name("shapes, large", large, NULL, NULL)
                     : cmocka_run_group_tests_name("shapes", usual, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
