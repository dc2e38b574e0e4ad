/* citysplat convert, run as a user would: formats, axes, degrees, and one clear error that leaves
 * no file behind.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/splat.h"
#include "codec/splat/spz.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Position steps of the quantised formats, and float32 rounding of what a turn and a log do. */
#define POSITION_TOL (0.5 / 4096 + 1e-5)
#define FLOAT_TOL 2e-5

static void load(const char *name, struct buf *out)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, kit_tmp, name, &e), e);
    kit_ok(file_read(path, 0, out, &e), e);
}

static void save(const char *name, const struct buf *b)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, kit_tmp, name, &e), e);
    kit_ok(file_write(path, b->data, b->size, &e), e);
}

static void save_ply(const char *name, const struct gauss *g, const struct ply_info *info)
{
    struct buf b = {0};
    struct err e = {0};
    kit_ok(ply_encode(g, info, &b, &e), e);
    save(name, &b);
    buf_free(&b);
}

static void load_ply(const char *name, struct gauss *g, struct ply_info *info)
{
    struct buf b = {0};
    struct err e = {0};
    load(name, &b);
    kit_ok(ply_decode(b.data, b.size, NULL, g, info, &e), e);
    buf_free(&b);
}

static int convert(const char *in, const char *out, const char *options, struct buf *said)
{
    if (said)
        said->size = 0;
    return kit_run(said, "%s convert %s/%s %s/%s --overwrite %s", kit_program(), kit_tmp, in,
                   kit_tmp, out, options);
}

static void expect_same_file(const char *a, const char *b)
{
    struct buf x = {0}, y = {0};
    load(a, &x);
    load(b, &y);
    if (x.size != y.size || memcmp(x.data, y.data, x.size))
        fail_msg("%s and %s differ", a, b);
    buf_free(&x);
    buf_free(&y);
}

static void test_integers_pass_untouched(void **state)
{
    struct gauss g;
    kit_gauss(1, 300, 500, 3, 0, &g);
    save_ply("a.ply", &g, NULL);
    assert_int_equal(convert("a.ply", "a.spz", "", NULL), 0);
    assert_int_equal(convert("a.spz", "a.drc", "", NULL), 0);
    assert_int_equal(convert("a.drc", "a.glb", "--copyright Survey", NULL), 0);
    assert_int_equal(convert("a.glb", "v4.spz", "--spz-version 4", NULL), 0);
    assert_int_equal(convert("v4.spz", "b.spz", "", NULL), 0);
    expect_same_file("a.spz", "b.spz");
    gauss_free(&g);
}

/* An F on the ground (stem to the north, bars to the east), one Gaussian a stroke's end at its own
 * height. */
static void test_an_f_stays_an_f(void **state)
{
    static const float f[5][3] = {{0, 0, 1}, {0, 50, 2}, {30, 50, 3}, {0, 25, 4}, {20, 25, 5}};
    struct gauss g = {0}, back;
    struct quant q;
    struct buf b = {0};
    struct ply_info info;
    struct err e = {0};
    kit_ok(gauss_alloc(&g, 5, 1, 0, &e), e);
    g.n = 5;
    for (size_t i = 0; i < 5; i++) {
        memcpy(g.mean_m + 3 * i, f[i], sizeof f[i]);
        g.quat_wxyz[4 * i] = 1;
        g.scale_log[3 * i + 1] = 3;  /* long to the north */
        g.sh[12 * i + 3 + 3] = 0.5f; /* bright when seen looking up: coefficient 1 is +z */
    }
    save_ply("f.ply", &g, NULL); /* says that it is ENU */
    assert_int_equal(convert("f.ply", "f.spz", "--no-sort --preset spz", NULL), 0);
    load("f.spz", &b);
    kit_ok(spz_decode(b.data, b.size, NULL, &q, &e), e);
    for (size_t i = 0; i < 5; i++) {
        const double want[3] = {(double)f[i][0], (double)f[i][2], -(double)f[i][1]};
        for (int c = 0; c < 3; c++)
            assert_true(fabs(q.position[3 * i + c] / 4096.0 - want[c]) < POSITION_TOL);
        assert_int_equal(q.sh[9 * i + 0], 64); /* coefficient 0 is -y: looking up, +y, is bright */
        assert_int_equal(q.sh[9 * i + 3], 128);
    }
    quant_free(&q);
    buf_free(&b);
    assert_int_equal(convert("f.spz", "back.ply", "", NULL), 0);
    load_ply("back.ply", &back, &info);
    assert_int_equal(info.axes, PLY_AXES_ENU);
    for (size_t i = 0; i < 5; i++)
        for (size_t c = 0; c < 3; c++)
            assert_true(fabsf(back.mean_m[3 * i + c] - f[i][c]) < (float)POSITION_TOL);
    assert_true(fabsf(back.sh[3 + 3] - 0.5f) < 0.05f);
    gauss_free(&back);
    gauss_free(&g);
}

