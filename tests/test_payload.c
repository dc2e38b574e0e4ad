/* Tile payloads: lossless means every bit, otherwise half floats; hostile bytes are refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/payload.h"
#include "tests/kit.h"
#include "tests/torture.h"

#include <math.h>
#include <string.h>

/* binary16 keeps 11 bits: half a step of 2^-10, and 2^-25 below 2^-14. */
#define HALF_REL (1.0 / 2048)
#define HALF_ABS (1.0 / 33554432)

static void expect_same(const struct gauss *a, const struct gauss *b)
{
    size_t k = gauss_sh_count(a->sh_degree);
    assert_int_equal(a->n, b->n);
    assert_int_equal(a->sh_degree, b->sh_degree);
    assert_int_equal(a->embed_len, b->embed_len);
    assert_int_equal(a->antialiased, b->antialiased);
    assert_memory_equal(a->origin_enu_m, b->origin_enu_m, sizeof a->origin_enu_m);
    assert_memory_equal(a->mean_m, b->mean_m, a->n * 12);
    assert_memory_equal(a->scale_log, b->scale_log, a->n * 12);
    assert_memory_equal(a->quat_wxyz, b->quat_wxyz, a->n * 16);
    assert_memory_equal(a->opacity_logit, b->opacity_logit, a->n * 4);
    assert_memory_equal(a->sh, b->sh, a->n * k * 12);
    if (a->embed_len)
        assert_memory_equal(a->embed, b->embed, a->n * a->embed_len * 4);
}

static void test_lossless(void **state)
{
    (void)state;
    static const size_t counts[] = {0, 1, 2, 1000};
    for (size_t i = 0; i < 16; i++) {
        struct gauss g, back;
        struct buf b = {0};
        struct err e = {0};
        kit_gauss(i, counts[i / 4], 900, (uint32_t)i % 4, (uint32_t)i % 3 * 8, &g);
        g.antialiased = i & 1;
        g.origin_enu_m[0] = 12345.678901;
        g.origin_enu_m[2] = -1e-3;
        kit_ok(payload_encode(&g, true, &b, &e), e);
        kit_ok(payload_decode(b.data, b.size, NULL, &back, &e), e);
        expect_same(&g, &back);
        buf_free(&b);
        gauss_free(&g);
        gauss_free(&back);
    }
}

static void near_half(const char *what, const float *got, const float *want, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        double w = (double)want[i];
        kit_near(what, got + i, &w, 1, HALF_ABS, HALF_REL);
    }
}

/* The half float nearest to the multiple of 2^-9 that is nearest, of two the even one. */
static void near_step(const float *got, const float *want, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        double w = rint((double)want[i] * 512) / 512;
        kit_near("sh", got + i, &w, 1, 0, HALF_REL);
        if (fabs((double)want[i]) < 4 && (double)got[i] != w)
            fail_msg("sh %.9g is kept as %.9g", (double)want[i], (double)got[i]);
    }
}

static void test_half_floats(void **state)
{
    (void)state;
    struct gauss g, back, again;
    struct buf b = {0}, c = {0};
    struct err e = {0};
    kit_gauss(3, 500, 900, 3, 16, &g);
    g.opacity_logit[0] = 1e9f; /* beyond half floats: the largest one */
    g.opacity_logit[1] = -1e9f;
    g.sh[0] = 3e-7f; /* kept as 0 */
    g.sh[1] = -6e-5f;
    g.sh[2] = 65000; /* where half floats are farther apart than harmonics' steps */
    g.sh[3] = -5.001f;
    g.sh[4] = 3.0f / 1024;  /* between two steps: the even one */
    g.scale_log[0] = 3e-7f; /* subnormal half floats */
    g.scale_log[1] = -6e-5f;
    for (int k = 0; k < 4; k++)
        g.quat_wxyz[k] *= 1e-18f; /* far from unit length, but a rotation */
    kit_ok(payload_encode(&g, false, &b, &e), e);
    kit_ok(payload_decode(b.data, b.size, NULL, &back, &e), e);
    assert_memory_equal(g.mean_m, back.mean_m, g.n * 12);
    assert_true(back.opacity_logit[0] == 65504 && back.opacity_logit[1] == -65504);
    near_half("opacity", back.opacity_logit + 2, g.opacity_logit + 2, g.n - 2);
    near_half("scale", back.scale_log, g.scale_log, 3 * g.n);
    near_step(back.sh, g.sh, 48 * g.n);
    assert_true(back.sh[4] == 4.0f / 1024);
    near_half("embed", back.embed, g.embed, 16 * g.n);
    for (size_t i = 0; i < g.n; i++) {
        const float *q = g.quat_wxyz + 4 * i;
        double norm = 0, s = i ? 1 : 1e18;
        for (int k = 0; k < 4; k++)
            norm += s * s * (double)q[k] * (double)q[k];
        for (int k = 0; k < 4; k++) {
            double want = s * (double)q[k] / sqrt(norm);
            kit_near("rotation", back.quat_wxyz + 4 * i + k, &want, 1, 1e-6, HALF_REL);
        }
    }
    /* What was rounded stays as it is: the rows of a payload give that payload again. */
    kit_ok(payload_encode(&back, false, &c, &e), e);
    assert_int_equal(b.size, c.size);
    assert_memory_equal(b.data, c.data, c.size);
    kit_ok(payload_decode(c.data, c.size, NULL, &again, &e), e);
    expect_same(&back, &again);
    gauss_free(&again);
    buf_free(&c);
    buf_free(&b);
    gauss_free(&g);
    gauss_free(&back);
}

