/* The appearance network on the host: values computed by hand, gradients by finite differences,
 * baking against evaluation, and bytes that were not written by us.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/splat/appearance.h"

#define FLOAT_REL 4e-6 /* sums of tens of float products */
/* Fourth-order differences in double with steps of 2^-10: truncation below 1e-9; the gradients
 * themselves pass through float. */
#define FD_STEP (1.0 / 1024)
#define FD_TOL 1e-6

static struct appearance make(uint32_t len, uint32_t hidden, size_t images)
{
    struct appearance a;
    struct err e = {0};
    kit_ok(appearance_alloc(&a, len, 5, hidden, images, &e), e);
    appearance_init(&a, 3);
    for (size_t i = 0; i < images; i++)
        snprintf(a.names[i], sizeof a.names[i], "DJI_%04zu.jpg", i);
    return a;
}

/* Two inputs, two units, numbers that a person can follow. */
static void test_by_hand(void **state)
{
    struct appearance a;
    struct err e = {0};
    kit_ok(appearance_alloc(&a, 2, 1, 2, 1, &e), e);
    const float w1[6] = {1, 2, 0.5f, -1, 0, 0.25f}, b1[2] = {0.25f, 0.125f},
                w2[8] = {1, -2, 0.5f, 3, 0, 1, -1, 0.5f}, b2[4] = {0.5f, -0.5f, 0, -5};
    memcpy(a.w1, w1, sizeof w1);
    memcpy(a.b1, b1, sizeof b1);
    memcpy(a.w2, w2, sizeof w2);
    memcpy(a.b2, b2, sizeof b2);
    const float g[2] = {3, 4}, p[1] = {-7}; /* normalised: 0.6, 0.8 and -1 */
    /* units: 0.6 + 1.6 - 0.5 + 0.25 = 1.95, and -0.6 - 0.25 + 0.125 < 0 */
    const double z[4] = {0.5 + 1.95, -0.5 + 0.5 * 1.95, 0, -5 - 1.95};
    double y[4], want[4];
    appearance_eval(&a, g, p, y);
    for (int o = 0; o < 4; o++)
        want[o] = 1 / (1 + exp(-z[o]));
    kit_near_d("y", y, want, 4, 1e-12, 0);
    float frame[12];
    assert_int_equal(appearance_frame_floats(2, 2), 4 + 2 + 8 + 4);
    float big[18];
    appearance_frame(&a, p, big);
    memcpy(frame, big, sizeof frame);
    const float first[6] = {1, 2, -1, 0, -0.25f, -0.125f}; /* W1's columns, biases with W1 p^ */
    assert_memory_equal(frame, first, sizeof first);
    assert_memory_equal(big + 6, w2, sizeof w2);
    assert_memory_equal(big + 14, b2, sizeof b2);
    appearance_free(&a);
    appearance_free(&a);
    assert_null(a.w1);
}

/* Offsets start near nothing, layers within their limits, the same seed gives the same bits. */
static void test_init(void **state)
{
    struct appearance a = make(16, 32, 40), b = make(16, 32, 40);
    double mean = 0;
    assert_memory_equal(a.w1, b.w1, (appearance_weights(&a) + 40 * 5) * sizeof *a.w1);
    for (size_t i = 0; i < 32 * 21; i++)
        assert_true(fabs((double)a.w1[i]) <= 1 / sqrt(21.0));
    for (size_t i = 0; i < 40; i++) {
        double y[4];
        float g[16] = {0};
        g[15] = 1;
        appearance_eval(&a, g, a.images + 5 * i, y);
        assert_true(y[3] < 0.03);
        mean += y[0] / 40;
    }
    assert_true(fabs(mean - 0.5) < 0.2);
    appearance_free(&a);
    appearance_free(&b);
}

enum { ROWS = 9, LEN = 3, HIDDEN = 6, IMAGE = 5 };

