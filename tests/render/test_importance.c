/* Importance sums of the last frame, against sums computed from pictures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/render_kit.h"

#include <math.h>
#include <string.h>

#include "core/layout.h"

enum { WIDTH = 53, HEIGHT = 37, PIXELS = WIDTH * HEIGHT, SUMS = 4 };
#define SUM_REL 2e-5 /* float sums of some thousand terms */

static const struct render_options options = {.aa = RENDER_AA_2D, .sh_degree = -1};

struct frame_sums {
    float transmittance[PIXELS];
    float *sums; /* [n][SUMS] */
};

static struct camera camera(void)
{
    const double eye[3] = {1.0, -7.0, 5.0}, target[3] = {0.2, 0.1, 0.0};
    return camera_look_at(eye, target, 0.9, WIDTH, HEIGHT);
}

typedef enum err_code (*sum_function)(struct render_importance *s, const struct render_model *m,
                                      cl_mem weight, const float **sums, struct err *e);

static struct frame_sums run_by(sum_function sum, const struct render_options *o,
                                const struct gauss *g, const float *weight)
{
    struct err e = {0};
    struct render_model m = {0};
    struct render_importance *s = NULL;
    struct frame_sums out;
    struct camera cam = camera();
    cl_mem weights = NULL;
    float rgb[PIXELS * 3];
    out.sums = mem_array(g->n * SUMS, sizeof(float));
    assert_non_null(out.sums);
    kit_ok(dev_buffer(&dev, PIXELS * sizeof(float), weight, &weights, &e), e);
    kit_ok(render_importance_open(render, &s, &e), e);
    kit_ok(render_model_upload(render, g, &m, &e), e);
    const float *sums;
    kit_fails(sum(s, &(struct render_model){.n = 12345}, weights, &sums, &e), ERR_ARG, e,
              "no frame");
    kit_ok(render_forward(render, &m, &cam, o, rgb, out.transmittance, &e), e);
    for (int again = 0; again < 2; again++) /* the first sums are given back by the second call */
        kit_ok(sum(s, &m, weights, &sums, &e), e);
    if (g->n)
        memcpy(out.sums, sums, g->n * SUMS * sizeof *sums);
    render_importance_close(&s);
    render_model_free(&m);
    dev_release(&weights);
    return out;
}

static struct frame_sums run(const struct gauss *g, const float *weight)
{
    return run_by(render_importance_run, &options, g, weight);
}

static void one_gaussian_is_counted_pixel_by_pixel(void **state)
{
    struct gauss g = {0};
    kit_gauss(3, 1, 1.0, 0, 0, &g);
    for (int k = 0; k < 3; k++) {
        g.mean_m[k] = 0.3f * (float)k;
        g.scale_log[k] = logf(0.3f + 0.2f * (float)k);
    }
    g.opacity_logit[0] = 1.0f;
    float weight[PIXELS];
    for (int i = 0; i < PIXELS; i++)
        weight[i] = (float)(i % 7);
    struct frame_sums f = run(&g, weight);
    double want[SUMS] = {0};
    for (int i = 0; i < PIXELS; i++) {
        double share = 1.0 - (double)f.transmittance[i];
        if (!(share > 0.0))
            continue;
        want[0] += share * (double)weight[i];
        want[1] += 1.0;
        want[2] += share;
    }
    assert_true(want[1] > 50.0 && want[1] < PIXELS);
    kit_near("sums of one Gaussian", f.sums, want, SUMS, 0.0, SUM_REL);
    mem_free(f.sums);
    gauss_free(&g);
}

