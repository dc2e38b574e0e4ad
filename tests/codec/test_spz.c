/* The quantiser and .spz: integers survive every conversion, values stay within half a step,
 * hostile files are refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/splat/spz.h"
#include "core/splat/camera.h"
#include "tests/codec/quant_kit.h"
#include "tests/kit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

/* Half a step of each field, plus what float32 adds. */
#define POSITION_TOL (0.5 / 4096 + 1e-4) /* means reach 1000 m: float32 keeps 6e-5 there */
#define SCALE_TOL (0.5 / 16 + 1e-5)
#define ALPHA_TOL (0.5 / 255 + 1e-6)
#define COLOR_TOL (0.5 / 255 / 0.15 + 1e-5)
#define SH1_TOL (4 / 128.0 + 1e-6) /* steps of 8 */
#define SH_TOL (8 / 128.0 + 1e-6)
/* 9 bits over sqrt(1/2): half a step on three components, and what it makes of the largest one. */
#define ROTATION_TOL_DEG 0.3

static double sigmoid(double x)
{
    return 1 / (1 + exp(-x));
}

static void test_values_within_half_a_step(void **state)
{
    struct gauss g, back;
    struct quant q;
    struct err e = {0};
    kit_gauss(1, 2000, 1000, 3, 4, &g);
    kit_ok(quant_from_gauss(&g, 3, NULL, &q, &e), e);
    kit_ok(quant_to_gauss(&q, &back, &e), e);
    for (size_t i = 0; i < g.n; i++) {
        double want[48], dot = 0, norm = 0, alpha = sigmoid((double)g.opacity_logit[i]);
        for (int c = 0; c < 3; c++)
            want[c] = (double)g.mean_m[3 * i + c];
        kit_near("position", back.mean_m + 3 * i, want, 3, POSITION_TOL, 0);
        for (int c = 0; c < 3; c++)
            want[c] = fmin(255 / 16.0 - 10, fmax(-10, (double)g.scale_log[3 * i + c]));
        kit_near("scale", back.scale_log + 3 * i, want, 3, SCALE_TOL, 0);
        assert_true(fabs(sigmoid((double)back.opacity_logit[i]) - alpha) < ALPHA_TOL);
        for (int c = 0; c < 3; c++) {
            double lim = 0.5 / 0.15;
            want[c] = fmin(lim, fmax(-lim, (double)g.sh[48 * i + c]));
        }
        kit_near("color", back.sh + 48 * i, want, 3, COLOR_TOL, 0);
        for (int c = 3; c < 48; c++)
            want[c] = fmin(127.0 / 128, fmax(-1, (double)g.sh[48 * i + c]));
        kit_near("sh1", back.sh + 48 * i + 3, want + 3, 9, SH1_TOL, 0);
        kit_near("sh2, sh3", back.sh + 48 * i + 12, want + 12, 36, SH_TOL, 0);
        for (int c = 0; c < 4; c++) {
            dot += (double)g.quat_wxyz[4 * i + c] * (double)back.quat_wxyz[4 * i + c];
            norm += (double)g.quat_wxyz[4 * i + c] * (double)g.quat_wxyz[4 * i + c];
        }
        double angle = 2 * acos(fmin(1, fabs(dot) / sqrt(norm))) * 57.29577951308232;
        if (angle > ROTATION_TOL_DEG)
            fail_msg("row %zu: turned by %g degrees", i, angle);
    }
    for (size_t d = 0; d < 4; d++)
        for (size_t i = 0; i < g.n; i++)
            assert_true(fabsf(back.embed[4 * i + d] - g.embed[4 * i + d]) <
                        (q.embed_max[d] - q.embed_min[d]) / 255 * 0.51f);
    quant_free(&q);
    gauss_free(&g);
    gauss_free(&back);
}

/* Requantising what was dequantised changes nothing (rotations whose two largest components tie may
 * name the other one; they stay within the tolerance above). */
