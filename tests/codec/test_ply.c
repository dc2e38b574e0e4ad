/* .ply: every float comes back, any order and type of properties, SuperSplat's packed form, and
 * hostile headers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/splat/ply.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static void expect_same(const struct gauss *a, const struct gauss *b)
{
    assert_int_equal(a->n, b->n);
    assert_int_equal(a->sh_degree, b->sh_degree);
    assert_memory_equal(a->mean_m, b->mean_m, a->n * 12);
    assert_memory_equal(a->scale_log, b->scale_log, a->n * 12);
    assert_memory_equal(a->quat_wxyz, b->quat_wxyz, a->n * 16);
    assert_memory_equal(a->opacity_logit, b->opacity_logit, a->n * 4);
    assert_memory_equal(a->sh, b->sh, a->n * gauss_sh_count(a->sh_degree) * 12);
}

static void test_round_trip_is_lossless(void **state)
{
    for (uint32_t i = 0; i < 8; i++) {
        struct gauss g, back;
        struct ply_info info = {i & 1, {8.541694, 47.376887, 408.5}, PLY_AXES_NONE, ""}, got = {0};
        struct buf b = {0}, again = {0};
        struct err e = {0};
        kit_gauss(i, i ? 100 : 0, 3000, i % 4, 0, &g);
        g.antialiased = i & 2;
        kit_ok(ply_encode(&g, &info, &b, &e), e);
        kit_ok(ply_decode(b.data, b.size, NULL, &back, &got, &e), e);
        expect_same(&g, &back);
        assert_int_equal(back.antialiased, g.antialiased);
        assert_int_equal(got.has_origin, info.has_origin);
        assert_int_equal(got.axes, PLY_AXES_ENU);
        if (info.has_origin)
            assert_memory_equal(&got.origin, &info.origin, sizeof info.origin);
        kit_ok(ply_encode(&back, &got, &again, &e), e);
        assert_int_equal(b.size, again.size);
        assert_memory_equal(b.data, again.data, b.size);
        buf_free(&b);
        buf_free(&again);
        gauss_free(&g);
        gauss_free(&back);
    }
}

/* The file of the original code: 62 floats a row, channel-major f_rest. */
static void test_layout_is_inrias(void **state)
{
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(1, 2, 10, 3, 0, &g);
    kit_ok(ply_encode(&g, NULL, &b, &e), e);
    const char *head = (const char *)b.data;
    static const char want[] =
        "ply\nformat binary_little_endian 1.0\ncomment axes ENU\nelement vertex 2\n"
        "property float x\nproperty float y\nproperty float z\nproperty float nx\n";
    assert_memory_equal(head, want, sizeof want - 1);
    size_t n_head = b.size - 2 * 248;
    assert_memory_equal(head + n_head - 11, "end_header\n", 11);
    float row[62];
    memcpy(row, b.data + n_head + 248, 248);
    assert_true(row[0] == g.mean_m[3] && row[3] == 0 && row[5] == 0);
    for (size_t c = 0; c < 3; c++)
        assert_true(row[6 + c] == g.sh[48 + c]);
    for (size_t k = 0; k < 15; k++)
        for (size_t c = 0; c < 3; c++)
            assert_true(row[9 + c * 15 + k] == g.sh[48 + 3 * (k + 1) + c]);
    assert_true(row[54] == g.opacity_logit[1] && row[55] == g.scale_log[3] &&
                row[58] == g.quat_wxyz[4]);
    buf_free(&b);
    gauss_free(&g);
}

/* Coordinates of a national grid: float32 would lose half a metre. */
static void test_doubles_keep_their_precision(void **state)
{
    struct gauss g, back;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(2, 50, 500, 0, 0, &g);
    g.origin_enu_m[0] = 2683141;
    g.origin_enu_m[1] = 1248117;
    kit_ok(ply_encode(&g, NULL, &b, &e), e);
    assert_non_null(strstr((const char *)b.data, "property double x\n"));
    kit_ok(ply_decode(b.data, b.size, NULL, &back, NULL, &e), e);
    for (size_t i = 0; i < 3 * g.n; i++) {
        double want = (double)g.mean_m[i] + g.origin_enu_m[i % 3];
        double got = (double)back.mean_m[i] + back.origin_enu_m[i % 3];
        assert_true(fabs(got - want) < 1e-4); /* float32 within 1 km of the new origin */
        assert_true(fabsf(back.mean_m[i]) < 1001);
    }
    buf_free(&b);
    gauss_free(&g);
    gauss_free(&back);
}

