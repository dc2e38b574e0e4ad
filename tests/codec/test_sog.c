/* .sog: values come back within the steps of its textures, in our axes; hostile files are refused.
 * tests/web/readers.test.mjs tests files with PlayCanvas' own reader.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/archive.h"
#include "codec/image/webp.h"
#include "codec/limits.h"
#include "codec/splat/cluster.h"
#include "codec/splat/sog.h"
#include "codec/splat/sog_layout.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define QUAT_STEP (0.5 / 255 * 1.4142136) /* half a step of a component that is kept */
#define OPACITY_STEP (0.5 / 255 + 1e-6)
#define FIRST_TOL 1e-5 /* floats below 10 */

static double sigmoid(double x)
{
    return 1 / (1 + exp(-x));
}

static void trip(const struct gauss *g, uint32_t degree, struct gauss *back)
{
    struct buf b = {0};
    struct err e = {0};
    kit_ok(sog_encode(g, degree, &b, &e), e);
    kit_ok(sog_decode(b.data, b.size, NULL, back, &e), e);
    buf_free(&b);
    assert_int_equal(back->n, g->n);
    assert_int_equal(back->sh_degree, degree);
    assert_int_equal(back->antialiased, g->antialiased);
}

/* Root mean square of a - b over n values, as a share of that of b about their mean. */
static double share_lost(const float *a, const float *b, size_t n)
{
    double mean = 0, off = 0, spread = 0;
    for (size_t i = 0; i < n; i++)
        mean += (double)b[i] / (double)n;
    for (size_t i = 0; i < n; i++) {
        off += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
        spread += ((double)b[i] - mean) * ((double)b[i] - mean);
    }
    return sqrt(off / spread);
}

static void test_values(void **state)
{
    struct gauss g, back;
    kit_gauss(1, 3000, 60, 3, 4, &g);
    g.antialiased = true;
    trip(&g, 3, &back);
    for (size_t i = 0; i < g.n; i++) {
        double dot = 0, n2 = 0;
        for (size_t c = 0; c < 3; c++) {
            /* a step of ln(1 + |p|), over 2 ln(61) at most, at p */
            double p = (double)g.mean_m[3 * i + c], step = 2 * log1p(60) / 65535 * (1 + fabs(p));
            assert_true(fabs((double)back.mean_m[3 * i + c] - p) <= 0.51 * step + 1e-5);
        }
        for (size_t c = 0; c < 4; c++) {
            dot += (double)g.quat_wxyz[4 * i + c] * (double)back.quat_wxyz[4 * i + c];
            n2 += (double)g.quat_wxyz[4 * i + c] * (double)g.quat_wxyz[4 * i + c];
        }
        /* three components half a step off, and what they make of the fourth */
        assert_true(2 * acos(fmin(1, fabs(dot) / sqrt(n2))) <= 2 * 3.5 * QUAT_STEP);
        assert_true(fabs(sigmoid((double)g.opacity_logit[i]) -
                         sigmoid((double)back.opacity_logit[i])) <= OPACITY_STEP);
    }
    assert_true(share_lost(back.scale_log, g.scale_log, 3 * g.n) < 0.01);
    gauss_free(&g);
    gauss_free(&back);
}

/* Few different harmonics: the palette has them all, and the codebook their values. */
static void test_harmonics(void **state)
{
    for (uint32_t degree = 0; degree <= 3; degree++) {
        struct gauss g, back;
        kit_gauss(2, 2000, 20, 3, 0, &g);
        const size_t all = 48, kept = 3 * gauss_sh_count(degree);
        for (size_t i = 0; i < g.n; i++)
            for (size_t c = 0; c < all; c++)
                g.sh[all * i + c] = (float)((int)((i % 5) * (c + 1)) % 7 - 3) / 8;
        trip(&g, degree, &back);
        for (size_t i = 0; i < g.n; i++)
            for (size_t c = 0; c < kept; c++)
                assert_true(fabsf(back.sh[kept * i + c] - g.sh[all * i + c]) < 1e-6f);
        gauss_free(&g);
        gauss_free(&back);
    }
}

static void test_palette_keeps_most(void **state)
{
    struct gauss g, back;
    kit_gauss(3, 20000, 20, 3, 0, &g);
    for (size_t i = 0; i < g.n; i++) /* harmonics that follow 40 looks, as those of surfaces do */
        for (size_t c = 3; c < 48; c++)
            g.sh[48 * i + c] = (float)(0.2 * rng_normal(4, i % 40, c) + 0.01 * rng_normal(5, i, c));
    trip(&g, 3, &back);
    assert_true(share_lost(back.sh, g.sh, 48 * g.n) < 0.05);
    gauss_free(&g);
    gauss_free(&back);
}