static void test_quantising_twice_is_quantising_once(void **state)
{
    struct gauss g, back;
    struct quant q, again;
    struct err e = {0};
    kit_gauss(2, 1000, 500, 3, 0, &g);
    g.opacity_logit[0] = 1e5f;
    g.opacity_logit[1] = -1e5f;
    kit_ok(quant_from_gauss(&g, 3, NULL, &q, &e), e);
    assert_int_equal(q.alpha[0], 255);
    assert_int_equal(q.alpha[1], 0);
    kit_ok(quant_to_gauss(&q, &back, &e), e);
    assert_int_equal(gauss_count_bad(&back, NULL), 0);
    kit_ok(quant_from_gauss(&back, 3, NULL, &again, &e), e);
    size_t differ = 0;
    for (size_t i = 0; i < q.n; i++)
        differ += q.rotation[i] != again.rotation[i];
    assert_true(differ <= 5);
    memcpy(again.rotation, q.rotation, q.n * 4);
    quant_kit_same(&q, &again);
    quant_free(&q);
    quant_free(&again);
    gauss_free(&g);
    gauss_free(&back);
}

static void test_degrees(void **state)
{
    struct gauss g;
    struct quant q;
    struct err e = {0};
    kit_gauss(3, 5, 10, 2, 0, &g);
    kit_ok(quant_from_gauss(&g, 3, NULL, &q, &e), e);
    assert_int_equal(q.sh_degree, 3);
    for (size_t i = 24; i < 45; i++)
        assert_int_equal(q.sh[i], 128);
    quant_free(&q);
    kit_ok(quant_from_gauss(&g, 0, NULL, &q, &e), e);
    assert_int_equal(q.sh_degree, 0);
    quant_free(&q);
    gauss_free(&g);
}

static void test_refuses_what_cannot_be_written(void **state)
{
    struct gauss g;
    struct quant q;
    struct err e = {0};
    kit_gauss(4, 10, 10, 1, 1, &g);
    g.mean_m[3 * 7 + 2] = 1e6f; /* Gaussians of 10 cm need finer steps than 24 bits have there */
    kit_fails(quant_from_gauss(&g, 1, NULL, &q, &e), ERR_LIMIT, e, "row 7");
    assert_null(q.block);
    g.mean_m[3 * 7 + 2] = 0;
    float *fields[] = {&g.mean_m[9],        &g.scale_log[9], &g.quat_wxyz[12],
                       &g.opacity_logit[3], &g.sh[3 * 12],   &g.embed[3]};
    for (size_t i = 0; i < 6; i++)
        for (int k = 0; k < 2; k++) {
            float old = *fields[i];
            *fields[i] = k ? NAN : INFINITY;
            kit_fails(quant_from_gauss(&g, 1, NULL, &q, &e), ERR_DATA, e, "row 3");
            *fields[i] = old;
        }
    memset(g.quat_wxyz + 8, 0, 16);
    kit_fails(quant_from_gauss(&g, 1, NULL, &q, &e), ERR_DATA, e, "row 2");
    gauss_free(&g);
}

