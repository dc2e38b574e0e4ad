/* Tile payloads: lossless means every bit, otherwise half floats; hostile bytes are refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/splat/payload.h"
#include "core/layout.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

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

enum { PLACED_BLOCK = 32, PLACED_BLOCKS = 10, PLACED_ROWS = PLACED_BLOCK * PLACED_BLOCKS };
#define PLACED_SPARE 7.0f /* what was there before */

/* Harmonics of row i of `want` as halves; row[] is plane 0 at this lane. */
static void expect_halves(const struct gauss *want, size_t i, const float *row, size_t lane)
{
    const size_t k = 3 * gauss_sh_count(want->sh_degree);
    uint16_t halves[3 * LAYOUT_SH_MAX], got;
    const uint8_t *at = (const uint8_t *)(row + LAYOUT_PLANE_SH * LAYOUT_LANES) - 2 * lane;
    payload_to_float16(want->sh + k * i, k, halves);
    for (size_t a = 0; a < k; a++) {
        memcpy(&got, at + 2 * a * LAYOUT_LANES, sizeof got);
        assert_int_equal(got, halves[a]);
    }
}

/* Row i of `want` lies in row[], about the target's origin. */
static void expect_row(const struct gauss *want, size_t i, const struct payload_target *to,
                       const float *row)
{
    const size_t k = 3 * gauss_sh_count(want->sh_degree), embed = want->embed_len;
    for (size_t a = 0; a < 3; a++) {
        const double at =
            (double)want->mean_m[3 * i + a] + (want->origin_enu_m[a] - to->origin_enu_m[a]);
        assert_true(row[a * LAYOUT_LANES] == (float)at);
        assert_true(row[(LAYOUT_PLANE_SCALE + a) * LAYOUT_LANES] == want->scale_log[3 * i + a]);
    }
    for (size_t a = 0; a < 4; a++)
        assert_true(row[(LAYOUT_PLANE_QUAT + a) * LAYOUT_LANES] == want->quat_wxyz[4 * i + a]);
    assert_true(row[LAYOUT_PLANE_OPACITY * LAYOUT_LANES] == want->opacity_logit[i]);
    if (to->sh_halves)
        expect_halves(want, i, row, to->place[i] % LAYOUT_LANES);
    for (size_t a = 0; !to->sh_halves && a < k; a++)
        assert_true(row[(LAYOUT_PLANE_SH + a) * LAYOUT_LANES] == want->sh[k * i + a]);
    row += (to->sh_halves ? layout_planes_halves : layout_planes)(want->sh_degree, 0) *
           (size_t)LAYOUT_LANES;
    for (size_t a = 0; a < to->embed_len; a++)
        assert_true(row[a * LAYOUT_LANES] == want->embed[embed * i + a]);
}

/* Words of the lanes behind the last row that are as before. */
static size_t count_spare(const struct payload_target *to, size_t n, uint32_t planes)
{
    size_t spare = 0;
    for (size_t i = n; i < PLACED_ROWS; i++)
        for (size_t a = 0; a < planes; a++)
            spare += to->block[i / PLACED_BLOCK][layout_at(i % PLACED_BLOCK, planes) +
                                                 a * LAYOUT_LANES] == PLACED_SPARE;
    return spare;
}

static void expect_placed(const struct payload *p, const struct gauss *want, uint32_t embed_len,
                          bool halves)
{
    static float rows[PLACED_ROWS * (LAYOUT_PLANE_SH + 3 * LAYOUT_SH_MAX + 8)];
    float *block[PLACED_BLOCKS], size_log[PLACED_ROWS];
    uint32_t place[PLACED_ROWS];
    struct err e = {0};
    const uint32_t planes =
        (halves ? layout_planes_halves : layout_planes)(want->sh_degree, embed_len);
    const struct payload_target to = {.block = block,
                                      .place = place,
                                      .block_rows = PLACED_BLOCK,
                                      .sh_halves = halves,
                                      .embed_len = embed_len,
                                      .origin_enu_m = {100.25, -20, 3}};
    assert_true(want->n <= PLACED_ROWS && want->n % 7 != 0); /* 7 i + 3 is a permutation */
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        rows[i] = PLACED_SPARE;
    for (size_t i = 0; i < PLACED_BLOCKS; i++) /* blocks lie in another order, too */
        block[i] = rows + (PLACED_BLOCKS - 1 - i) * PLACED_BLOCK * planes;
    for (size_t i = 0; i < want->n; i++)
        place[i] = (uint32_t)((i * 7 + 3) % want->n);
    kit_ok(payload_place(p, &to, &e), e);
    payload_sizes(p, size_log);
    for (size_t i = 0; i < want->n; i++) {
        const float *s = want->scale_log + 3 * i;
        assert_true(size_log[i] == fmaxf(fmaxf(s[0], s[1]), s[2]));
        expect_row(want, i, &to,
                   block[place[i] / PLACED_BLOCK] + layout_at(place[i] % PLACED_BLOCK, planes));
    }
    if (!halves) /* two lanes share a word of them */
        assert_int_equal(count_spare(&to, want->n, planes), (PLACED_ROWS - want->n) * planes);
}