static const char odd_props[] =
    "property uchar red\nproperty float rot_3\nproperty double x\n"
    "property float32 z\nproperty int16 f_dc_2\nproperty float y\n"
    "property uint8 f_dc_0\nproperty int f_dc_1\nproperty float opacity\n"
    "property float rot_0\nproperty float rot_1\nproperty float rot_2\n"
    "property double scale_1\nproperty float scale_0\nproperty float scale_2\n";

static void put(struct buf *b, int big, const void *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        buf_u8(b, ((const uint8_t *)p)[big ? n - 1 - i : i]);
}

/* Any order, any types, unknown properties, both byte orders, CR LF line ends, elements before and
 * after. */
static void test_finds_properties_by_name(void **state)
{
    for (int big = 0; big < 2; big++) {
        struct buf b = {0};
        struct gauss g;
        struct ply_info info;
        struct err e = {0};
        buf_printf(
            &b,
            "ply\r\nformat binary_%s_endian 1.0\r\ncomment SplatRenderMode: mip\n"
            "obj_info made by hand\ncomment citysplat origin 8.5 47.25 400\ncomment axes glTF\n"
            "comment citysplat heights sea-exif\ncomment citysplat heights nonsense\n"
            "element camera 2\nproperty float f\nelement vertex 1\n%selement face 3\n"
            "property list uchar int vertex_index\nend_header\n",
            big ? "big" : "little", odd_props);
        buf_add(&b, "12345678", 8);
        const double x = 1.25, s1 = -3;
        const float rot3 = 0.5f, z = -2, y = 7, op = 1, one = 0.5f, s0 = -2, s2 = -4;
        const int16_t dc2 = -1;
        const int32_t dc1 = 2;
        buf_u8(&b, 9);
        put(&b, big, &rot3, 4);
        put(&b, big, &x, 8);
        put(&b, big, &z, 4);
        put(&b, big, &dc2, 2);
        put(&b, big, &y, 4);
        buf_u8(&b, 3);
        put(&b, big, &dc1, 4);
        put(&b, big, &op, 4);
        for (int i = 0; i < 3; i++)
            put(&b, big, &one, 4);
        put(&b, big, &s1, 8);
        put(&b, big, &s0, 4);
        put(&b, big, &s2, 4);
        buf_add(&b, "rest", 4);
        kit_ok(ply_decode(b.data, b.size, NULL, &g, &info, &e), e);
        assert_int_equal(g.n, 1);
        assert_int_equal(g.sh_degree, 0);
        assert_true(g.antialiased);
        assert_true(info.has_origin && info.origin.lat_deg == 47.25 && info.axes == PLY_AXES_GLTF);
        assert_string_equal(info.heights, "sea-exif");
        assert_true(g.mean_m[0] == 1.25f && g.mean_m[1] == 7 && g.mean_m[2] == -2);
        assert_true(g.sh[0] == 3 && g.sh[1] == 2 && g.sh[2] == -1);
        assert_true(g.scale_log[0] == -2 && g.scale_log[1] == -3 && g.scale_log[2] == -4);
        assert_true(g.quat_wxyz[0] == 0.5f && g.quat_wxyz[3] == 0.5f && g.opacity_logit[0] == 1);
        gauss_free(&g);
        buf_free(&b);
    }
}

static void test_reads_text(void **state)
{
    struct buf b = {0};
    struct gauss g;
    struct err e = {0};
    buf_printf(&b, "ply\nformat ascii 1.0\nelement vertex 2\n%send_header\n", odd_props);
    for (int i = 0; i < 2; i++)
        buf_printf(&b, "255 0.5 %d.25 -2 -1 7 3 2 inf 0.5 0.5 0.5 -3 -inf -4\n", i + 1);
    kit_ok(ply_decode(b.data, b.size, NULL, &g, NULL, &e), e);
    assert_int_equal(g.n, 2);
    assert_true(g.mean_m[3] == 2.25f && g.mean_m[4] == 7 && g.sh[3] == 3 && g.scale_log[5] == -4);
    assert_true(g.opacity_logit[0] == 16 &&
                g.scale_log[0] == -23); /* infinities of opaque, flat Gaussians */
    gauss_free(&g);
    b.size -= 20;
    kit_fails(ply_decode(b.data, b.size, NULL, &g, NULL, &e), ERR_FORMAT, e, "row 1");
    buf_free(&b);
}