/* Where 12 bits behind the point are too few or too many: what the range and the sizes ask for. */
static void test_position_bits_fit_the_tile(void **state)
{
    static const struct {
        double half_m, sigma_m;
        uint8_t steps_log2;
        uint32_t frac_bits, zero_bits;
    } cases[] = {
        {100, 0.5, 0, 12, 0}, {2047, 0.5, 0, 12, 0},  {2049, 0.5, 0, 11, 0}, {60000, 20, 0, 7, 0},
        {100, 0.5, 6, 12, 5}, {100, 0.5, 8, 12, 3},   {100, 32, 6, 12, 11},  {3, 0.001, 6, 16, 0},
        {3, 0.001, 8, 18, 0}, {300, 0.001, 8, 14, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct gauss g, back;
        struct quant q, again;
        struct buf b = {0};
        struct err e = {0};
        uint32_t all = 0;
        const struct quant_grid grid = {.position = cases[i].steps_log2};
        kit_gauss(i, 101, cases[i].half_m, 0, 0, &g);
        g.mean_m[0] = (float)cases[i].half_m;
        for (size_t k = 0; k < 3 * g.n; k++)
            g.scale_log[k] = (float)log(cases[i].sigma_m);
        kit_ok(quant_from_gauss(&g, 0, &grid, &q, &e), e);
        assert_int_equal(q.frac_bits, cases[i].frac_bits);
        for (size_t k = 0; k < 3 * q.n; k++)
            all |= (uint32_t)q.position[k];
        assert_int_equal(all & ((1u << cases[i].zero_bits) - 1), 0);
        assert_int_not_equal(all & ((2u << cases[i].zero_bits) - 1), 0);
        kit_ok(spz_encode(&q, 3, &b, &e), e);
        kit_ok(spz_decode(b.data, b.size, NULL, &again, &e), e);
        quant_kit_same(&q, &again);
        kit_ok(quant_to_gauss(&again, &back, &e), e);
        double step = ldexp(1, (int)cases[i].zero_bits - (int)q.frac_bits);
        assert_true(step <= cases[i].sigma_m / 16);
        for (size_t k = 0; k < 3 * g.n; k++)
            assert_true(fabs((double)back.mean_m[k] - (double)g.mean_m[k]) <=
                        step / 2 + 1e-7 * cases[i].half_m);
        buf_free(&b);
        quant_free(&q);
        quant_free(&again);
        gauss_free(&back);
        gauss_free(&g);
    }
}

/* What a preset leaves out is left out of every value, and no value is further off than half of its
 * step, but where rows need only look alike (test_quant_look.c). */
static void test_presets_keep_to_their_steps(void **state)
{
    struct gauss g;
    struct quant q, fine;
    struct err e = {0};
    kit_gauss(8, 4000, 60, 3, 4, &g);
    const struct quant_grid all = {0, 0, 0, 0, 0, {0, 0, 0}, 0, 3, 0};
    kit_ok(quant_from_gauss(&g, 3, &all, &fine, &e), e);
    for (int p = 0; p < QUANT_PRESETS; p++) {
        const struct quant_grid *grid = quant_preset_grid((enum quant_preset)p);
        kit_ok(quant_from_gauss(&g, 3, grid, &q, &e), e);
        assert_int_equal(q.sh_degree, grid->sh_degree);
        size_t row = 3 * (gauss_sh_count(q.sh_degree) - 1);
        for (size_t i = 0; i < q.n; i++) {
            const struct {
                const uint8_t *got, *want;
                size_t n;
                int shift;
            } f[] = {{q.alpha + i, fine.alpha + i, 1, grid->alpha},
                     {q.color + 3 * i, fine.color + 3 * i, 3, grid->color},
                     {q.scale + 3 * i, fine.scale + 3 * i, 3, grid->scale},
                     {q.sh + row * i, fine.sh + 45 * i, 9, grid->sh[0]},
                     {q.sh + row * i + 9, fine.sh + 45 * i + 9, row > 9 ? 15 : 0, grid->sh[1]},
                     {q.sh + row * i + 24, fine.sh + 45 * i + 24, row > 24 ? 21 : 0, grid->sh[2]},
                     {q.embed + 4 * i, fine.embed + 4 * i, 4, grid->embed}};
            for (size_t k = 0; k < sizeof f / sizeof *f; k++)
                for (size_t c = 0; c < f[k].n; c++) {
                    int step = 1 << f[k].shift, v = f[k].got[c];
                    assert_true(v % step == 0 || v == 255);
                    /* fine is rounded itself */
                    assert_true(grid->look || abs(v - f[k].want[c]) <= step / 2 + (step > 1));
                }
            for (int at = 0; at < 30; at += 10) {
                uint32_t mag = q.rotation[i] >> at & 511;
                assert_true(mag % (1u << grid->rotation) == 0 || mag == 511);
            }
        }
        quant_free(&q);
    }
    quant_free(&fine);
    gauss_free(&g);
}

static void test_round_trip(void **state)
{
    static const size_t counts[] = {1, 2, 1000};
    for (size_t i = 0; i < 24; i++) {
        struct gauss g;
        struct quant q, back;
        struct buf b = {0}, again = {0};
        struct err e = {0};
        int version = i & 1 ? 4 : 3;
        kit_gauss(i, counts[i % 3], 2000, (uint32_t)i % 4, 0, &g);
        g.antialiased = i & 2;
        kit_ok(quant_from_gauss(&g, (uint32_t)i % 4, NULL, &q, &e), e);
        kit_ok(spz_encode(&q, version, &b, &e), e);
        kit_ok(spz_decode(b.data, b.size, NULL, &back, &e), e);
        quant_kit_same(&q, &back);
        kit_ok(spz_encode(&back, version, &again, &e), e);
        assert_int_equal(b.size, again.size);
        assert_memory_equal(b.data, again.data, b.size);
        buf_free(&b);
        buf_free(&again);
        quant_free(&q);
        quant_free(&back);
        gauss_free(&g);
    }
}

/* gzip by zlib, so that our own compressor does not judge itself. */
static void gzip(const struct buf *plain, struct buf *out)
{
    z_stream z = {0};
    assert_int_equal(deflateInit2(&z, 9, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY), Z_OK);
    out->size = 0;
    z.next_in = plain->data;
    z.avail_in = (uInt)plain->size;
    uLong bound = deflateBound(&z, plain->size);
    z.next_out = buf_grow(out, bound);
    z.avail_out = (uInt)bound;
    assert_int_equal(deflate(&z, Z_FINISH), Z_STREAM_END);
    out->size = z.total_out;
    deflateEnd(&z);
}

static void spz_head(struct buf *b, uint32_t version, uint32_t n, unsigned degree, unsigned bits,
                     unsigned flags)
{
    b->size = 0;
    buf_u32(b, 0x5053474e);
    buf_u32(b, version);
    buf_u32(b, n);
    buf_u8(b, degree);
    buf_u8(b, bits);
    buf_u8(b, flags);
    buf_u8(b, 0);
}

/* Bytes written by hand after the published layout. */
static void test_reads_version_2_and_3_by_the_book(void **state)
{
    struct buf plain = {0}, z = {0};
    struct quant q;
    struct gauss g;
    struct err e = {0};
    for (uint32_t version = 2; version <= 3; version++) {
        spz_head(&plain, version, 1, 1, 11, 1);
        buf_add(&plain, (const uint8_t[]){0x00, 0x08, 0x00, 0xff, 0xff, 0xff, 0x01, 0x00, 0x00}, 9);
        buf_u8(&plain, 51);                                   /* alpha 0.2 */
        buf_add(&plain, (const uint8_t[]){255, 0, 128}, 3);   /* color */
        buf_add(&plain, (const uint8_t[]){160, 176, 144}, 3); /* ln sigma 0, 1, -1 */
        if (version == 2)
            buf_add(&plain, (const uint8_t[]){255, 128, 128}, 3); /* half a turn about x */
        else /* largest z (2); x = -511/511/sqrt2, y = 0, w = 0 */
            buf_u32(&plain, 2u << 30 | (512u + 511) << 20 | 512u << 10 | 0);
        for (unsigned i = 0; i < 9; i++)
            buf_u8(&plain, 96 + 8 * i);
        gzip(&plain, &z);
        kit_ok(spz_decode(z.data, z.size, NULL, &q, &e), e);
        assert_true(q.antialiased);
        assert_int_equal(q.frac_bits, 11);
        assert_int_equal(q.position[0], 2048); /* of 1/2048 m is 1 m */
        assert_int_equal(q.position[1], -1);
        assert_int_equal(q.position[2], 1);
        kit_ok(quant_to_gauss(&q, &g, &e), e);
        assert_true(g.mean_m[0] == 1 && g.scale_log[0] == 0 && g.scale_log[1] == 1 &&
                    g.scale_log[2] == -1);
        assert_true(fabs(sigmoid((double)g.opacity_logit[0]) - 0.2) < 1e-6);
        assert_true(fabs((double)g.sh[0] - 0.5 / 0.15) < 1e-5 &&
                    fabs((double)g.sh[1] + 0.5 / 0.15) < 1e-5);
        for (int i = 0; i < 9; i++)
            assert_true(g.sh[3 + i] == (float)(8 * i - 32) / 128);
        const double want2[4] = {0, 1, 0.00392, 0.00392}, want3[4] = {0, -0.70711, 0, 0.70711};
        kit_near("rotation", g.quat_wxyz, version == 2 ? want2 : want3, 4, 0.003, 0);
        gauss_free(&g);
        quant_free(&q);
    }
    buf_free(&plain);
    buf_free(&z);
}

/* Version 1 has positions of 16-bit floats. */
static void test_reads_version_1_by_the_book(void **state)
{
    struct buf plain = {0}, z = {0};
    struct quant q;
    struct gauss g;
    struct err e = {0};
    static const uint16_t halves[3] = {0x3c00, 0xc500, 0x6b80}; /* 1, -5, 3840 */
    for (int k = 0; k < 2; k++) {
        spz_head(&plain, 1, 1, 0, 0, 0);
        for (int c = 0; c < 3; c++)
            buf_u16(&plain, k && c == 1 ? 0x7c00 : halves[c]); /* infinity */
        buf_add(&plain, (const uint8_t[]){51, 128, 128, 128, 160, 160, 160, 255, 128, 128}, 10);
        gzip(&plain, &z);
        if (k) {
            kit_fails(spz_decode(z.data, z.size, NULL, &q, &e), ERR_FORMAT, e, "row 0");
            continue;
        }
        kit_ok(spz_decode(z.data, z.size, NULL, &q, &e), e);
        kit_ok(quant_to_gauss(&q, &g, &e), e);
        const double want[3] = {1, -5, 3840}, turn[4] = {0, 1, 0.00392, 0.00392};
        kit_near("position", g.mean_m, want, 3, 1e-3, 0);
        kit_near("rotation", g.quat_wxyz, turn, 4, 0.003, 0);
        gauss_free(&g);
        quant_free(&q);
    }
    buf_free(&plain);
    buf_free(&z);
}

/* The basis of harmonics of degrees 1 to 3, but for its factors. */
static void basis(const double d[3], double out[15])
{
    const double x = d[0], y = d[1], z = d[2];
    const double b[15] = {y,
                          z,
                          x,
                          x * y,
                          y * z,
                          2 * z * z - x * x - y * y,
                          x * z,
                          x * x - y * y,
                          y * (3 * x * x - y * y),
                          x * y * z,
                          y * (4 * z * z - x * x - y * y),
                          z * (2 * z * z - 3 * x * x - 3 * y * y),
                          x * (4 * z * z - x * x - y * y),
                          z * (x * x - y * y),
                          x * (x * x - 3 * y * y)};
    memcpy(out, b, sizeof b);
}

/* The least number of 24 bits is a place as any other, also where its axis is mirrored. */
static void test_the_least_coordinate_is_read(void **state)
{
    const int32_t most = (1 << 23) - 1;
    struct buf plain = {0}, z = {0}, again = {0};
    struct quant q, back;
    struct err e = {0};
    for (uint32_t axes = 4; axes <= 5; axes++) { /* those of glTF, and all three mirrored */
        spz_head(&plain, 3, 1, 0, 12, 2);
        buf_add(&plain, (const uint8_t[]){0, 0, 0x80, 1, 0, 0x80, 255, 255, 0x7f}, 9);
        buf_add(&plain, (const uint8_t[]){51, 255, 0, 128, 160, 176, 144}, 7);
        buf_u32(&plain, 3u << 30);
        buf_u32(&plain, 0xadbe0003);
        buf_u32(&plain, 4);
        buf_u32(&plain, axes);
        gzip(&plain, &z);
        kit_ok(spz_decode(z.data, z.size, NULL, &q, &e), e);
        const int32_t s = axes == 4 ? 1 : -1;
        for (int c = 0; c < 3; c++)
            assert_int_equal(q.position[c], s * (c < 2 ? -most : most));
        kit_ok(spz_encode(&q, 3, &again, &e), e);
        kit_ok(spz_decode(again.data, again.size, NULL, &back, &e), e);
        assert_memory_equal(back.position, q.position, 3 * sizeof *q.position);
        quant_free(&q);
        quant_free(&back);
        buf_free(&plain);
        buf_free(&z);
        buf_free(&again);
    }
}

/* A record says which way the axes go: what is read is the same thing in glTF's. */
static void test_other_axes_are_turned(void **state)
{
    struct gauss g, back;
    struct quant q, other;
    struct buf plain = {0}, z = {0};
    struct err e = {0};
    kit_gauss(9, 50, 20, 3, 0, &g);
    kit_ok(quant_from_gauss(&g, 3, NULL, &q, &e), e);
    gauss_free(&g);
    kit_ok(quant_to_gauss(&q, &g, &e), e);
    for (uint32_t axes = 0; axes <= 9; axes++) {
        const bool known = axes >= 1 && axes <= 8;
        const double s[3] = {known && !((axes - 1) & 1) ? -1 : 1,
                             known && !((axes - 1) & 2) ? -1 : 1, axes >= 5 && known ? -1 : 1};
        spz_head(&plain, 3, (uint32_t)q.n, 3, q.frac_bits, 2);
        for (size_t i = 0; i < 3 * q.n; i++)
            for (int b = 0; b < 3; b++)
                buf_u8(&plain, (uint32_t)q.position[i] >> 8 * b & 255);
        buf_add(&plain, q.alpha, q.n);
        buf_add(&plain, q.color, 3 * q.n);
        buf_add(&plain, q.scale, 3 * q.n);
        for (size_t i = 0; i < q.n; i++)
            buf_u32(&plain, q.rotation[i]);
        buf_add(&plain, q.sh, 45 * q.n);
        buf_u32(&plain, 0x4e530001); /* another record, then that of axes */
        buf_u32(&plain, 3);
        buf_add(&plain, "abc", 3);
        buf_u32(&plain, 0xadbe0003);
        buf_u32(&plain, 4);
        buf_u32(&plain, axes);
        gzip(&plain, &z);
        log_set_level(LOG_ERROR);
        kit_ok(spz_decode(z.data, z.size, NULL, &other, &e), e);
        log_set_level(LOG_WARN);
        kit_ok(quant_to_gauss(&other, &back, &e), e);
        for (size_t i = 0; i < g.n; i++) {
            double r[9], t[9], d[3], was[15], is[15];
            const float *a = &g.quat_wxyz[4 * i], *b = &back.quat_wxyz[4 * i];
            camera_quat_to_rot((double[4]){(double)a[0], (double)a[1], (double)a[2], (double)a[3]},
                               r);
            camera_quat_to_rot((double[4]){(double)b[0], (double)b[1], (double)b[2], (double)b[3]},
                               t);
            for (int c = 0; c < 9; c++)
                assert_true(fabs(t[c] - s[c / 3] * s[c % 3] * r[c]) < 1e-5);
            for (int c = 0; c < 3; c++) {
                assert_true(back.mean_m[3 * i + c] == (float)s[c] * g.mean_m[3 * i + c]);
                d[c] = rng_normal(4, i, (uint64_t)c);
            }
            basis(d, was);
            basis((double[3]){s[0] * d[0], s[1] * d[1], s[2] * d[2]}, is);
            for (int k = 0; k < 15; k++) /* a step of -128 has no counterpart */
                assert_true(fabs(is[k] * (double)back.sh[48 * i + 3 + 3 * k] -
                                 was[k] * (double)g.sh[48 * i + 3 + 3 * k]) <=
                            fabs(was[k]) / 128 + 1e-9);
        }
        gauss_free(&back);
        quant_free(&other);
    }
    gauss_free(&g);
    quant_free(&q);
    buf_free(&plain);
    buf_free(&z);
}

/* The bytes we write, field by field, after unpacking with zlib. */
static void test_writes_version_3_by_the_book(void **state)
{
    struct gauss g = {0};
    struct quant q;
    struct buf b = {0};
    struct err e = {0};
    kit_ok(gauss_alloc(&g, 1, 1, 0, &e), e);
    g.n = 1;
    const float mean[3] = {1.5f, -0.25f, 2047.5f}, quat[4] = {0, 0, -2, 0};
    memcpy(g.mean_m, mean, sizeof mean);
    memcpy(g.quat_wxyz, quat, sizeof quat);
    for (int i = 0; i < 9; i++)
        g.sh[3 + i] = (float)(i - 4) * 0.3f;
    g.scale_log[1] = -20;
    g.scale_log[2] = 20;
    kit_ok(quant_from_gauss(&g, 1, NULL, &q, &e), e);
    kit_ok(spz_encode(&q, 3, &b, &e), e);
    uint8_t out[64];
    z_stream z = {
        .next_in = b.data, .avail_in = (uInt)b.size, .next_out = out, .avail_out = sizeof out};
    assert_int_equal(inflateInit2(&z, 15 + 16), Z_OK);
    assert_int_equal(inflate(&z, Z_FINISH), Z_STREAM_END);
    inflateEnd(&z);
    static const uint8_t want[] = {
        'N', 'G', 'S', 'P', 3, 0, 0, 0, 1, 0, 0, 0, 1, 12, 0, 0, 0x00, 0x18, 0x00, 0x00, 0xfc, 0xff,
        0x00, 0xf8, 0x7f,                          /* 6144, -1024, 8386560 */
        128,                                       /* opacity 0.5 */
        128, 128, 128, 160, 0, 255, 0, 0, 0, 0x40, /* largest is y (1), the others 0 */
        /* 128 c + 128 in steps of 8: -1.2 -0.9 -0.6 -0.3 0 0.3 0.6 0.9 1.2 */
        0, 16, 48, 88, 128, 168, 208, 240, 255};
    assert_int_equal(z.total_out, sizeof want);
    assert_memory_equal(out, want, sizeof want);
    buf_free(&b);
    quant_free(&q);
    gauss_free(&g);
}

static const struct quant_kit decoder = {spz_decode};
static const struct torture torture = {
    .name = "spz", .decode = quant_kit_decode, .user = &decoder, .errors = TORTURE(ERR_LIMIT)};

static void test_truncation_and_flips(void **state)
{
    for (int version = 3; version <= 4; version++) {
        struct gauss g;
        struct quant q;
        struct buf b = {0};
        struct err e = {0};
        kit_gauss(5, 30, 100, 1, 0, &g);
        kit_ok(quant_from_gauss(&g, 1, NULL, &q, &e), e);
        kit_ok(spz_encode(&q, version, &b, &e), e);
        torture_cuts(&torture, &b, 1);
        torture_flips(&torture, &b, 0, 3, 3000);
        buf_u8(&b, 0);
        kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "spz");
        buf_free(&b);
        quant_free(&q);
        gauss_free(&g);
    }
}