/* A file that does not say its axes is not turned, unless the user says. */
static void test_axes_are_never_guessed(void **state)
{
    struct gauss g, as_is, turned;
    struct ply_info info = {.axes = PLY_AXES_UNKNOWN};
    struct buf said = {0};
    kit_gauss(2, 20, 100, 0, 0, &g);
    save_ply("u.ply", &g, &info);
    assert_int_equal(convert("u.ply", "u.glb", "--glb-payload plain --no-sort", &said), 0);
    assert_non_null(strstr((const char *)said.data, "axes"));
    assert_int_equal(convert("u.glb", "as_is.ply", "--ply-axes gltf", NULL), 0);
    load_ply("as_is.ply", &as_is, &info);
    assert_int_equal(info.axes, PLY_AXES_GLTF);
    assert_memory_equal(as_is.mean_m, g.mean_m, 12 * g.n);
    assert_int_equal(convert("u.ply", "u2.glb", "--axes enu --glb-payload plain --no-sort", NULL),
                     0);
    assert_int_equal(convert("u2.glb", "turned.ply", "--ply-axes gltf", NULL), 0);
    load_ply("turned.ply", &turned, &info);
    for (size_t i = 0; i < g.n; i++)
        assert_true(turned.mean_m[3 * i + 1] == g.mean_m[3 * i + 2] &&
                    turned.mean_m[3 * i + 2] == -g.mean_m[3 * i + 1]);
    assert_int_equal(convert("u.ply", "same.ply", "", NULL), 0);
    expect_same_file("u.ply", "same.ply");
    gauss_free(&as_is);
    gauss_free(&turned);
    gauss_free(&g);
    buf_free(&said);
}

static void test_degree_and_center(void **state)
{
    struct gauss g, back;
    struct buf said = {0};
    kit_gauss(3, 60, 100, 3, 0, &g);
    g.origin_enu_m[0] = 2683141;
    g.origin_enu_m[1] = 1248117;
    save_ply("far.ply", &g, NULL);
    assert_int_equal(convert("far.ply", "far.spz", "", &said), 1);
    assert_non_null(strstr((const char *)said.data, "--center"));
    assert_int_equal(convert("far.ply", "far.drc", "--center --sh-degree 1", NULL), 0);
    assert_int_equal(convert("far.drc", "near.ply", "", NULL), 0);
    load_ply("near.ply", &back, NULL);
    assert_int_equal(back.n, 60);
    assert_int_equal(back.sh_degree, 1);
    for (size_t i = 0; i < 3 * back.n; i++)
        assert_true(fabsf(back.mean_m[i]) <= 101);
    gauss_free(&back);
    gauss_free(&g);
    buf_free(&said);
}