static void test_one_and_equal(void **state)
{
    struct gauss g, back;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(6, 5, 1, 1, 0, &g);
    for (size_t n = 5; n; n = n == 5 ? 1 : 0) { /* five equal ones, one */
        for (size_t i = 1; i < n; i++)
            gauss_copy_row(&g, i, &g, 0);
        g.n = n;
        trip(&g, 1, &back);
        for (size_t c = 0; c < 3; c++)
            assert_true(fabsf(back.mean_m[c] - g.mean_m[c]) < 1e-5f);
        gauss_free(&back);
    }
    g.n = 0;
    assert_int_equal(sog_encode(&g, 1, &b, &e), ERR_DATA);
    g.n = 1;
    assert_int_equal(sog_encode(&g, 2, &b, &e), ERR_ARG);
    g.mean_m[1] = NAN;
    assert_int_equal(sog_encode(&g, 1, &b, &e), ERR_DATA);
    assert_non_null(strstr(e.msg, "row 0"));
    buf_free(&b);
    gauss_free(&g);
}

static void test_same_bytes(void **state)
{
    struct gauss g;
    struct buf a = {0}, b = {0};
    struct err e = {0};
    kit_gauss(7, 1500, 30, 3, 0, &g);
    kit_ok(sog_encode(&g, 3, &a, &e), e);
    setenv("TZ", "Pacific/Auckland", 1); /* an archive's dates are local */
    kit_ok(sog_encode(&g, 3, &b, &e), e);
    unsetenv("TZ");
    assert_int_equal(a.size, b.size);
    assert_memory_equal(a.data, b.data, a.size);
    buf_free(&a);
    buf_free(&b);
    gauss_free(&g);
}

/* ---- codebooks ---- */

static void test_codebook(void **state)
{
    enum { N = 5000 };
    static float v[N];
    static uint8_t index[N];
    float book[CLUSTER_BOOK];
    struct err e = {0};
    double off = 0, even = 0;
    for (size_t i = 0; i < N; i++)
        v[i] = (float)rng_normal(8, 0, i);
    v[17] = 100; /* one far away must not cost the others */
    kit_ok(cluster_values(v, N, book, index, &e), e);
    for (size_t k = 1; k < CLUSTER_BOOK; k++)
        assert_true(book[k] >= book[k - 1]);
    for (size_t i = 0; i < N; i++) {
        const double d = fabs((double)(book[index[i]] - v[i]));
        for (size_t k = 0; k < CLUSTER_BOOK; k++)
            assert_true(d <= fabs((double)(book[k] - v[i])) + 1e-6);
        off += d * d;
        even += pow(104.0 / 256, 2) / 12; /* even steps over the range */
    }
    assert_true(book[index[17]] == 100);
    assert_true(off < even / 100);
    for (size_t i = 0; i < N; i++)
        v[i] = 3;
    kit_ok(cluster_values(v, N, book, index, &e), e);
    assert_true(book[index[0]] == 3);
    for (size_t i = 0; i < N; i++)
        v[i] = (float)(i % 80);
    kit_ok(cluster_values(v, N, book, index, &e), e);
    for (size_t i = 0; i < N; i++)
        for (int off_by = -1; off_by <= 1; off_by++) /* as some clients read it */
            assert_true(book[index[i] + off_by] == v[i]);
}

/* ---- hostile ---- */

static enum err_code decode(const void *user, const void *bytes, size_t n,
                            const struct codec_limits *lim, struct err *e)
{
    struct gauss g;
    (void)user;
    enum err_code rc = sog_decode(bytes, n, lim, &g, e);
    if (rc)
        assert_null(g.block);
    gauss_free(&g);
    return rc;
}

static const struct torture torture = {
    "", decode, NULL, TORTURE(ERR_LIMIT) | TORTURE(ERR_DATA) | TORTURE(ERR_MEM), false, NULL};

static void test_torture(void **state)
{
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(9, 40, 10, 1, 0, &g);
    kit_ok(sog_encode(&g, 1, &b, &e), e);
    torture_cuts(&torture, &b, 97);
    torture_flips(&torture, &b, 0, 10, 3000);
    const struct codec_limits few = {.max_gaussians = 39};
    assert_int_equal(torture_decode(&torture, b.data, b.size, &few, &e), ERR_LIMIT);
    buf_free(&b);
    gauss_free(&g);
}