static void test_hostile_counts(void **state)
{
    struct buf plain = {0}, z = {0};
    struct err e = {0};
    size_t before = mem_peak_bytes();
    spz_head(&plain, 3, 60000000, 3, 12, 0); /* within the limit, but not in the file */
    gzip(&plain, &z);
    kit_fails(torture_decode(&torture, z.data, z.size, NULL, &e), ERR_FORMAT, e, "cut short");
    memcpy(z.data + z.size - 4, "\xff\xff\xff\x7f", 4); /* gzip claims 2 GiB */
    kit_fails(torture_decode(&torture, z.data, z.size, NULL, &e), ERR_FORMAT, e, "spz");
    spz_head(&plain, 3, 0xffffffff, 3, 12, 0);
    gzip(&plain, &z);
    kit_fails(torture_decode(&torture, z.data, z.size, NULL, &e), ERR_LIMIT, e, "4294967295");
    spz_head(&plain, 9, 1, 3, 12, 0);
    gzip(&plain, &z);
    kit_fails(torture_decode(&torture, z.data, z.size, NULL, &e), ERR_FORMAT, e, "version 9");
    spz_head(&plain, 3, 1, 4, 12, 0);
    gzip(&plain, &z);
    kit_fails(torture_decode(&torture, z.data, z.size, NULL, &e), ERR_FORMAT, e, "degree 4");
    spz_head(&plain, 4, 60000000, 0, 12, 0); /* version 4: streams that claim to grow without end */
    plain.data[15] = 5;
    buf_u32(&plain, 32);
    buf_add(&plain, (const uint8_t[12]){0}, 12);
    static const uint64_t rows[] = {9, 1, 3, 3, 4};
    for (int s = 0; s < 5; s++) {
        buf_u64(&plain, 10);
        buf_u64(&plain, 60000000 * rows[s]);
    }
    buf_add(&plain, (const uint8_t[50]){0}, 50);
    kit_fails(torture_decode(&torture, plain.data, plain.size, NULL, &e), ERR_FORMAT, e,
              "do not fit");
    assert_true(mem_peak_bytes() - before < (64u << 20));
    buf_free(&plain);
    buf_free(&z);
}