static void test_reads_splat(void **state)
{
    struct buf b = {0};
    struct gauss g;
    for (int i = 0; i < 2; i++) {
        for (int c = 0; c < 3; c++)
            buf_f32(&b, (float)(10 * i + c));
        for (int c = 0; c < 3; c++)
            buf_f32(&b, c ? 1.0f : 0.0f);
        buf_add(&b, (const uint8_t[]){255, 0, 128, 255, 128, 128, 0, 128}, 8);
    }
    save("s.splat", &b);
    assert_int_equal(convert("s.splat", "s.ply", "", NULL), 0);
    load_ply("s.ply", &g, NULL);
    assert_int_equal(g.n, 2);
    assert_true(g.mean_m[5] == 12 && g.scale_log[1] == 0 && g.scale_log[0] < -20);
    const double dc[3] = {1.7725, -1.7725, 0.00695}, quat[4] = {0, 0, -1, 0};
    kit_near("color", g.sh, dc, 3, 1e-3, 0);
    kit_near("rotation", g.quat_wxyz, quat, 4, FLOAT_TOL, 0);
    assert_true(g.opacity_logit[0] > 6 && isfinite(g.opacity_logit[0]));
    gauss_free(&g);
    b.size -= 1;
    save("s.splat", &b);
    assert_int_equal(convert("s.splat", "s2.ply", "", NULL), 1);
    buf_free(&b);
}

/* What a file holds: Gaussians, and the integers where its format has some (q.n 0: it has none). */
static size_t contents(const char *name, struct quant *q)
{
    struct buf b = {0};
    struct gauss g = {0};
    struct err e = {0};
    const void *spz;
    size_t n_spz, n;
    const char *ext = strrchr(name, '.');
    *q = (struct quant){0};
    load(name, &b);
    if (!strcmp(ext, ".spz"))
        kit_ok(spz_decode(b.data, b.size, NULL, q, &e), e);
    else if (!strcmp(ext, ".drc"))
        kit_ok(draco_decode(b.data, b.size, NULL, q, &e), e);
    else if (!strcmp(ext, ".ply"))
        kit_ok(ply_decode(b.data, b.size, NULL, &g, NULL, &e), e);
    else if (!strcmp(ext, ".splat"))
        kit_ok(splat_decode(b.data, b.size, NULL, &g, &e), e);
    else if (glb_find_spz(b.data, b.size, &spz, &n_spz, &e) == ERR_OK)
        kit_ok(spz_decode(spz, n_spz, NULL, q, &e), e);
    else
        kit_ok(glb_decode(b.data, b.size, NULL, &g, &e), e);
    n = q->n ? q->n : g.n;
    gauss_free(&g);
    buf_free(&b);
    return n;
}

/* Every format that is read into every one that is written: all Gaussians arrive, and between the
 * formats of integers no integer changes. */