/* In blocks of 32, in another order and about another origin, with embeddings and without: each
 * value is the one that decoding gives, and no other float is touched. */
static void test_placed(void **state)
{
    static const size_t counts[] = {1, 31, 200, 300};
    struct payload p = {0}; /* used again and again */
    for (size_t c = 0; c < 16; c++) {
        struct gauss g, want;
        struct buf b = {0};
        struct err e = {0};
        const uint32_t embed = c & 2 ? 8 : 0;
        kit_gauss(c, counts[c / 4], 60, (uint32_t)c % 4, embed, &g);
        kit_ok(payload_encode(&g, c & 4, &b, &e), e);
        kit_ok(payload_decode(b.data, b.size, NULL, &want, &e), e);
        kit_ok(payload_open(&p, b.data, b.size, NULL, &e), e);
        for (int halves = 0; halves < 2; halves++)
            expect_placed(&p, &want, c & 1 ? embed : 0, halves);
        gauss_free(&g);
        gauss_free(&want);
        buf_free(&b);
    }
    payload_free(&p);
}

/* What payload_encode never writes: the planes are patched before they are packed again. */
static void test_placed_values_are_checked(void **state)
{
    for (int lossless = 0; lossless < 2; lossless++)
        for (int kind = 0; kind < 2; kind++) {
            struct gauss g, back;
            struct buf b = {0};
            struct err e = {0};
            struct payload p = {0};
            float rows[16 * 14], *block[1] = {rows};
            const uint32_t place[4] = {0, 1, 2, 3};
            const struct payload_target to = {.block = block, .place = place, .block_rows = 16};
            kit_gauss(3, 4, 10, 0, 0, &g);
            kit_ok(payload_encode(&g, lossless, &b, &e), e);
            kit_ok(payload_open(&p, b.data, b.size, NULL, &e), e);
            kit_ok(payload_place(&p, &to, &e), e);
            const size_t width = lossless ? 4 : 2, mean = 4 * 12, quat = mean + 4 * 3 * width;
            if (kind) /* the rotation of every row is 0 */
                memset(p.plain.data + quat, 0, 4 * 4 * width);
            else /* the two high bytes of row 0, then as before: no number from there on */
                p.plain.data[3 * 4] = 0x7f, p.plain.data[2 * 4] = 0xff;
            kit_fails(payload_place(&p, &to, &e), ERR_FORMAT, e, "payload: row 0");
            kit_fails(payload_gauss(&p, &back, &e), ERR_FORMAT, e, "payload: row 0");
            payload_free(&p);
            gauss_free(&g);
            buf_free(&b);
        }
}

static void test_truncation_and_flips(void **state)
{
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
    struct gauss g, back;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(9, 20, 10, 2, 4, &g);
    kit_out_of_memory((buf_free(&b), payload_encode(&g, false, &b, &e)), 1, e);
    kit_out_of_memory(payload_decode(b.data, b.size, NULL, &back, &e), 1, e);
    gauss_free(&back);
    gauss_free(&g);
    buf_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_lossless),
        cmocka_unit_test(test_placed),
        cmocka_unit_test(test_placed_values_are_checked),
        cmocka_unit_test(test_half_floats),
        cmocka_unit_test(test_all_halves),
        cmocka_unit_test(test_refuses_what_is_not_finite),
        cmocka_unit_test(test_truncation_and_flips),
        cmocka_unit_test(test_hostile_counts),
        cmocka_unit_test(test_out_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
