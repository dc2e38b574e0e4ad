/* The smoothness loss on appearance embeddings and its search for neighbours, against brute force,
 * the definition written out, and finite differences.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/math/knn.h"
#include "tests/kit.h"
#include "train/loss/embed_smoothness.h"
#include "train/loss/photometric.h"

#include <math.h>
#include <string.h>

/* ---- neighbours ---- */

static void neighbours_are_exact(void **state)
{
    enum { N = 700, K = 16 };
    static float xyz[3 * N];
    struct knn t;
    struct err e = {0};
    for (size_t i = 0; i < 3 * N; i++) /* on a coarse grid: many equal distances and places */
        xyz[i] = floorf((float)(6.0 * rng_unit(61, 1, i)));
    kit_ok(knn_build(xyz, N, &t, &e), e);
    for (uint32_t i = 0; i < N; i++) {
        uint32_t ids[K];
        float dist2[K];
        uint32_t skip = i % 2 ? i : KNN_NOBODY;
        assert_int_equal(knn_find(&t, xyz + 3 * i, skip, K, ids, dist2), K);
        bool taken[N] = {false};
        for (size_t k = 0; k < K; k++) { /* the k-th by brute force, lower ids first */
            uint32_t best = KNN_NOBODY;
            float least = INFINITY;
            for (uint32_t j = 0; j < N; j++) {
                float d = 0.0f;
                for (size_t a = 0; a < 3; a++)
                    d += (xyz[3 * j + a] - xyz[3 * i + a]) * (xyz[3 * j + a] - xyz[3 * i + a]);
                if (j != skip && !taken[j] && d < least) {
                    least = d;
                    best = j;
                }
            }
            taken[best] = true;
            assert_int_equal(ids[k], best);
            assert_true(dist2[k] == least);
        }
    }
    knn_free(&t);
    kit_ok(knn_build(xyz, 3, &t, &e), e); /* fewer than asked for */
    uint32_t ids[K];
    float dist2[K];
    assert_int_equal(knn_find(&t, xyz, 0, K, ids, dist2), 2);
    knn_free(&t);
}

/* ---- smoothness of embeddings ---- */

enum { ALIKE = 60, ALIKE_LEN = 5, EMBED_GROUP = 16 * ALIKE_LEN /* an array without gaps */ };

struct alike {
    float mean_m[3 * ALIKE], embed[ALIKE * ALIKE_LEN];
    struct embed_smoothness_input in;
};

/* The gradient in pieces of seven rows, which divides nothing here. */
static enum err_code loss_now(const struct embed_smoothness_input *in, double *loss, float *grad,
                              struct err *e)
{
    struct embed_smoothness *w = NULL;
    enum err_code rc = embed_smoothness_open(in, &w, loss, e);
    for (size_t i = 0; !rc && i < in->n; i += 7)
        embed_smoothness_rows(w, i, in->n - i < 7 ? in->n - i : 7, grad + i * in->len);
    embed_smoothness_close(&w);
    return rc;
}

static void alike_make(struct alike *s, size_t samples)
{
    for (size_t i = 0; i < 3 * ALIKE; i++)
        s->mean_m[i] = (float)(10.0 * rng_unit(71, 1, i));
    for (size_t i = 0; i < ALIKE * ALIKE_LEN; i++) /* on a grid: steps are exact */
        s->embed[i] = (float)(round(4096.0 * rng_normal(71, 2, i)) / 4096.0);
    s->in = (struct embed_smoothness_input){.mean_m = s->mean_m,
                                            .embed = s->embed,
                                            .embed_group = EMBED_GROUP,
                                            .embed_lane = ALIKE_LEN,
                                            .embed_next = 1,
                                            .n = ALIKE,
                                            .len = ALIKE_LEN,
                                            .samples = samples,
                                            .neighbours = 16,
                                            .falloff = 0.05,
                                            .weight = 0.2,
                                            .seed = 3,
                                            .stream = 4};
}

/* The definition, pair by pair: all Gaussians are samples. */
static double alike_by_definition(const struct alike *s)
{
    double sum = 0.0;
    for (size_t i = 0; i < ALIKE; i++) {
        double d2[ALIKE];
        size_t order[ALIKE];
        for (size_t j = 0; j < ALIKE; j++) {
            size_t at = j;
            d2[j] = 0.0;
            for (size_t c = 0; c < 3; c++) {
                double d = (double)s->mean_m[3 * j + c] - (double)s->mean_m[3 * i + c];
                d2[j] += d * d;
            }
            for (; at > 0 && d2[order[at - 1]] > d2[j]; at--)
                order[at] = order[at - 1];
            order[at] = j;
        }
        for (size_t b = 1; b < 16; b++)
            for (size_t a = 0; a < b; a++) {
                const float *x = s->embed + order[a] * ALIKE_LEN,
                            *y = s->embed + order[b] * ALIKE_LEN;
                double xy = 0.0, xx = 0.0, yy = 0.0;
                for (size_t c = 0; c < ALIKE_LEN; c++) {
                    xy += (double)x[c] * (double)y[c];
                    xx += (double)x[c] * (double)x[c];
                    yy += (double)y[c] * (double)y[c];
                }
                sum += exp(-0.05 * d2[order[b]]) * (1.0 - xy / sqrt(xx * yy));
            }
    }
    return 0.2 * sum / (ALIKE * 120.0);
}