static void test_every_format_into_every_other(void **state)
{
    enum { N = 40, IN = 7, OUT = 6 };
    static const char *const in[IN] = {"m.ply",    "m3.spz",  "m4.spz", "m.drc",
                                       "mspz.glb", "mpl.glb", "m.splat"};
    static const struct {
        const char *name, *options;
    } out[OUT] = {{"o.ply", ""}, {"o3.spz", ""},   {"o4.spz", "--spz-version 4"},
                  {"o.drc", ""}, {"ospz.glb", ""}, {"opl.glb", "--glb-payload plain"}};
    struct gauss g;
    struct buf b = {0};
    kit_gauss(7, N, 60, 2, 0, &g);
    save_ply(in[0], &g, NULL);
    for (size_t i = 1; i < 6; i++)
        assert_int_equal(convert(in[0], in[i], out[i].options, NULL), 0);
    for (size_t i = 0; i < N; i++) {
        buf_add(&b, g.mean_m + 3 * i, 12);
        for (int c = 0; c < 3; c++)
            buf_f32(&b, 0.5f);
        buf_add(&b, (const uint8_t[]){200, 100, 50, 180, 128, 255, 128, 128}, 8);
    }
    save(in[6], &b);
    for (size_t i = 0; i < IN; i++) {
        struct quant from, to;
        assert_int_equal(contents(in[i], &from), N);
        for (size_t o = 0; o < OUT; o++) {
            char options[64];
            snprintf(options, sizeof options, "--no-sort %s %s", out[o].options,
                     i == 6 ? "--axes gltf" : "");
            if (convert(in[i], out[o].name, options, NULL))
                fail_msg("%s does not become %s", in[i], out[o].name);
            assert_int_equal(contents(out[o].name, &to), N);
            if (from.n && to.n) {
                assert_int_equal(from.frac_bits, to.frac_bits);
                assert_int_equal(from.sh_degree, to.sh_degree);
                assert_memory_equal(from.position, to.position, 12 * N);
                assert_memory_equal(from.rotation, to.rotation, 4 * N);
                assert_memory_equal(from.alpha, to.alpha, N);
                assert_memory_equal(from.color, to.color, 3 * N);
                assert_memory_equal(from.scale, to.scale, 3 * N);
                assert_memory_equal(from.sh, to.sh, 24 * N);
            }
            quant_free(&to);
        }
        quant_free(&from);
    }
    buf_free(&b);
    gauss_free(&g);
}

static void test_errors(void **state)
{
    struct gauss g;
    struct buf said = {0}, b = {0};
    kit_gauss(4, 30, 100, 1, 0, &g);
    save_ply("e.ply", &g, NULL);
    assert_int_equal(convert("e.ply", "e.obj", "", &said), 2);
    assert_non_null(strstr((const char *)said.data, ".ply, .spz"));
    assert_int_equal(convert("e.ply", "e.splat", "", &said), 2);
    assert_int_equal(convert("none.ply", "x.spz", "", &said), 1);
    assert_non_null(strstr((const char *)said.data, "none.ply"));
    assert_int_equal(convert("e.ply", "x.spz", "--sh-degree 4", &said), 2);
    assert_int_equal(convert("e.ply", "x.spz", "--colour red", &said), 2);
    assert_int_equal(convert("e.ply", "in.spz", "", NULL), 0);
    assert_int_equal(convert("e.ply", "many.spz", "--spz-version 4", NULL), 0);
    load("many.spz", &b);
    memcpy(b.data + 8, "\1\0\0\4", 4); /* one more than a file may have */
    save("many.spz", &b);
    assert_int_equal(convert("many.spz", "x.ply", "", &said), 1);
    assert_non_null(strstr((const char *)said.data, "67108864"));
    for (const char *const *f = (const char *const[]){"t.spz", "t.ply", NULL}; *f; f++) {
        assert_int_equal(convert("e.ply", *f, "", NULL), 0);
        b.size = 0;
        load(*f, &b);
        b.size = b.size * 2 / 3;
        save(*f, &b);
        assert_int_equal(convert(*f, "broken.ply", "", &said), 1);
        assert_non_null(strstr((const char *)said.data, *f));
    }
    char path[FILE_PATH_MAX];
    struct err e = {0};
    for (const char *const *f = (const char *const[]){"broken.ply", "x.spz", "e.obj", NULL}; *f;
         f++) {
        kit_ok(file_join(path, kit_tmp, *f, &e), e);
        assert_false(file_exists(path));
    }
    gauss_free(&g);
    buf_free(&said);
    buf_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_integers_pass_untouched),
        cmocka_unit_test(test_an_f_stays_an_f),
        cmocka_unit_test(test_axes_are_never_guessed),
        cmocka_unit_test(test_degree_and_center),
        cmocka_unit_test(test_reads_splat),
        cmocka_unit_test(test_every_format_into_every_other),
        cmocka_unit_test(test_errors),
    };
    return cmocka_run_group_tests(tests, kit_tmp_make, kit_tmp_remove);
}