/* Every half float there is and what lies between, by the definition: the nearest one, of two the
 * even one, the largest for what is beyond; the wide loops and the plain ones alike. */
static void test_all_halves(void **state)
{
    (void)state;
    enum { HALVES = 0x7c00 };
    static uint16_t bits[HALVES], back[HALVES];
    static float value[HALVES], between[HALVES];
    for (uint32_t i = 0; i < HALVES; i++)
        bits[i] = (uint16_t)i;
    payload_from_float16(bits, HALVES, value);
    for (uint32_t i = 0; i < HALVES; i++) {
        int exponent = (int)(i >> 10), mantissa = (int)(i & 1023);
        double want = exponent ? ldexp(1024 + mantissa, exponent - 25) : ldexp(mantissa, -24);
        assert_true((double)value[i] == want);
        between[i] = i + 1 < HALVES && i ? (value[i] + value[i - 1]) / 2 : value[i];
    }
    payload_to_float16(value, HALVES, back);
    assert_memory_equal(back, bits, sizeof bits);
    payload_to_float16(between, HALVES, back);
    for (uint32_t i = 1; i + 1 < HALVES; i++)
        assert_int_equal(back[i], i & 1 ? i - 1 : i); /* ties go to even */
    for (int side = -1; side <= 1; side += 2) {
        for (uint32_t i = 1; i + 1 < HALVES; i++)
            between[i] = nextafterf((value[i] + value[i - 1]) / 2, side < 0 ? 0 : INFINITY);
        for (size_t n = HALVES; n > HALVES - 9; n--) { /* any remainder of the vectors */
            payload_to_float16(between, n, back);
            for (uint32_t i = 1; i + 1 < n; i++)
                assert_int_equal(back[i], side < 0 ? i - 1 : i);
        }
    }
    const float odd[4] = {1e9f, -65520.0f, -0.0f, -1e-9f};
    payload_to_float16(odd, 4, back);
    assert_true(back[0] == 0x7bff && back[1] == 0xfbff && back[2] == 0x8000 && back[3] == 0x8000);
}

static void test_refuses_what_is_not_finite(void **state)
{
    (void)state;
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(4, 10, 1, 1, 0, &g);
    g.scale_log[3 * 6 + 1] = NAN;
    kit_fails(payload_encode(&g, true, &b, &e), ERR_DATA, e, "row 6");
    assert_int_equal(b.size, 0);
    buf_free(&b);
    gauss_free(&g);
}

static enum err_code decode_free(const void *user, const void *bytes, size_t n,
                                 const struct codec_limits *lim, struct err *e)
{
    struct gauss g;
    (void)user;
    enum err_code rc = payload_decode(bytes, n, lim, &g, e);
    if (rc)
        assert_true(g.n == 0 && g.block == NULL);
    gauss_free(&g);
    return rc;
}

static const struct torture torture = {
    .name = "payload", .decode = decode_free, .errors = TORTURE(ERR_LIMIT)};

static void test_truncation_and_flips(void **state)
{
    (void)state;
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(5, 40, 10, 1, 2, &g);
    kit_ok(payload_encode(&g, false, &b, &e), e);
    torture_cuts(&torture, &b, 1);
    torture_flips(&torture, &b, 0, 2, 2000);
    buf_u8(&b, 0); /* a byte too many */
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "payload");
    buf_free(&b);
    gauss_free(&g);
}

static void test_hostile_counts(void **state)
{
    (void)state;
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(6, 100, 10, 0, 0, &g);
    kit_ok(payload_encode(&g, true, &b, &e), e);
    struct codec_limits lim = {.max_gaussians = 99};
    kit_fails(torture_decode(&torture, b.data, b.size, &lim, &e), ERR_LIMIT, e, "100 Gaussians");
    lim = (struct codec_limits){.max_bytes = 5599};
    kit_fails(torture_decode(&torture, b.data, b.size, &lim, &e), ERR_LIMIT, e, "5600 bytes");
    size_t before = mem_peak_bytes();
    uint64_t n = 60000000,
             plain = n * 56; /* consistent with itself, but not with a file this small */
    memcpy(b.data + 8, &n, 4);
    memcpy(b.data + 40, &plain, 8);
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "do not fit");
    assert_true(mem_peak_bytes() - before < (64u << 20));
    b.data[4] = 9;
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "version 9");
    buf_free(&b);
    gauss_free(&g);
}

static void test_out_of_memory(void **state)
{
    (void)state;
    struct gauss g, back;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(9, 20, 10, 2, 4, &g);
    enum err_code rc = ERR_MEM;
    for (size_t k = 1; rc == ERR_MEM && k < 100; k++) {
        buf_free(&b);
        mem_fail_at(k);
        rc = payload_encode(&g, false, &b, &e);
        mem_fail_at(0);
    }
    kit_ok(rc, e);
    rc = ERR_MEM;
    for (size_t k = 1; rc == ERR_MEM && k < 100; k++) {
        mem_fail_at(k);
        rc = payload_decode(b.data, b.size, NULL, &back, &e);
        mem_fail_at(0);
    }
    kit_ok(rc, e);
    gauss_free(&back);
    gauss_free(&g);
    buf_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_lossless),
        cmocka_unit_test(test_half_floats),
        cmocka_unit_test(test_all_halves),
        cmocka_unit_test(test_refuses_what_is_not_finite),
        cmocka_unit_test(test_truncation_and_flips),
        cmocka_unit_test(test_hostile_counts),
        cmocka_unit_test(test_out_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