static void embed_smoothness_is_its_definition_and_derivative(void **state)
{
    static struct alike s;
    static float grad[ALIKE * ALIKE_LEN], none[ALIKE * ALIKE_LEN];
    static double fd[ALIKE * ALIKE_LEN];
    struct err e = {0};
    double loss;
    alike_make(&s, 20480);
    kit_ok(loss_now(&s.in, &loss, grad, &e), e);
    double want = alike_by_definition(&s);
    assert_true(fabs(loss - want) < 1e-6 * want);
    for (int part = 0; part < 2; part++) { /* all, then a draw of 20 */
        s.in.samples = part ? 20 : 20480;
        kit_ok(loss_now(&s.in, &loss, grad, &e), e);
        for (size_t i = 0; i < ALIKE * ALIKE_LEN; i++) {
            const float keep = s.embed[i];
            double f[4], h = ldexp(1, -11);
            for (int j = 0; j < 4; j++) {
                s.embed[i] = (float)((double)keep + (j < 2 ? j - 2 : j - 1) * h);
                kit_ok(loss_now(&s.in, &f[j], none, &e), e);
            }
            s.embed[i] = keep;
            fd[i] = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h);
        }
        kit_near("dL/dembed", grad, fd, ALIKE * ALIKE_LEN, 1e-9,
                 1e-5); /* groups are kept in float */
    }
    s.in.seed++; /* another draw is another loss */
    double other;
    kit_ok(loss_now(&s.in, &other, grad, &e), e);
    assert_true(other != loss);
    for (size_t i = 0; i < ALIKE * ALIKE_LEN; i++) /* all alike: nothing to do */
        s.embed[i] = (float)(1 + i % ALIKE_LEN);
    kit_ok(loss_now(&s.in, &loss, grad, &e), e);
    assert_true(fabs(loss) < 1e-7);
    memset(s.embed, 0, sizeof s.embed); /* no direction: finite all the same */
    kit_ok(loss_now(&s.in, &loss, grad, &e), e);
    for (size_t i = 0; i < ALIKE * ALIKE_LEN; i++)
        assert_true(isfinite(grad[i]));
    s.in.neighbours = 1;
    kit_fails(loss_now(&s.in, &loss, grad, &e), ERR_ARG, e, "neighbours");
}

/* Mean cosine between a Gaussian's embedding and those of its 15 nearest. */
static double crowd_likeness(const float *mean_m, const float *embed, size_t n, size_t len)
{
    struct knn t;
    struct err e = {0};
    double sum = 0.0;
    kit_ok(knn_build(mean_m, n, &t, &e), e);
    for (size_t i = 0; i < n; i++) {
        uint32_t ids[15];
        float dist2[15];
        size_t found = knn_find(&t, mean_m + 3 * i, (uint32_t)i, 15, ids, dist2);
        for (size_t k = 0; k < found; k++) {
            const float *x = embed + i * len, *y = embed + ids[k] * len;
            double xy = 0.0, xx = 0.0, yy = 0.0;
            for (size_t c = 0; c < len; c++) {
                xy += (double)x[c] * (double)y[c];
                xx += (double)x[c] * (double)x[c];
                yy += (double)y[c] * (double)y[c];
            }
            sum += xy / sqrt(xx * yy) / (double)(15 * n);
        }
    }
    knn_free(&t);
    return sum;
}

/* Random embeddings on a patch of 50 m, 300 steps of Adam at the appearance's rate: neighbours turn
 * the same way. The method reports cosines about 0.1 without the loss and above 0.8 with it. */
