/* .drc: the integers of .spz, bit for bit, and hostile files refused before libdraco allocates for
 * them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/splat/draco.h"
#include "codec/splat/draco_layout.h"
#include "codec/splat/glb.h"
#include "codec/splat/spz.h"
#include "tests/codec/quant_kit.h"
#include "tests/kit.h"

#include <math.h>
#include <string.h>

static void test_round_trip_is_exact(void **state)
{
    static const size_t counts[] = {1, 2, 700};
    for (uint32_t i = 0; i < 24; i++) {
        struct gauss g;
        struct quant q, back;
        struct buf b = {0}, again = {0};
        struct err e = {0};
        kit_gauss(i, counts[i % 3], 2000, i % 4, i & 1 ? 16 : 0, &g);
        g.antialiased = i & 4;
        g.mean_m[0] = -2047.999f; /* both ends of the range */
        g.mean_m[1] = 2047.999f;
        g.quat_wxyz[0] = g.quat_wxyz[1] = g.quat_wxyz[2] = g.quat_wxyz[3] = -0.5f;
        kit_ok(quant_from_gauss(&g, i % 4, NULL, &q, &e), e);
        kit_ok(draco_encode(&q, "18/137561/91234", &b, &e), e);
        kit_ok(draco_decode(b.data, b.size, NULL, &back, &e), e);
        quant_kit_same(&q, &back);
        kit_ok(draco_encode(&back, "18/137561/91234", &again, &e), e);
        assert_int_equal(b.size, again.size);
        assert_memory_equal(b.data, again.data, b.size);
        buf_free(&b);
        buf_free(&again);
        quant_free(&q);
        quant_free(&back);
        gauss_free(&g);
    }
}

/* The same integers through .spz, the SPZ of a .glb, and .drc: one picture, whatever the container,
 * for every preset; and an .spz turned into a .drc is the .drc of the same preset, byte for byte.
 */
static void test_agrees_with_spz_in_every_preset(void **state)
{
    for (int i = 0; i < 4 * QUANT_PRESETS; i++) {
        struct gauss g;
        struct quant q, by_spz, by_spz4, by_glb, by_draco;
        struct buf spz = {0}, spz4 = {0}, glb = {0}, drc = {0}, turned = {0};
        const void *inside;
        size_t n_inside;
        struct err e = {0};
        uint32_t degree = (uint32_t)i % 4;
        const struct quant_grid *grid = quant_preset_grid((enum quant_preset)(i / 4));
        kit_gauss((uint64_t)i, 900, i & 1 ? 300 : 3000, degree, 0, &g);
        kit_ok(quant_from_gauss(&g, degree, grid, &q, &e), e);
        kit_ok(spz_encode(&q, 3, &spz, &e), e);
        kit_ok(spz_encode(&q, 4, &spz4, &e), e);
        kit_ok(glb_encode_spz(&q, NULL, &glb, &e), e);
        kit_ok(draco_encode(&q, NULL, &drc, &e), e);
        kit_ok(spz_decode(spz.data, spz.size, NULL, &by_spz, &e), e);
        kit_ok(spz_decode(spz4.data, spz4.size, NULL, &by_spz4, &e), e);
        kit_ok(glb_find_spz(glb.data, glb.size, &inside, &n_inside, &e), e);
        kit_ok(spz_decode(inside, n_inside, NULL, &by_glb, &e), e);
        kit_ok(draco_decode(drc.data, drc.size, NULL, &by_draco, &e), e);
        quant_kit_same(&q, &by_spz);
        quant_kit_same(&q, &by_spz4);
        quant_kit_same(&q, &by_glb);
        quant_kit_same(&q, &by_draco);
        kit_ok(draco_encode(&by_spz, NULL, &turned, &e), e);
        assert_int_equal(drc.size, turned.size);
        assert_memory_equal(drc.data, turned.data, drc.size);
        buf_free(&spz);
        buf_free(&spz4);
        buf_free(&glb);
        buf_free(&drc);
        buf_free(&turned);
        quant_free(&q);
        quant_free(&by_spz);
        quant_free(&by_spz4);
        quant_free(&by_glb);
        quant_free(&by_draco);
        gauss_free(&g);
    }
}

/* Colours and harmonics as in a trained scene: neighbours alike, channels alike. */
static void trained_like(size_t n, struct gauss *g)
{
    kit_gauss(9, n, 30, 3, 0, g);
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 48; c++) {
            double grey = rng_normal(5, c / 3, i), tint = rng_normal(6, c, i);
            g->sh[48 * i + c] = (float)(0.04 * grey + 0.006 * tint);
        }
}