/* The archive of a small file with `from` in its meta.json turned into `to`, in a folder of it. */
static enum err_code decode_edited(const char *folder, const char *from, const char *to,
                                   struct err *e)
{
    static const char *const names[] = {"meta.json",          "means_l.webp",   "means_u.webp",
                                        "quats.webp",         "scales.webp",    "sh0.webp",
                                        "shN_centroids.webp", "shN_labels.webp"};
    struct archive_part part[8] = {{0}};
    char path[8][40];
    struct archive_reader *z;
    struct gauss g;
    struct buf b = {0}, edited = {0};
    kit_gauss(11, 40, 10, 1, 0, &g);
    kit_ok(sog_encode(&g, 1, &b, e), *e);
    gauss_free(&g);
    kit_ok(archive_open(b.data, b.size, &z, e), *e);
    for (size_t i = 0; i < 8; i++) {
        snprintf(path[i], sizeof path[i], "%s%s", folder, names[i]);
        part[i].name = path[i];
        kit_ok(archive_get(z, names[i], 1 << 20, &part[i].bytes, e), *e);
    }
    archive_close(&z);
    buf_u8(&part[0].bytes, 0);
    const char *text = (const char *)part[0].bytes.data, *at = strstr(text, from);
    assert_non_null(at);
    buf_printf(&edited, "%.*s%s%s", (int)(at - text), text, to, at + strlen(from));
    buf_free(&part[0].bytes);
    part[0].bytes = edited;
    b.size = 0;
    kit_ok(archive_write(part, 8, &b, e), *e);
    for (size_t i = 0; i < 8; i++)
        buf_free(&part[i].bytes);
    enum err_code rc = decode(NULL, b.data, b.size, NULL, e);
    buf_free(&b);
    return rc;
}