static void test_out_of_memory(void **state)
{
    for (int version = 3; version <= 4; version++) {
        struct gauss g;
        struct quant q, back;
        struct buf b = {0};
        struct err e = {0};
        kit_gauss(6, 20, 100, 2, 0, &g);
        kit_out_of_memory(quant_from_gauss(&g, 2, NULL, &q, &e), 1, e);
        kit_out_of_memory((buf_free(&b), spz_encode(&q, version, &b, &e)), 1, e);
        kit_out_of_memory(spz_decode(b.data, b.size, NULL, &back, &e), 1, e);
        quant_kit_same(&q, &back);
        quant_free(&q);
        quant_free(&back);
        gauss_free(&g);
        buf_free(&b);
    }
}

/* A record of an extension, between the head of version 4 and the sizes of its streams. */
static void test_records_are_passed_over(void **state)
{
    enum { FLAGS = 14, SIZES_AT = 16, HEAD = 32, RECORD = 8 + 4 };
    static const uint8_t record[RECORD] = {1, 0, 'S', 'N', 4, 0, 0, 0, 'b', 'a', 's', 'e'};
    struct err e = {0};
    struct gauss g;
    struct quant q = {0}, back = {0};
    struct buf without = {0}, with = {0};
    kit_gauss(3, 50, 20, 2, 0, &g);
    kit_ok(quant_from_gauss(&g, 2, quant_preset_grid(QUANT_SPZ), &q, &e), e);
    kit_ok(spz_encode(&q, 4, &without, &e), e);
    assert_int_equal(without.data[SIZES_AT], HEAD);
    buf_add(&with, without.data, HEAD);
    buf_add(&with, record, RECORD);
    buf_add(&with, without.data + HEAD, without.size - HEAD);
    kit_ok(buf_check(&with, &e), e);
    with.data[FLAGS] |= 2;
    with.data[SIZES_AT] += RECORD;
    kit_ok(spz_decode(with.data, with.size, NULL, &back, &e), e);
    assert_int_equal(back.n, q.n);
    assert_memory_equal(back.position, q.position, 3 * q.n * sizeof *q.position);
    assert_memory_equal(back.sh, q.sh, 3 * 8 * q.n);
    quant_free(&back);
    quant_free(&q);
    gauss_free(&g);
    buf_free(&with);
    buf_free(&without);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values_within_half_a_step),
        cmocka_unit_test(test_quantising_twice_is_quantising_once),
        cmocka_unit_test(test_degrees),
        cmocka_unit_test(test_position_bits_fit_the_tile),
        cmocka_unit_test(test_presets_keep_to_their_steps),
        cmocka_unit_test(test_refuses_what_cannot_be_written),
        cmocka_unit_test(test_round_trip),
        cmocka_unit_test(test_reads_version_2_and_3_by_the_book),
        cmocka_unit_test(test_reads_version_1_by_the_book),
        cmocka_unit_test(test_the_least_coordinate_is_read),
        cmocka_unit_test(test_other_axes_are_turned),
        cmocka_unit_test(test_writes_version_3_by_the_book),
        cmocka_unit_test(test_truncation_and_flips),
        cmocka_unit_test(test_hostile_counts),
        cmocka_unit_test(test_out_of_memory),
        cmocka_unit_test(test_records_are_passed_over),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