/* sum of c y over a few Gaussians, and (f not NULL) its gradient with respect to the frame. */
static double weigh(const struct appearance *a, const float *embed, const float *image,
                    const double *c, double *f)
{
    double sum = 0;
    float frame[64];
    appearance_frame(a, image, frame);
    for (size_t i = 0; i < ROWS; i++) {
        const float *g = embed + LEN * i, *bias = frame + HIDDEN * LEN, *w2 = bias + HIDDEN;
        double y[4], len = 0, *f_bias = f + HIDDEN * LEN, *f_w2 = f_bias + HIDDEN;
        appearance_eval(a, g, image, y);
        for (size_t k = 0; k < LEN; k++)
            len += (double)g[k] * (double)g[k];
        for (size_t o = 0; o < 4; o++)
            sum += c[4 * i + o] * y[o];
        for (size_t h = 0; h < HIDDEN && f; h++) {
            double s = (double)bias[h], g_s = 0;
            for (size_t k = 0; k < LEN; k++)
                s += (double)frame[h * LEN + k] * (double)g[k] / sqrt(len);
            for (size_t o = 0; o < 4 && s > 0; o++) {
                double g_z = c[4 * i + o] * y[o] * (1 - y[o]);
                f_w2[o * HIDDEN + h] += g_z * s;
                g_s += g_z * (double)w2[o * HIDDEN + h];
            }
            for (size_t k = 0; k < LEN; k++)
                f[h * LEN + k] += g_s * (double)g[k] / sqrt(len);
            f_bias[h] += g_s;
        }
        for (size_t o = 0; o < 4 && f; o++)
            f_w2[4 * HIDDEN + o] += c[4 * i + o] * y[o] * (1 - y[o]);
    }
    return sum;
}

/* A frame's gradient back to every weight and to the photograph, against differences in double. */
static void test_backward(void **state)
{
    struct appearance a = make(LEN, HIDDEN, 1);
    size_t n = appearance_frame_floats(LEN, HIDDEN), weights = appearance_weights(&a);
    float embed[ROWS * LEN], frame_grad[64], got[128], got_image[IMAGE], image[IMAGE];
    double c[4 * ROWS], f[64] = {0}, want[128 + IMAGE];
    assert_true(n <= 64 && weights <= 128);
    for (size_t i = 0; i < sizeof embed / sizeof *embed; i++)
        embed[i] = (float)rng_normal(6, 0, i);
    for (size_t i = 0; i < sizeof c / sizeof *c; i++)
        c[i] = rng_normal(6, 1, i);
    for (size_t i = 0; i < weights; i++) /* on a grid: steps are exact */
        a.w1[i] = (float)(round((double)a.w1[i] * 4096) / 4096);
    for (size_t i = 0; i < IMAGE; i++)
        image[i] = (float)(round((double)a.images[i] * 4096) / 4096);
    (void)weigh(&a, embed, image, c, f);
    for (size_t i = 0; i < n; i++)
        frame_grad[i] = (float)f[i];
    appearance_backward(&a, image, frame_grad, got, got_image);
    for (size_t i = 0; i < weights + IMAGE; i++) {
        float *p = i < weights ? &a.w1[i] : &image[i - weights], keep = *p;
        double l[4];
        for (int s = 0; s < 4; s++) {
            static const double at[4] = {-2, -1, 1, 2};
            *p = (float)((double)keep + at[s] * FD_STEP);
            l[s] = weigh(&a, embed, image, c, NULL);
        }
        *p = keep;
        want[i] = (8 * (l[2] - l[1]) - (l[3] - l[0])) / (12 * FD_STEP);
    }
    kit_near("weights", got, want, weights, FD_TOL, FD_TOL);
    kit_near("photograph", got_image, want + weights, IMAGE, FD_TOL, FD_TOL);
    float again[IMAGE];
    appearance_backward(&a, image, frame_grad, NULL, again); /* the photograph alone */
    assert_memory_equal(again, got_image, sizeof again);
    memset(image, 0, sizeof image); /* nothing to normalise: finite all the same */
    appearance_backward(&a, image, frame_grad, got, got_image);
    for (int i = 0; i < IMAGE; i++)
        assert_true(isfinite(got_image[i]));
    appearance_free(&a);
}