static void neighbours_become_alike(void **state)
{
    enum { N = 2000, LEN = 16, STEPS = 300 };
    static float mean_m[3 * N], embed[N * LEN], grad[N * LEN];
    static double m1[N * LEN], m2[N * LEN];
    struct err e = {0};
    double loss;
    for (size_t i = 0; i < 3 * N; i++)
        mean_m[i] = (float)((i % 3 == 2 ? 2.0 : 50.0) * rng_unit(73, 1, i));
    for (size_t i = 0; i < N * LEN; i++)
        embed[i] = (float)rng_normal(73, 2, i);
    struct embed_smoothness_input in = {.mean_m = mean_m,
                                        .embed = embed,
                                        .embed_group = 16 * LEN,
                                        .embed_lane = LEN,
                                        .embed_next = 1,
                                        .n = N,
                                        .len = LEN,
                                        .samples = N / 4,
                                        .neighbours = 16,
                                        .falloff = 1800.0 / (50.0 * 50.0),
                                        .weight = 0.2,
                                        .seed = 6};
    double before = crowd_likeness(mean_m, embed, N, LEN);
    for (uint64_t t = 1; t <= STEPS; t++) {
        in.stream = t; /* another quarter of them every time */
        kit_ok(loss_now(&in, &loss, grad, &e), e);
        for (size_t i = 0; i < N * LEN; i++) {
            double g = (double)grad[i];
            m1[i] = 0.9 * m1[i] + 0.1 * g;
            m2[i] = 0.999 * m2[i] + 0.001 * g * g;
            double step = m1[i] / (1.0 - pow(0.9, (double)t)) /
                          (sqrt(m2[i] / (1.0 - pow(0.999, (double)t))) + 1e-15);
            embed[i] -= (float)(0.01 * step);
        }
    }
    double after = crowd_likeness(mean_m, embed, N, LEN);
    print_message("mean cosine of neighbours %.3f -> %.3f\n", before, after);
    assert_true(fabs(before) < 0.1);
    assert_true(after > 0.8);
}

/* The first or the second moment in a word: the upper half of a float each. */
static double half_of(uint32_t word, size_t nth)
{
    uint32_t bits = nth ? word << 16 : word & 0xffff0000u;
    float x;
    memcpy(&x, &bits, sizeof x);
    return (double)x;
}

/* The gradient reaches Adam's moments of the embeddings, and nothing else. */
static void gradients_enter_the_moments(void **state)
{
    static struct alike s;
    static float grad[ALIKE * ALIKE_LEN];
    struct dev dev;
    struct err e = {0};
    struct gauss g = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    struct embed_smoothness_step *step = NULL;
    double loss, again;
    alike_make(&s, 20);
    kit_gauss(5, ALIKE, 10.0, 1, ALIKE_LEN, &g);
    memcpy(g.mean_m, s.mean_m, sizeof s.mean_m);
    memcpy(g.embed, s.embed, sizeof s.embed);
    kit_ok(loss_now(&s.in, &loss, grad, &e), e);
    kit_ok(dev_open(NULL, &dev, &e), e);
    kit_ok(render_open(&dev, &r, &e), e);
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    size_t floats = (size_t)m.groups * m.planes * 16;
    uint32_t *before = mem_array(floats, sizeof *before), *after = mem_array(floats, sizeof *after);
    assert_true(before && after);
    for (size_t i = 0; i < floats; i++) /* of 16 bits each, between 1e-3 and 4e-3 */
        before[i] = 0x3a833a83u + (uint32_t)(200.0 * rng_unit(72, 1, i)) * 0x00010001u;
    struct render_adam adam = {.beta1 = 0.9f, .beta2 = 0.999f, .step = 3};
    kit_ok(dev_buffer(&dev, floats * sizeof *before, before, &adam.moments, &e), e);
    kit_ok(embed_smoothness_step_open(&dev, &step, &e), e);
    kit_ok(embed_smoothness_step_run(step, &m, &adam, &s.in, &again, &e), e);
    assert_true(again == loss);
    kit_ok(dev_read(&dev, adam.moments, 0, floats * sizeof *after, after, &e), e);
    uint32_t first = layout_planes(1, 0), touched = 0;
    double bias[2] = {0.0}, n[2] = {0.0};
    for (uint32_t p = 0; p < m.planes; p++)
        for (size_t i = 0; i < (size_t)m.groups * 16; i++) {
            size_t at = (i / 16 * m.planes + p) * 16 + i % 16;
            bool embed = p >= first && i < ALIKE;
            double d = embed ? (double)grad[i * ALIKE_LEN + p - first] : 0.0;
            const double add[2] = {d * 0.1 / 0.9, d * d * 0.001 / 0.999};
            for (size_t k = 0; k < 2; k++) {
                const double was = half_of(before[at], k), is = half_of(after[at], k),
                             most = was / 128.0;
                assert_true(fabs(is - was - add[k]) <= most); /* one of two neighbours */
                assert_true(embed || is == was);
                bias[k] += embed ? (is - was - add[k]) / most : 0.0;
                n[k] += embed;
            }
            touched += after[at] != before[at];
        }
    for (size_t k = 0; k < 2; k++) /* one is below 1/2 in the mean of squares: five deviations */
        assert_true(fabs(bias[k]) < 2.5 * sqrt(n[k]));
    assert_true(touched > ALIKE);
    embed_smoothness_step_close(&step);
    dev_release(&adam.moments);
    render_model_free(&m);
    render_close(&r);
    dev_close(&dev);
    gauss_free(&g);
    mem_free(before);
    mem_free(after);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(neighbours_are_exact),
        cmocka_unit_test(embed_smoothness_is_its_definition_and_derivative),
        cmocka_unit_test(neighbours_become_alike),
        cmocka_unit_test(gradients_enter_the_moments),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