/* One chunk of two splats, packed by hand. */
static void test_reads_supersplats_packed_form(void **state)
{
    struct buf b = {0};
    struct gauss g;
    struct err e = {0};
    static const char *const range[] = {"x", "y", "z", "scale_x", "scale_y", "scale_z"};
    buf_printf(&b, "ply\nformat binary_little_endian 1.0\nelement chunk 1\n");
    for (int part = 0; part < 4; part++)
        for (int c = 0; c < 3; c++)
            buf_printf(&b, "property float %s_%s\n", part & 1 ? "max" : "min",
                       range[part / 2 * 3 + c]);
    buf_printf(&b,
               "element vertex 2\nproperty uint packed_position\nproperty uint packed_rotation\n"
               "property uint packed_scale\nproperty uint packed_color\nelement sh 2\n");
    for (int i = 0; i < 9; i++)
        buf_printf(&b, "property uchar f_rest_%d\n", i);
    buf_printf(&b, "end_header\n");
    const float values[12] = {-10, -20, -30, 10, 20, 30, -5, -6, -7, 1, 2, 3};
    for (int i = 0; i < 12; i++)
        buf_f32(&b, values[i]);
    buf_u32(&b, 2047u << 21 | 0 << 11 | 2047);
    buf_u32(&b, 0u << 30 | 512u << 20 | 512u << 10 | 1023); /* w left out; z = sqrt(1/2) */
    buf_u32(&b, 0u << 21 | 1023u << 11 | 0);
    buf_u32(&b, 0xff0080ff);
    for (int k = 0; k < 4; k++)
        buf_u32(&b, 0);
    for (unsigned i = 0; i < 18; i++)
        buf_u8(&b, i == 0 ? 255 : i < 9 ? 128 : 0);
    kit_ok(ply_decode(b.data, b.size, NULL, &g, NULL, &e), e);
    assert_int_equal(g.n, 2);
    assert_int_equal(g.sh_degree, 1);
    const double mean[6] = {10, -20, 30, -10, -20, -30}, scale[3] = {-5, 2, -7};
    const double quat[4] = {0.7071, 0.0007, 0.0007, 0.7071}, dc[3] = {1.7725, -1.7725, 0.00695};
    kit_near("mean", g.mean_m, mean, 6, 1e-5, 0);
    kit_near("scale", g.scale_log, scale, 3, 1e-5, 0);
    kit_near("rotation", g.quat_wxyz, quat, 4, 1e-4, 0);
    kit_near("color", g.sh, dc, 3, 1e-3, 0);
    assert_true(g.sh[3] == 4 && g.sh[6] == 0.015625f && g.sh[12 + 3] == -4);
    assert_true(g.opacity_logit[0] > 6 && isfinite(g.opacity_logit[0]) && g.opacity_logit[1] < -6);
    gauss_free(&g);
    for (size_t n = 0; n < b.size; n++)
        kit_fails(ply_decode(b.data, n, NULL, &g, NULL, &e), ERR_FORMAT, e, "ply");
    buf_free(&b);
}

/* A cloud in chunks, the last one short: what is read differs by half a step of its chunk's box,
 * and the origin, which is added, survives. */