static void test_bake(void **state)
{
    static const uint32_t lens[] = {1, 4, 16, 64};
    for (size_t k = 0; k < 4; k++) {
        struct appearance a = make(lens[k], 7 + (uint32_t)k * 19, 2);
        struct gauss g, baked;
        struct err e = {0};
        kit_gauss(9, 9000, 10, 1, lens[k], &g); /* more than one chunk */
        kit_gauss(9, 9000, 10, 1, lens[k], &baked);
        for (size_t i = 0; i < g.n * lens[k]; i++)
            g.embed[i] = baked.embed[i] = (float)rng_normal(10, 0, i);
        g.opacity_logit[5] = baked.opacity_logit[5] = 30.0f;
        a.b2[3] = -1; /* offsets that show */
        kit_ok(appearance_bake(&a, a.images + 5, &baked, &e), e);
        for (size_t i = 0; i < g.n; i++) {
            double y[4], dc[3], got[3];
            appearance_eval(&a, g.embed + i * lens[k], a.images + 5, y);
            for (size_t c = 0; c < 3; c++) {
                dc[c] = (double)g.sh[12 * i + c] + (2 * y[c] - 1) / GAUSS_SH_C0;
                got[c] = (double)baked.sh[12 * i + c];
            }
            kit_near_d("DC", got, dc, 3, FLOAT_REL, FLOAT_REL);
            double o = 1 / (1 + exp(-(double)g.opacity_logit[i])),
                   b = 1 / (1 + exp(-(double)baked.opacity_logit[i]));
            o = fmin(o + y[3], 1 - 1e-6);
            kit_near_d("opacity", &b, &o, 1, FLOAT_REL, 0);
            assert_memory_equal(baked.sh + 12 * i + 3, g.sh + 12 * i + 3, 9 * sizeof(float));
        }
        assert_memory_equal(baked.embed, g.embed, g.n * lens[k] * sizeof(float));
        if (k == 0)
            kit_fails(appearance_bake(&a, a.images, &(struct gauss){.embed_len = 8}, &e), ERR_DATA,
                      e, "embeddings of 8");
        gauss_free(&g);
        gauss_free(&baked);
        appearance_free(&a);
    }
}

static void test_names_and_blend(void **state)
{
    struct appearance a = make(16, 32, 12);
    const uint32_t index[3] = {1, 11, 0};
    const double weight[3] = {0.5, 0.25, 0.25};
    float mix[5];
    double want[5];
    assert_int_equal(appearance_find(&a, "DJI_0011.jpg"), 11);
    assert_int_equal(appearance_find(&a, "DJI_0011.jpg.png"), -1);
    assert_int_equal(appearance_find(&a, "DJI_001"), -1);
    appearance_blend(&a, index, weight, 3, mix);
    for (size_t j = 0; j < 5; j++)
        want[j] = 0.5 * (double)a.images[5 + j] + 0.25 * (double)a.images[55 + j] +
                  0.25 * (double)a.images[j];
    kit_near("blend", mix, want, 5, FLOAT_REL, 0);
    appearance_free(&a);
}

static void test_limits(void **state)
{
    struct appearance a;
    struct err e = {0};
    kit_fails(appearance_alloc(&a, 0, 32, 32, 1, &e), ERR_LIMIT, e, "0 and 32");
    kit_fails(appearance_alloc(&a, GAUSS_EMBED_MAX + 1, 32, 32, 1, &e), ERR_LIMIT, e, NULL);
    kit_fails(appearance_alloc(&a, 16, APPEARANCE_IMAGE_MAX + 1, 32, 1, &e), ERR_LIMIT, e, NULL);
    kit_fails(appearance_alloc(&a, 16, 32, APPEARANCE_HIDDEN_MAX + 1, 1, &e), ERR_LIMIT, e, NULL);
    kit_fails(appearance_alloc(&a, 16, 32, 32, SIZE_MAX, &e), ERR_LIMIT, e, NULL);
    mem_fail_at(1);
    kit_fails(appearance_alloc(&a, 16, 32, 32, 1, &e), ERR_MEM, e, NULL);
    mem_fail_at(0);
    appearance_free(&a);
}

/* ---- bytes ---- */

static void rehash(struct buf *b)
{
    struct hash128 h = hash_bytes(b->data, b->size - 16);
    b->size -= 16;
    buf_u64(b, h.lo);
    buf_u64(b, h.hi);
}