/* The reason for a .drc: the same picture in 0.85 of the bytes or fewer. */
static void test_is_smaller_than_spz(void **state)
{
    struct gauss g;
    struct err e = {0};
    trained_like(20000, &g);
    for (int p = 0; p < QUANT_PRESETS; p++) {
        struct quant q;
        struct buf spz = {0}, drc = {0};
        kit_ok(quant_from_gauss(&g, 3, quant_preset_grid((enum quant_preset)p), &q, &e), e);
        kit_ok(spz_encode(&q, 3, &spz, &e), e);
        kit_ok(draco_encode(&q, NULL, &drc, &e), e);
        if (!((double)drc.size < 0.85 * (double)spz.size))
            fail_msg("preset %s: %zu bytes as .drc, %zu as .spz",
                     quant_preset_name((enum quant_preset)p), drc.size, spz.size);
        buf_free(&spz);
        buf_free(&drc);
        quant_free(&q);
    }
    gauss_free(&g);
}

/* SH bytes of foreign .spz files may lie between our buckets, and must not be lost. */
static void test_foreign_sh_bytes(void **state)
{
    struct quant q, back;
    struct buf b = {0};
    struct err e = {0};
    kit_ok(quant_alloc(&q, 50, 2, 0, &e), e);
    for (size_t i = 0; i < 50 * 24; i++)
        q.sh[i] = (uint8_t)(i * 7);
    kit_ok(draco_encode(&q, NULL, &b, &e), e);
    kit_ok(draco_decode(b.data, b.size, NULL, &back, &e), e);
    quant_kit_same(&q, &back);
    buf_free(&b);
    quant_free(&q);
    quant_free(&back);
}

static void write_crc(struct buf *b)
{
    uint32_t crc = draco_crc(b->data, b->size - DRACO_CRC_BYTES);
    memcpy(b->data + b->size - DRACO_CRC_BYTES, &crc, DRACO_CRC_BYTES);
}

static const struct quant_kit decoder = {draco_decode};
static const struct torture torture = {.name = "draco",
                                       .decode = quant_kit_decode,
                                       .user = &decoder,
                                       .errors = TORTURE(ERR_LIMIT) | TORTURE(ERR_MEM),
                                       .mend = write_crc};

static void sample(size_t n, uint32_t degree, struct buf *b)
{
    struct gauss g;
    struct quant q;
    struct err e = {0};
    kit_gauss(41, n, 100, degree, 2, &g);
    kit_ok(quant_from_gauss(&g, degree, NULL, &q, &e), e);
    kit_ok(draco_encode(&q, "t", b, &e), e);
    quant_free(&q);
    gauss_free(&g);
}

static void test_truncation(void **state)
{
    struct buf b = {0};
    sample(30, 1, &b);
    torture_cuts(&torture, &b, 1);
    buf_free(&b);
}

static void test_flips(void **state)
{
    struct buf b = {0};
    sample(60, 2, &b);
    torture_flips(&torture, &b, 0, 4, 2000);
    buf_free(&b);
}

/* Where the point count stands: the only place of this value before the list of attributes. */
static size_t find_count(const struct buf *b, uint32_t n)
{
    for (size_t i = 11; i + 4 <= b->size; i++) {
        uint32_t v;
        memcpy(&v, b->data + i, 4);
        if (v == n)
            return i;
    }
    fail_msg("count not found");
    return 0;
}

static void test_hostile_counts(void **state)
{
    struct buf b = {0};
    struct err e = {0};
    sample(7777, 0, &b);
    struct codec_limits lim = {.max_gaussians = 7776};
    kit_fails(torture_decode(&torture, b.data, b.size, &lim, &e), ERR_LIMIT, e, "7777");
    size_t at = find_count(&b, 7777), before = mem_peak_bytes();
    uint32_t n = 0x7fffffff;
    memcpy(b.data + at, &n, 4);
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_LIMIT, e, "2147483647");
    n = 0;
    memcpy(b.data + at, &n, 4);
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "0 points");
    buf_free(&b);
    sample(33, 0, &b);
    at = find_count(&b, 33);
    n = 60000000;
    memcpy(b.data + at, &n, 4);
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "60000000 points");
    assert_true(mem_peak_bytes() - before < (64u << 20));
    buf_free(&b);
}

static void test_other_draco_files(void **state)
{
    struct buf b = {0};
    struct err e = {0};
    sample(20, 0, &b);
    b.data[7] = 1; /* a mesh */
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "type 1");
    b.data[7] = 0;
    b.data[8] = 1; /* kd-tree */
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "method 1");
    kit_fails(torture_decode(&torture, (const uint8_t *)"PK\3\4 not Draco at all", 22, NULL, &e),
              ERR_FORMAT, e, "not a Draco file");
    buf_free(&b);
    struct quant q = {0};
    kit_fails(draco_encode(&q, NULL, &b, &e), ERR_LIMIT, e, "0 Gaussians");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip_is_exact),
        cmocka_unit_test(test_agrees_with_spz_in_every_preset),
        cmocka_unit_test(test_is_smaller_than_spz),
        cmocka_unit_test(test_foreign_sh_bytes),
        cmocka_unit_test(test_truncation),
        cmocka_unit_test(test_flips),
        cmocka_unit_test(test_hostile_counts),
        cmocka_unit_test(test_other_draco_files),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