static void test_writes_supersplats_packed_form(void **state)
{
    for (uint32_t degree = 0; degree <= 3; degree++) {
        struct gauss g, back;
        struct buf b = {0};
        struct ply_info info = {true, {8.5, 47.25, 408.5}, PLY_AXES_NONE, ""}, got = {0};
        struct err e = {0};
        const size_t k = 3 * gauss_sh_count(degree);
        kit_gauss(6 + degree, 600, 40, degree, 0, &g);
        g.origin_enu_m[0] = 100;
        g.antialiased = degree == 1;
        g.scale_log[0] = -23; /* flatter than a chunk gives steps to */
        kit_ok(ply_packed_encode(&g, degree, &info, &b, &e), e);
        kit_ok(ply_decode(b.data, b.size, NULL, &back, &got, &e), e);
        assert_int_equal(back.n, g.n);
        assert_int_equal(back.sh_degree, degree);
        assert_int_equal(back.antialiased, g.antialiased);
        assert_true(got.has_origin && got.origin.h_m == 408.5 && got.axes == PLY_AXES_ENU);
        assert_int_equal(b.size -
                             (size_t)(strstr((char *)b.data, "end_header\n") + 11 - (char *)b.data),
                         3 * 72 + 600 * 16 + (degree ? 600 * (k - 3) : 0));
        for (size_t i = 0; i < g.n; i++) {
            double dot = 0, p = 0, q = 0;
            for (size_t c = 0; c < 3; c++) {
                double mean = (double)g.mean_m[3 * i + c] + g.origin_enu_m[c];
                double ln = fmax((double)g.scale_log[3 * i + c], -20);
                /* boxes are 80 m and 20 + 2 wide at most */
                assert_true(fabs((double)back.mean_m[3 * i + c] - mean) < 80.0 / 1023 * 0.51);
                assert_true(fabs((double)back.scale_log[3 * i + c] - ln) < 22.0 / 1023 * 0.51);
            }
            for (size_t c = 0; c < 4; c++) {
                double a = (double)g.quat_wxyz[4 * i + c], r = (double)back.quat_wxyz[4 * i + c];
                dot += a * r;
                p += a * a;
                q += r * r;
            }
            assert_true(fabs(dot) / sqrt(p * q) > 0.999995);
            for (size_t c = 3; c < k; c++) {
                double want = fmin(fmax((double)g.sh[k * i + c], -4), 4);
                assert_true(fabs((double)back.sh[k * i + c] - want) < 0.0158);
            }
            double a = 1 / (1 + exp(-(double)g.opacity_logit[i]));
            assert_true(fabs(1 / (1 + exp(-(double)back.opacity_logit[i])) - a) < 0.51 / 255);
        }
        kit_fails(ply_packed_encode(&g, degree + 1, &info, &b, &e), ERR_ARG, e, "degree");
        g.mean_m[3] = NAN;
        size_t had = b.size;
        kit_fails(ply_packed_encode(&g, degree, &info, &b, &e), ERR_DATA, e, "row 1");
        assert_int_equal(b.size, had);
        gauss_free(&g);
        gauss_free(&back);
        buf_free(&b);
    }
}

static enum err_code decode_free(const void *user, const void *bytes, size_t n,
                                 const struct codec_limits *lim, struct err *e)
{
    struct gauss g;
    (void)user;
    enum err_code rc = ply_decode(bytes, n, lim, &g, NULL, e);
    if (rc)
        assert_null(g.block);
    gauss_free(&g);
    return rc;
}

static const struct torture torture = {
    .name = "ply", .decode = decode_free, .errors = TORTURE(ERR_DATA) | TORTURE(ERR_LIMIT)};

static void test_truncation_and_flips(void **state)
{
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(3, 5, 10, 1, 0, &g);
    kit_ok(ply_encode(&g, NULL, &b, &e), e);
    torture_cuts(&torture, &b, 1);
    torture_flips(&torture, &b, 0, 6, 5000);
    buf_free(&b);
    gauss_free(&g);
}

#define ALL_BUT_ROT_3                                                                              \
    "property float x\nproperty float y\nproperty float z\nproperty float f_dc_0\n"                \
    "property float f_dc_1\nproperty float f_dc_2\nproperty float opacity\n"                       \
    "property float scale_0\nproperty float scale_1\nproperty float scale_2\n"                     \
    "property float rot_0\nproperty float rot_1\nproperty float rot_2\n"
#define LITTLE "ply\nformat binary_little_endian 1.0\n"

/* Elements without rows take no room, lists or not. */
static void test_empty_elements(void **state)
{
    for (int text = 0; text < 2; text++) {
        struct buf b = {0};
        struct gauss g;
        struct err e = {0};
        const float row[14] = {1, 2, 3, 0.5f, 0.5f, 0.5f, 1, -2, -3, -4, 1, 0, 0, 0};
        buf_printf(&b,
                   "ply\nformat %s 1.0\nelement face 0\nproperty list uchar int vertex_indices\n"
                   "element camera 0\nproperty float f\nelement vertex 1\n",
                   text ? "ascii" : "binary_little_endian");
        buf_printf(&b, "%sproperty float rot_3\nend_header\n", ALL_BUT_ROT_3);
        for (size_t i = 0; i < 14 && text; i++)
            buf_printf(&b, "%g ", (double)row[i]);
        if (!text)
            buf_add(&b, row, sizeof row);
        kit_ok(ply_decode(b.data, b.size, NULL, &g, NULL, &e), e);
        assert_true(g.n == 1 && g.mean_m[2] == 3 && g.scale_log[2] == -4 && g.quat_wxyz[0] == 1);
        gauss_free(&g);
        buf_free(&b);
    }
}