static void test_lies_in_meta(void **state)
{
    static const struct {
        const char *from, *to;
        enum err_code want;
        const char *says;
    } cases[] = {
        {"\"count\":40", "\"count\":40", ERR_OK, ""},
        {"\"version\":2", "\"version\":1", ERR_FORMAT, "version 1"},
        {"\"count\":40", "\"count\":60000000", ERR_FORMAT, "too few"},
        {"\"count\":40", "\"count\":-1", ERR_FORMAT, "-1 Gaussians"},
        {"\"count\":40", "\"count\":99000000000", ERR_LIMIT, "99000000000"},
        {"means_l.webp", "../../etc/passwd", ERR_FORMAT, "missing"},
        {"\"bands\":1", "\"bands\":3", ERR_FORMAT, "too few"},
        {"\"bands\":1", "\"bands\":7", ERR_FORMAT, "7 bands"},
        {"\"mins\":[", "\"mins\":[true,", ERR_FORMAT, "means.mins"},
        {"\"codebook\":[", "\"codebook\":[],\"x\":[", ERR_FORMAT, "codebook"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct err e = {0};
        enum err_code rc = decode_edited("", cases[i].from, cases[i].to, &e);
        if (rc != cases[i].want || !strstr(e.msg, cases[i].says))
            fail_msg("%s: %d, %s", cases[i].to, rc, e.msg);
    }
    struct err e = {0}; /* as of who zips the folder, not what is in it */
    kit_ok(decode_edited("scene/", "\"count\":40", "\"count\":40", &e), e);
}

/* ---- version 1 ---- */

enum { FIRST_N = 64, FIRST_EDGE = 8, FIRST_COEFS = 15, FIRST_PALETTE = 5000 };

static size_t first_row(size_t i)
{
    return FIRST_PALETTE - 1 - 70 * i;
}

static uint8_t first_byte(size_t row, size_t c)
{
    return (uint8_t)(row * 7 + c);
}

static void first_texture(const char *name, const uint8_t *px, uint32_t w, uint32_t h,
                          struct archive_part *out)
{
    struct err e = {0};
    out->name = name;
    kit_ok(webp_encode_exact(px, w, h, &out->bytes, &e), e);
}

/* Harmonics of `values` numbers, whose least is the text `mins`. All other texels are alike. */
static enum err_code first_decode(const char *values, const char *mins, struct gauss *out,
                                  struct err *e)
{
    enum { W = SOG_PALETTE_COLUMNS * FIRST_COEFS, H = FIRST_PALETTE / SOG_PALETTE_COLUMNS + 1 };
    static uint8_t palette[4 * W * H];
    uint8_t same[4 * FIRST_N], label[4 * FIRST_N];
    struct archive_part part[4] = {{.name = "meta.json"}};
    struct buf file = {0};
    for (size_t t = 0; t < (size_t)W * H; t++) {
        for (size_t c = 0; c < 3; c++)
            palette[4 * t + c] = first_byte(t / FIRST_COEFS, t % FIRST_COEFS * 3 + c);
        palette[4 * t + 3] = 255;
    }
    for (size_t i = 0; i < FIRST_N; i++) {
        memcpy(&same[4 * i], (uint8_t[]){51, 102, 204, SOG_QUAT_TAG}, 4);
        label[4 * i] = (uint8_t)first_row(i);
        label[4 * i + 1] = (uint8_t)(first_row(i) >> 8);
        label[4 * i + 2] = 0;
        label[4 * i + 3] = 255;
    }
    buf_printf(&part[0].bytes,
               "{\"means\":{\"shape\":[%d,3],\"mins\":[-1,-2,-3],\"maxs\":[1,2,3],\"files\":["
               "\"s\",\"s\"]},\"scales\":{\"mins\":[-9,-8,-7],\"maxs\":[1,2,3],\"files\":[\"s\"]},"
               "\"quats\":{\"files\":[\"s\"]},\"sh0\":{\"mins\":[0,-1,-2,-5],\"maxs\":[1,2,3,5],"
               "\"files\":[\"s\"]},\"shN\":{\"shape\":[%d,%s],\"mins\":%s,\"maxs\":2,"
               "\"files\":[\"c\",\"l\"]}}",
               FIRST_N, FIRST_N, values, mins);
    first_texture("s", same, FIRST_EDGE, FIRST_EDGE, &part[1]);
    first_texture("c", palette, W, H, &part[2]);
    first_texture("l", label, FIRST_EDGE, FIRST_EDGE, &part[3]);
    kit_ok(archive_write(part, 4, &file, e), *e);
    enum err_code rc = sog_decode(file.data, file.size, NULL, out, e);
    for (size_t i = 0; i < 4; i++)
        buf_free(&part[i].bytes);
    buf_free(&file);
    return rc;
}

/* A palette as large as encoders make it, and one least and one largest number for harmonics. */
static void test_version_1(void **state)
{
    static const char *const values[] = {"45", "15"}, *const mins[] = {"-1.5", "[-1.5]"};
    static const char *const bad[] = {"\"-1.5\"", "null", "[]", "1e39", "[-1.5,0]"};
    for (size_t k = 0; k < 2; k++) {
        struct gauss g;
        struct err e = {0};
        kit_ok(first_decode(values[k], mins[k], &g, &e), e);
        assert_true(g.n == FIRST_N && g.sh_degree == 3);
        for (size_t i = 0; i < FIRST_N; i++) {
            const float *sh = &g.sh[48 * i];
            for (size_t c = 0; c < 3; c++) {
                const double t = (double)(51 << c) / 255;
                assert_true(fabs((double)g.scale_log[3 * i + c] - (-9 + (double)c + 10 * t)) <
                            FIRST_TOL);
                assert_true(fabs((double)sh[c] - (-(double)c + (1 + 2 * (double)c) * t)) <
                            FIRST_TOL);
            }
            for (size_t c = 0; c < 3 * FIRST_COEFS; c++) {
                const double t = first_byte(first_row(i), c) / 255.0;
                assert_true(fabs((double)sh[3 + c] -
                                 (double)sog_flip_sh[c / 3] * (-1.5 + 3.5 * t)) < FIRST_TOL);
            }
            assert_true(fabs((double)g.opacity_logit[i] - (-5 + 10 * 252 / 255.0)) < FIRST_TOL);
        }
        gauss_free(&g);
    }
    for (size_t k = 0; k < sizeof bad / sizeof *bad; k++) {
        struct gauss g;
        struct err e = {0};
        kit_fails(first_decode("45", bad[k], &g, &e), ERR_FORMAT, e, "shN.mins");
        gauss_free(&g);
    }
}

static void test_memory(void **state)
{
    struct gauss g, back;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(12, 200, 10, 1, 0, &g);
    kit_out_of_memory((buf_free(&b), sog_encode(&g, 1, &b, &e)), 1, e);
    kit_out_of_memory(sog_decode(b.data, b.size, NULL, &back, &e), 1, e);
    gauss_free(&back);
    gauss_free(&g);
    buf_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values),
        cmocka_unit_test(test_harmonics),
        cmocka_unit_test(test_palette_keeps_most),
        cmocka_unit_test(test_one_and_equal),
        cmocka_unit_test(test_same_bytes),
        cmocka_unit_test(test_codebook),
        cmocka_unit_test(test_torture),
        cmocka_unit_test(test_lies_in_meta),
        cmocka_unit_test(test_version_1),
        cmocka_unit_test(test_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