static void test_round_trip(void **state)
{
    static const size_t counts[] = {0, 1, 30};
    for (size_t k = 0; k < 3; k++) {
        struct appearance a = make(16, 32, counts[k]), b;
        struct buf bytes = {0}, again = {0};
        struct err e = {0};
        if (counts[k] > 1)
            memset(a.names[1], 'x', APPEARANCE_NAME_MAX - 1); /* the longest */
        kit_ok(appearance_write(&a, &bytes, &e), e);
        kit_ok(appearance_read(bytes.data, bytes.size, &b, &e), e);
        assert_true(b.len_gauss == 16 && b.len_image == 5 && b.hidden == 32);
        assert_int_equal(b.n_images, counts[k]);
        assert_memory_equal(a.w1, b.w1, (appearance_weights(&a) + counts[k] * 5) * sizeof *a.w1);
        for (size_t i = 0; i < counts[k]; i++)
            assert_string_equal(a.names[i], b.names[i]);
        kit_ok(appearance_write(&b, &again, &e), e);
        assert_true(again.size == bytes.size && !memcmp(again.data, bytes.data, bytes.size));
        buf_free(&bytes);
        buf_free(&again);
        appearance_free(&a);
        appearance_free(&b);
    }
}

/* Cut anywhere, any byte turned: refused, and nothing is left behind. */
static void test_damage(void **state)
{
    struct appearance a = make(4, 4, 3), b;
    struct buf bytes = {0};
    struct err e = {0};
    kit_ok(appearance_write(&a, &bytes, &e), e);
    for (size_t n = 0; n < bytes.size; n++) {
        assert_true(appearance_read(bytes.data, n, &b, &e) == ERR_FORMAT);
        assert_null(b.block);
        bytes.data[n] ^= 0x41;
        assert_true(appearance_read(bytes.data, bytes.size, &b, &e) == ERR_FORMAT);
        bytes.data[n] ^= 0x41;
    }
    buf_free(&bytes);
    appearance_free(&a);
}

/* The checksum is right and the rest is not: an attacker can do that too. */
static void test_hostile(void **state)
{
    static const struct {
        size_t at;
        uint32_t value;
        enum err_code want;
        const char *part;
    } rows[] = {
        {4, 2, ERR_FORMAT, "version 2"},
        {8, 0, ERR_LIMIT, "0 and 5"},
        {8, 0xFFFFFFFF, ERR_LIMIT, NULL},
        {8, 65, ERR_LIMIT, NULL},
        {12, 0x40000000, ERR_FORMAT, NULL},
        {12, 64, ERR_FORMAT, NULL},
        {16, 0xFFFFFFFF, ERR_LIMIT, NULL},
        {16, 64, ERR_FORMAT, "cut off"},
        {20, 0xFFFFFFFF, ERR_FORMAT, "photographs"},
        {20, 4, ERR_FORMAT, NULL},
        {20, 2, ERR_FORMAT, NULL},
        {24, 0x7FC00000, ERR_FORMAT, "value 0"},
        {28, 0x7F800000, ERR_FORMAT, "value 1"},
    };
    struct appearance a = make(4, 4, 3), b;
    struct buf bytes = {0};
    struct err e = {0};
    kit_ok(appearance_write(&a, &bytes, &e), e);
    uint8_t *keep = mem_array(bytes.size, 1);
    assert_non_null(keep);
    memcpy(keep, bytes.data, bytes.size);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        for (size_t k = 0; k < 4; k++)
            bytes.data[rows[i].at + k] = (uint8_t)(rows[i].value >> (8 * k));
        rehash(&bytes);
        kit_fails(appearance_read(bytes.data, bytes.size, &b, &e), rows[i].want, e, rows[i].part);
        assert_null(b.block);
        memcpy(bytes.data, keep, bytes.size);
    }
    size_t name = bytes.size - 16 - 3 * 13; /* the first name's length */
    assert_int_equal(bytes.data[name], 12);
    for (unsigned v = 0; v < 256; v++) {
        bytes.data[name] = (uint8_t)v;
        rehash(&bytes);
        assert_true(appearance_read(bytes.data, bytes.size, &b, &e) ==
                    (v == 12 ? ERR_OK : ERR_FORMAT));
        appearance_free(&b);
    }
    bytes.data[name] = 12;
    bytes.data[name + 3] = 0; /* a NUL inside */
    rehash(&bytes);
    kit_fails(appearance_read(bytes.data, bytes.size, &b, &e), ERR_FORMAT, e, "photograph 0");
    mem_free(keep);
    buf_free(&bytes);
    appearance_free(&a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_by_hand),         cmocka_unit_test(test_init),
        cmocka_unit_test(test_backward),        cmocka_unit_test(test_bake),
        cmocka_unit_test(test_names_and_blend), cmocka_unit_test(test_limits),
        cmocka_unit_test(test_round_trip),      cmocka_unit_test(test_damage),
        cmocka_unit_test(test_hostile),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