static void test_hostile_headers(void **state)
{
    static const struct {
        const char *text;
        enum err_code rc;
        const char *part;
    } cases[] = {
        {"", ERR_FORMAT, "not a .ply"},
        {"plyx\n", ERR_FORMAT, "not a .ply"},
        {"ply\nelement vertex 1\nend_header\n", ERR_FORMAT, "format line"},
        {"ply\nformat binary_middle_endian 1.0\n", ERR_FORMAT, "line 2"},
        {LITTLE "element vertex -1\n", ERR_FORMAT, "line 3"},
        {LITTLE "element vertex 18446744073709551615\n", ERR_FORMAT, "line 3"},
        {LITTLE "element vertex 1e3\n", ERR_FORMAT, "not a number"},
        {LITTLE "property float x\n", ERR_FORMAT, "before the first element"},
        {LITTLE "element vertex 1\nproperty quad x\n", ERR_FORMAT, "quad"},
        {LITTLE "element vertex 1\nproperty float x\nproperty float x\n", ERR_FORMAT, "twice"},
        {LITTLE "element vertex 0\n" ALL_BUT_ROT_3 "end_header\n", ERR_FORMAT, "rot_3 is missing"},
        {LITTLE "element face 0\nend_header\n", ERR_FORMAT, "no element vertex"},
        {LITTLE "element vertex 60000000\n" ALL_BUT_ROT_3 "property float rot_3\nend_header\n",
         ERR_FORMAT, "truncated"},
        {LITTLE "element vertex 1000000000000000000\n" ALL_BUT_ROT_3
                "property float rot_3\nend_header\n",
         ERR_FORMAT, "truncated"},
        {"ply\nformat ascii 1.0\nelement vertex 60000000\n" ALL_BUT_ROT_3
         "property float rot_3\nend_header\n",
         ERR_FORMAT, "truncated"},
        {"ply\nformat ascii 1.0\nelement vertex 2\n" ALL_BUT_ROT_3
         "property float rot_3\nend_header\n0 0 0 0 0 0 0 0 0 0 1 0 0 0 7\n"
         "0 0 0 0 0 0 0 0 0 0 1 0 0 0\n",
         ERR_FORMAT, "row 0: its line does not end after 14 values"},
        {"ply\nformat ascii 1.0\nelement vertex 2\n" ALL_BUT_ROT_3
         "property float rot_3\nend_header\n0 0 0 0 0 0 0 0 0 0 1 0 0\n"
         "0 0 0 0 0 0 0 0 0 0 1 0 0 0\n",
         ERR_FORMAT, "row 0: its line does not end after 14 values"},
        {LITTLE "element vertex 0\n" ALL_BUT_ROT_3
                "property float rot_3\nproperty float f_rest_0\nend_header\n",
         ERR_FORMAT, "1 f_rest"},
        {LITTLE "element face 1\nproperty list uchar int i\nelement vertex 1\n" ALL_BUT_ROT_3
                "property float rot_3\nend_header\n",
         ERR_FORMAT, "lists"},
        {LITTLE "wobble\n", ERR_FORMAT, "wobble"},
        {LITTLE "element vertex 3", ERR_FORMAT, "line 3"},
    };
    struct err e = {0};
    size_t before = mem_peak_bytes();
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        kit_fails(torture_decode(&torture, cases[i].text, strlen(cases[i].text), NULL, &e),
                  cases[i].rc, e, cases[i].part);
    }
    struct buf b = {0};
    buf_printf(&b, LITTLE);
    for (int i = 0; i < 66000; i++)
        buf_printf(&b, "comment\n");
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "line 65537");
    b.size = 0;
    buf_printf(&b, LITTLE "property float ");
    for (int i = 0; i < 3000; i++)
        buf_u8(&b, 'a');
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_FORMAT, e, "too long");
    b.size = 0;
    buf_printf(&b, LITTLE "element vertex 1\n");
    for (int i = 0; i < 600; i++)
        buf_printf(&b, "property float p%d\n", i);
    kit_fails(torture_decode(&torture, b.data, b.size, NULL, &e), ERR_LIMIT, e, "512");
    assert_true(mem_peak_bytes() - before < (64u << 20));
    buf_free(&b);
}