static void shares_of_all_add_up_to_what_the_picture_lost(void **state)
{
    struct gauss g = {0};
    kit_gauss(5, 300, 3.0, 1, 0, &g);
    float weight[PIXELS];
    for (int i = 0; i < PIXELS; i++)
        weight[i] = 1.0f;
    struct frame_sums f = run(&g, weight);
    double lost = 0.0, shares = 0.0;
    for (int i = 0; i < PIXELS; i++)
        lost += 1.0 - (double)f.transmittance[i];
    size_t blended = 0;
    for (size_t i = 0; i < g.n; i++) {
        const float *s = f.sums + SUMS * i;
        assert_true(s[0] == s[2]); /* weight 1 */
        assert_true(s[2] <= s[1] && s[2] >= 0.0f);
        shares += (double)s[2];
        blended += s[1] > 0.0f;
    }
    assert_true(blended > 0 && blended <= render_last_stats(render)->visible);
    assert_true(fabs(shares - lost) < SUM_REL * lost);
    /* A single pixel that counts: only those that reach it have any weight. */
    float first[300];
    for (size_t i = 0; i < g.n; i++)
        first[i] = f.sums[SUMS * i + 1];
    mem_free(f.sums);
    memset(weight, 0, sizeof weight);
    weight[(HEIGHT / 2) * WIDTH + WIDTH / 2] = 2.0f;
    f = run(&g, weight);
    size_t reach = 0;
    shares = 0.0;
    for (size_t i = 0; i < g.n; i++) {
        const float *s = f.sums + SUMS * i;
        assert_true(s[0] >= 0.0f && s[0] <= 2.0f && s[1] == first[i]);
        reach += s[0] > 0.0f;
        shares += (double)s[0];
    }
    assert_true(reach > 0 && reach < blended);
    lost = 2.0 * (1.0 - (double)f.transmittance[(HEIGHT / 2) * WIDTH + WIDTH / 2]);
    assert_true(fabs(shares - lost) < SUM_REL * lost);
    mem_free(f.sums);
    gauss_free(&g);
}

static enum err_code share_sums(struct render_importance *s, const struct render_model *m,
                                cl_mem weight, const float **sums, struct err *e)
{
    (void)weight;
    return render_share_run(s, m, sums, e);
}

static void shares_are_asked_for(void **state)
{
    struct gauss g = {0};
    struct err e = {0};
    struct render_model m = {0};
    struct render_importance *s = NULL;
    struct camera cam = camera();
    struct render_options o = options;
    const float *sums;
    kit_gauss(7, 30, 3.0, 1, 0, &g);
    kit_ok(render_importance_open(render, &s, &e), e);
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, &o, NULL, NULL, &e), e);
    kit_fails(render_share_run(s, &m, &sums, &e), ERR_ARG, e, "without shares");
    o.shares = o.picture = true;
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e, "shares");
    render_importance_close(&s);
    render_model_free(&m);
    gauss_free(&g);
}

/* Both shapes of the kernels; the other sums of a Gaussian are those of importance, to the bit. */
static void shares_alone_are_the_same_shares(void **state)
{
    struct gauss g = {0};
    struct err e = {0};
    struct dev other = dev;
    struct render *own = render;
    struct render_options with_shares = options;
    float weight[PIXELS];
    with_shares.shares = true;
    kit_gauss(7, 300, 3.0, 1, 0, &g);
    for (size_t i = 0; i < g.n; i += 5)
        g.opacity_logit[i] = 10.0f; /* pixels that stop */
    for (int i = 0; i < PIXELS; i++)
        weight[i] = 1.0f;
    for (int shape = 0; shape < 2; shape++) {
        struct frame_sums all = run(&g, weight),
                          some = run_by(share_sums, &with_shares, &g, weight);
        size_t seen = 0;
        for (size_t i = 0; i < g.n * SUMS; i++) {
            const bool none = i % SUMS == 0;
            assert_true(some.sums[i] == (none ? 0.0f : all.sums[i]));
            seen += i % SUMS == 2 && some.sums[i] > 0.0f;
        }
        assert_true(seen > 100);
        mem_free(all.sums);
        mem_free(some.sums);
        if (shape)
            break;
        other.vector_width = dev.vector_width == 1 ? LAYOUT_LANES : 1;
        kit_ok(render_open(&other, &render, &e), e);
    }
    render_close(&render);
    render = own;
    gauss_free(&g);
}

/* A pixel near a threshold may fall on either side in the two shapes: that is one pixel, and at
 * most 1/255 of alpha. */
static void the_other_shape_of_the_kernels_gives_the_same_sums(void **state)
{
    struct gauss g = {0};
    struct err e = {0};
    struct dev other = dev;
    struct render *own = render;
    static const double one_pixel[SUMS] = {7.0 / 255.0, 1.0, 1.0 / 255.0, 0.0};
    float weight[PIXELS];
    size_t off = 0;
    kit_gauss(6, 300, 3.0, 1, 0, &g);
    for (size_t i = 0; i < g.n; i += 5)
        g.opacity_logit[i] = 10.0f; /* pixels that stop */
    for (int i = 0; i < PIXELS; i++)
        weight[i] = (float)(i % 7);
    struct frame_sums a = run(&g, weight);
    other.vector_width = dev.vector_width == 1 ? LAYOUT_LANES : 1;
    kit_ok(render_open(&other, &render, &e), e);
    struct frame_sums b = run(&g, weight);
    render_close(&render);
    render = own;
    for (size_t i = 0; i < g.n * SUMS; i++) {
        double d = fabs((double)a.sums[i] - (double)b.sums[i]);
        double rounding = SUM_REL * (fabs((double)a.sums[i]) + 1.0);
        assert_true(d <= rounding + one_pixel[i % SUMS]);
        off += d > rounding;
    }
    assert_true(off < g.n / 10);
    mem_free(a.sums);
    mem_free(b.sums);
    gauss_free(&g);
}