#define PLACE "property float x\nproperty float y\nproperty float z\n"
#define TURN                                                                                       \
    "property float rot_0\nproperty float rot_1\nproperty float rot_2\nproperty float rot_3\n"

/* Files of trainers that write other columns: red, green and blue; two scales; neither. */
static void test_other_columns(void **state)
{
    static const char
        bytes[] =
            "ply\nformat ascii 1.0\nelement vertex 1\n" PLACE
            "property uchar red\nproperty uchar green\nproperty uchar blue\n"
            "property float opacity\nproperty float scale_0\nproperty float scale_1\n"
            "property float scale_2\n" TURN "end_header\n1 2 3 255 0 51 0.5 -1 -2 -3 1 0 0 0\n",
        disc[] = "ply\nformat ascii 1.0\nelement vertex 1\n" PLACE
                 "property float red\nproperty float green\nproperty float blue\n"
                 "property float opacity\nproperty float scale_0\nproperty float scale_1\n" TURN
                 "end_header\n1 2 3 1 0 0.2 0.5 -1 -2 1 0 0 0\n",
        /* a long comment, floats to 255, one scale; a row of Microsoft's library */
        ball[] = "ply\nformat ascii 1.0\ncomment %2000s\nelement vertex 2\n" PLACE
                 "property float red\nproperty float green\nproperty float blue\n"
                 "property float opacity\nproperty float scale_0\n" TURN
                 "end_header\n1 2 3 255 0 51 0.5 -1 1 0 0 0\n-1.#IND 2 3 0 0 0 0.5 -1 1 0 0 0\n";
    static const struct {
        const char *text, *says;
    } bad[] = {{"ply\nformat ascii 1.0\nelement vertex 1\n" PLACE "property uchar red\n"
                "property uchar green\nproperty uchar blue\nend_header\n1 2 3 4 5 6\n",
                "points or a mesh"},
               {"ply\nformat ascii 1.0\nelement vertex 1\n" PLACE "property float opacity\n"
                "property float scale_0\n" TURN "end_header\n1 2 3 4 5 1 0 0 0\n",
                "f_dc_0 is missing"}};
    static const float want[3] = {0.5f, -0.5f, 51 / 255.0f - 0.5f};
    struct gauss g;
    struct err e = {0};
    for (int k = 0; k < 2; k++) {
        const char *text = k ? disc : bytes;
        kit_ok(ply_decode(text, strlen(text), NULL, &g, NULL, &e), e);
        assert_true(g.n == 1 && g.sh_degree == 0);
        for (int c = 0; c < 3; c++)
            assert_true(fabsf(g.sh[c] - want[c] / (float)GAUSS_SH_C0) < 1e-5f);
        assert_true(g.scale_log[0] == -1 && g.scale_log[1] == -2);
        assert_true(fabsf(g.scale_log[2] - (k ? -2 + logf(1e-3f) : -3)) < 1e-5f);
        gauss_free(&g);
    }
    char text[sizeof ball + 2000];
    const int n = snprintf(text, sizeof text, ball, "long");
    log_set_level(LOG_ERROR);
    kit_ok(ply_decode(text, (size_t)n, NULL, &g, NULL, &e), e);
    log_set_level(LOG_WARN);
    assert_true(g.n == 1 && g.n_left_out == 1);
    for (int c = 0; c < 3; c++) {
        assert_true(fabsf(g.sh[c] - want[c] / (float)GAUSS_SH_C0) < 1e-5f);
        assert_true(g.scale_log[c] == -1);
    }
    gauss_free(&g);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        kit_fails(ply_decode(bad[i].text, strlen(bad[i].text), NULL, &g, NULL, &e), ERR_FORMAT, e,
                  bad[i].says);
}

static void test_bad_rows_are_named(void **state)
{
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(4, 9, 10, 0, 0, &g);
    kit_ok(ply_encode(&g, NULL, &b, &e), e);
    const float nan = NAN;
    memcpy(b.data + b.size - 68, &nan, 4); /* x of the last row of 17 floats */
    struct gauss back;
    log_set_level(LOG_ERROR);
    kit_ok(ply_decode(b.data, b.size, NULL, &back, NULL, &e), e);
    assert_true(back.n == 8 && back.n_left_out == 1);
    assert_memory_equal(back.mean_m, g.mean_m, 3 * 8 * sizeof *g.mean_m);
    gauss_free(&back);
    const float huge = 89; /* a log scale: no float holds its exp */
    memcpy(b.data + b.size - 68, &g.mean_m[3 * 8], 4);
    memcpy(b.data + b.size - 68 + 40, &huge, 4);
    kit_ok(ply_decode(b.data, b.size, NULL, &back, NULL, &e), e);
    assert_true(back.n == 8 && back.n_left_out == 1);
    gauss_free(&back);
    for (size_t i = 0; i < 9; i++) /* no rotation in any row */
        memset(b.data + b.size - 68 * (i + 1) + 52, 0, 16);
    kit_fails(ply_decode(b.data, b.size, NULL, &back, NULL, &e), ERR_DATA, e, "none of 9 rows");
    log_set_level(LOG_WARN);
    struct codec_limits lim = {.max_gaussians = 8};
    kit_fails(torture_decode(&torture, b.data, b.size, &lim, &e), ERR_LIMIT, e, "9 Gaussians");
    g.mean_m[3] = INFINITY;
    b.size = 0;
    kit_fails(ply_encode(&g, NULL, &b, &e), ERR_DATA, e, "row 1");
    buf_free(&b);
    gauss_free(&g);
}

static void test_files(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct gauss g, back;
    struct buf b = {0};
    struct err e = {0};
    kit_tmpdir(dir);
    kit_gauss(5, 4, 10, 2, 0, &g);
    kit_ok(ply_encode(&g, NULL, &b, &e), e);
    kit_ok(file_join(path, dir, "a.ply", &e), e);
    kit_fails(ply_read(path, NULL, &back, NULL, &e), ERR_NOENT, e, "a.ply");
    kit_ok(file_write(path, b.data, b.size, &e), e);
    kit_ok(ply_read(path, NULL, &back, NULL, &e), e);
    expect_same(&g, &back);
    gauss_free(&back);
    kit_ok(file_write(path, b.data, b.size - 1, &e), e);
    kit_fails(ply_read(path, NULL, &back, NULL, &e), ERR_FORMAT, e, "a.ply");
    buf_free(&b);
    gauss_free(&g);
    kit_rmdir(dir);
}

static void expect_part(const struct gauss *whole, size_t at, const struct gauss *part, size_t n)
{
    size_t k = 3 * gauss_sh_count(whole->sh_degree);
    assert_int_equal(part->n, n);
    for (size_t i = 0; i < 3 * n; i++) {
        double want = (double)whole->mean_m[3 * at + i] + whole->origin_enu_m[i % 3];
        assert_true(fabs((double)part->mean_m[i] + part->origin_enu_m[i % 3] - want) < 1e-4);
    }
    assert_memory_equal(part->sh, whole->sh + k * at, n * k * sizeof *part->sh);
    assert_memory_equal(part->quat_wxyz, whole->quat_wxyz + 4 * at, n * 16);
    assert_memory_equal(part->scale_log, whole->scale_log + 3 * at, n * 12);
}

static void expect_parts(const struct ply_stream *s, const struct gauss *whole)
{
    struct err e = {0};
    for (size_t at = 0, n; at < whole->n; at += n) {
        struct gauss part;
        n = at + 300 < whole->n ? 300 : whole->n - at;
        kit_ok(ply_stream_read(s, at, n, &part, &e), e);
        expect_part(whole, at, &part, n);
        gauss_free(&part);
    }
}

/* In parts: the same rows, in float32 and in doubles. */
static void test_in_parts(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct err e = {0};
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "a.ply", &e), e);
    for (uint32_t far = 0; far < 2; far++) {
        struct gauss g, whole, part;
        struct ply_stream *s;
        struct ply_info info = {0};
        struct buf b = {0};
        kit_gauss(far, 1000, 100, far ? 0 : 3, 0, &g);
        g.origin_enu_m[0] = far ? 2e6 : 0;
        kit_ok(ply_encode(&g, NULL, &b, &e), e);
        kit_ok(file_write(path, b.data, b.size, &e), e);
        kit_ok(ply_read(path, NULL, &whole, NULL, &e), e);
        kit_ok(ply_stream_open(path, &s, &info, &e), e);
        assert_non_null(s);
        assert_int_equal(ply_stream_rows(s).n, 1000);
        assert_int_equal(ply_stream_rows(s).doubles, far);
        expect_parts(s, &whole);
        kit_fails(ply_stream_read(s, 900, 101, &part, &e), ERR_ARG, e, "1000");
        ply_stream_close(&s);
        buf_free(&b);
        gauss_free(&g);
        gauss_free(&whole);
    }
    kit_rmdir(dir);
}