static void an_empty_view_gives_zeros(void **state)
{
    struct gauss g = {0};
    float weight[PIXELS] = {0};
    kit_gauss(5, 20, 1.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++)
        g.mean_m[3 * i + 2] += 100.0f; /* behind the camera */
    struct frame_sums f = run(&g, weight);
    for (size_t i = 0; i < g.n * SUMS; i++)
        assert_true(f.sums[i] == 0.0f);
    mem_free(f.sums);
    gauss_free(&g);
}

/* The reference draws the picture again in double, without the Gaussian. Pixels behind full
 * transmittance are not visited by the device, and have at most that much of the colour. */
static void check_removal(const struct render_options *o)
{
    struct err e = {0};
    struct gauss g = {0};
    struct camera cam = camera();
    float weight[PIXELS];
    double *all = mem_array((size_t)PIXELS * 3, sizeof *all),
           *less = mem_array((size_t)PIXELS * 3, sizeof *less);
    assert_true(all && less);
    kit_gauss(7, 120, 3.0, 1, 0, &g);
    for (size_t i = 0; i < g.n; i += 6)
        g.opacity_logit[i] = 4.0f;
    for (int i = 0; i < PIXELS; i++)
        weight[i] = (float)(i % 3);
    struct frame_sums f = run_by(render_removal_run, o, &g, weight);
    kit_ok(render_ref_forward(&g, &cam, o, all, NULL, &e), e);
    size_t counted = 0;
    for (size_t i = 0; i < g.n; i++) {
        const float *s = f.sums + SUMS * i, was = g.opacity_logit[i];
        double want = 0.0;
        g.opacity_logit[i] = -30.0f;
        kit_ok(render_ref_forward(&g, &cam, o, less, NULL, &e), e);
        g.opacity_logit[i] = was;
        for (size_t k = 0; k < (size_t)PIXELS * 3; k++)
            want += (double)weight[k / 3] * (all[k] - less[k]) * (all[k] - less[k]);
        kit_near("what a frame loses", s, &want, 1, 1e-6, 1e-3);
        counted += want > 1e-3;
        assert_true(s[3] == 0.0f);
    }
    assert_true(counted > g.n / 4);
    mem_free(f.sums);
    gauss_free(&g);
    mem_free(all);
    mem_free(less);
}

static void a_removal_changes_the_picture_as_predicted(void **state)
{
    uint8_t where[PIXELS];
    struct render_options o = options;
    check_removal(&o);
    for (int i = 0; i < PIXELS; i++)
        where[i] = i % WIDTH < WIDTH / 2;
    o.background[0] = 0.4f;
    o.background_where = where;
    o.background_there[1] = 0.9f;
    check_removal(&o);
}

static void the_other_shape_predicts_the_same(void **state)
{
    struct err e = {0};
    struct dev other = dev;
    struct render *own = render;
    struct render_options o = options;
    o.background[2] = 0.7f;
    other.vector_width = dev.vector_width == 1 ? LAYOUT_LANES : 1;
    kit_ok(render_open(&other, &render, &e), e);
    check_removal(&o);
    render_close(&render);
    render = own;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_gaussian_is_counted_pixel_by_pixel),
        cmocka_unit_test(shares_of_all_add_up_to_what_the_picture_lost),
        cmocka_unit_test(shares_are_asked_for),
        cmocka_unit_test(shares_alone_are_the_same_shares),
        cmocka_unit_test(the_other_shape_of_the_kernels_gives_the_same_sums),
        cmocka_unit_test(an_empty_view_gives_zeros),
        cmocka_unit_test(a_removal_changes_the_picture_as_predicted),
        cmocka_unit_test(the_other_shape_predicts_the_same),
    };
    return cmocka_run_group_tests_name("score", tests, render_kit_open, render_kit_close);
}