/* Red, green and blue from 0 to 255, of which the first part has only small ones: one range for all
 * parts. */
static void test_in_parts_colours(void **state)
{
    static const char head[] = "ply\nformat binary_little_endian 1.0\nelement vertex 600\n"
                               "property float x\nproperty float y\nproperty float z\n"
                               "property float red\nproperty float green\nproperty float blue\n"
                               "property float opacity\nproperty float scale_0\n"
                               "property float scale_1\nproperty float scale_2\n"
                               "property float rot_0\nproperty float rot_1\n"
                               "property float rot_2\nproperty float rot_3\nend_header\n";
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct gauss whole;
    struct ply_stream *s;
    struct ply_info info = {0};
    struct buf b = {0};
    struct err e = {0};
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "a.ply", &e), e);
    buf_add(&b, head, sizeof head - 1);
    for (size_t i = 0; i < 600; i++) {
        const float color = i < 300 ? 1.0f : 255.0f;
        const float row[14] = {(float)i, 0, 0, color, color, color, 0, -1, -1, -1, 1, 0, 0, 0};
        buf_add(&b, row, sizeof row);
    }
    kit_ok(file_write(path, b.data, b.size, &e), e);
    kit_ok(ply_read(path, NULL, &whole, NULL, &e), e);
    assert_true(fabsf(whole.sh[0] + 1.7586f) < 1e-3f && fabsf(whole.sh[3 * 599] - 1.7725f) < 1e-3f);
    kit_ok(ply_stream_open(path, &s, &info, &e), e);
    assert_non_null(s);
    expect_parts(s, &whole);
    ply_stream_close(&s);
    buf_free(&b);
    gauss_free(&whole);
    kit_rmdir(dir);
}

/* A file that is cut while it is read; other kinds are left to ply_read. */
static void test_in_parts_cut(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct gauss g, part;
    struct ply_stream *s;
    struct ply_info info = {0};
    struct buf b = {0};
    struct err e = {0};
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "a.ply", &e), e);
    kit_gauss(3, 1000, 100, 1, 0, &g);
    kit_ok(ply_encode(&g, NULL, &b, &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    kit_ok(ply_stream_open(path, &s, &info, &e), e);
    kit_ok(file_write(path, b.data, b.size - 5, &e), e); /* another file: the open one stays */
    kit_ok(ply_stream_read(s, 0, 1000, &part, &e), e);
    gauss_free(&part);
    ply_stream_close(&s);
    kit_fails(ply_stream_open(path, &s, &info, &e), ERR_FORMAT, e, "truncated");
    assert_null(s);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    kit_ok(ply_stream_open(path, &s, &info, &e), e);
    assert_int_equal(truncate(path, (off_t)b.size - 5), 0);
    kit_fails(ply_stream_read(s, 700, 300, &part, &e), ERR_FORMAT, e, "ends at byte");
    ply_stream_close(&s);
    buf_free(&b);
    kit_ok(ply_packed_encode(&g, 0, NULL, &b, &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    kit_ok(ply_stream_open(path, &s, &info, &e), e);
    assert_null(s);
    kit_fails(ply_stream_open("/none/a.ply", &s, &info, &e), ERR_NOENT, e, "/none/a.ply");
    buf_free(&b);
    gauss_free(&g);
    kit_rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip_is_lossless),
        cmocka_unit_test(test_layout_is_inrias),
        cmocka_unit_test(test_doubles_keep_their_precision),
        cmocka_unit_test(test_finds_properties_by_name),
        cmocka_unit_test(test_reads_text),
        cmocka_unit_test(test_reads_supersplats_packed_form),
        cmocka_unit_test(test_writes_supersplats_packed_form),
        cmocka_unit_test(test_truncation_and_flips),
        cmocka_unit_test(test_hostile_headers),
        cmocka_unit_test(test_empty_elements),
        cmocka_unit_test(test_bad_rows_are_named),
        cmocka_unit_test(test_other_columns),
        cmocka_unit_test(test_files),
        cmocka_unit_test(test_in_parts),
        cmocka_unit_test(test_in_parts_colours),
        cmocka_unit_test(test_in_parts_cut),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
