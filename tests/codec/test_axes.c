/* ENU <-> glTF: positions, ellipsoids and colours must look the same from the same place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/axes.h"
#include "tests/kit.h"

#include <math.h>

/* float32 sums of up to three products of values below 1 */
#define SH_TOL 2e-6f
#define ROTATION_TOL 1e-6f
/* five turns, each with the former, of values up to 3 */
#define ANY_TOL 1e-5

/* The basis as in the 3DGS paper's code, in double. */
static double sh_eval(const float *sh, size_t k, size_t channel, const double d[3])
{
    double x = d[0], y = d[1], z = d[2];
    const double basis[16] = {
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    };
    double v = 0;
    for (size_t i = 0; i < k; i++)
        v += basis[i] * (double)sh[3 * i + channel];
    return v;
}

static void to_gltf(const double enu[3], double out[3])
{
    out[0] = enu[0];
    out[1] = enu[2];
    out[2] = -enu[1];
}

static void rotate(const float q[4], const double v[3], double out[3])
{
    double w = (double)q[0], x = (double)q[1], y = (double)q[2], z = (double)q[3];
    const double m[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    for (int r = 0; r < 3; r++)
        out[r] = m[3 * r] * v[0] + m[3 * r + 1] * v[1] + m[3 * r + 2] * v[2];
}

static void normalise(struct gauss *g)
{
    for (size_t i = 0; i < g->n; i++) {
        float *q = g->quat_wxyz + 4 * i;
        float n = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        for (int c = 0; c < 4; c++)
            q[c] /= n;
    }
}

/* Colours seen along 50 directions, and where each ellipsoid's axes point. */
static void test_looks_the_same(void **state)
{
    for (uint32_t degree = 0; degree <= 3; degree++) {
        struct gauss a, b = {0};
        struct err e = {0};
        kit_gauss(7, 20, 3, degree, 2, &a);
        normalise(&a);
        kit_ok(gauss_alloc(&b, a.n, degree, 2, &e), e);
        kit_ok(gauss_append(&b, &a, NULL, a.n, &e), e);
        axes_enu_to_gltf(&b);
        size_t k = gauss_sh_count(degree);
        for (size_t i = 0; i < a.n; i++) {
            const double want_mean[3] = {(double)a.mean_m[3 * i], (double)a.mean_m[3 * i + 2],
                                         -(double)a.mean_m[3 * i + 1]};
            kit_near("mean", b.mean_m + 3 * i, want_mean, 3, 0, 0);
            for (int axis = 0; axis < 3; axis++) {
                const double unit[3] = {axis == 0, axis == 1, axis == 2};
                double in_enu[3], want[3], got[3];
                rotate(a.quat_wxyz + 4 * i, unit, in_enu);
                to_gltf(in_enu, want);
                rotate(b.quat_wxyz + 4 * i, unit, got);
                kit_near_d("axis", got, want, 3, (double)ROTATION_TOL, 0);
            }
            for (uint64_t s = 0; s < 50; s++) {
                double d[3] = {rng_normal(1, s, 0), rng_normal(1, s, 1), rng_normal(1, s, 2)}, t[3];
                double n = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
                for (int c = 0; c < 3; c++)
                    d[c] /= n;
                to_gltf(d, t);
                for (size_t c = 0; c < 3; c++) {
                    double want = sh_eval(a.sh + 3 * k * i, k, c, d);
                    double got = sh_eval(b.sh + 3 * k * i, k, c, t);
                    kit_near_d("colour", &got, &want, 1, (double)SH_TOL * (double)k, 0);
                }
            }
        }
        gauss_free(&a);
        gauss_free(&b);
    }
}

static void test_there_and_back(void **state)
{
    struct gauss a, b = {0};
    struct err e = {0};
    kit_gauss(8, 50, 3, 3, 0, &a);
    normalise(&a);
    kit_ok(gauss_alloc(&b, a.n, 3, 0, &e), e);
    kit_ok(gauss_append(&b, &a, NULL, a.n, &e), e);
    axes_enu_to_gltf(&b);
    axes_gltf_to_enu(&b);
    for (size_t i = 0; i < 3 * a.n; i++)
        assert_true(a.mean_m[i] == b.mean_m[i]);
    for (size_t i = 0; i < 4 * a.n; i++)
        assert_true(fabsf(a.quat_wxyz[i] - b.quat_wxyz[i]) < ROTATION_TOL);
    for (size_t i = 0; i < 48 * a.n; i++)
        assert_true(fabsf(a.sh[i] - b.sh[i]) < SH_TOL);
    gauss_free(&a);
    gauss_free(&b);
}

/* What 3D Tiles clients were measured to show: one coefficient of 0.9 over DC 0.5 grey, six views
 * in glTF axes; coefficient 0 is bright along -y, 1 along +z, 2 along -x, and 128 elsewhere. */
static void test_single_coefficients_from_six_directions(void **state)
{
    for (int coef = 0; coef < 3; coef++) {
        float sh[12] = {0};
        sh[3 * (1 + coef)] = 0.9f;
        for (int axis = 0; axis < 3; axis++)
            for (int sign = -1; sign <= 1; sign += 2) {
                double d[3] = {0};
                d[axis] = sign;
                double byte = 255 * fmin(1, fmax(0, sh_eval(sh, 4, 0, d) + 0.5));
                int bright_axis = coef == 0 ? 1 : coef == 1 ? 2 : 0;
                int bright_sign = coef == 1 ? 1 : -1;
                double want = axis != bright_axis ? 127.5 : sign == bright_sign ? 239.6 : 15.4;
                kit_near_d("centre pixel", &byte, &want, 1, 0.5, 0);
            }
    }
    /* The same lobes from ENU: what is bright when looking east, north or up must stay so. */
    static const struct {
        int coef;       /* ENU coefficient set */
        double look[3]; /* ENU direction of the bright side */
    } lobes[] = {{0, {0, -1, 0}}, {1, {0, 0, 1}}, {2, {-1, 0, 0}}};
    for (size_t i = 0; i < 3; i++) {
        struct gauss g = {0};
        struct err e = {0};
        double look[3];
        kit_ok(gauss_alloc(&g, 1, 1, 0, &e), e);
        g.n = 1;
        g.quat_wxyz[0] = 1;
        g.sh[3 * (1 + lobes[i].coef)] = 0.9f;
        axes_enu_to_gltf(&g);
        to_gltf(lobes[i].look, look);
        double got = sh_eval(g.sh, 4, 0, look), want = 0.9 * 0.4886025119029199;
        kit_near_d("lobe", &got, &want, 1, 1e-7, 0);
        gauss_free(&g);
    }
}

/* A rotation matrix by Euler's angles, and the same turned vectors and colours. */
static void test_any_turn(void **state)
{
    static const double angles[][3] = {
        {0.3, 1.1, -2}, {2.5, 3.1, 0.4}, {0.7, 0, 0.9}, {0.2, 3.14159265358979, 1}, {-1, -0.8, 0}};
    for (size_t t = 0; t < sizeof angles / sizeof *angles; t++) {
        const double *a = angles[t], ca = cos(a[0]), sa = sin(a[0]), cb = cos(a[1]), sb = sin(a[1]),
                     cc = cos(a[2]), sc = sin(a[2]);
        const double rot[9] = {ca * cb * cc - sa * sc,
                               -ca * cb * sc - sa * cc,
                               ca * sb,
                               sa * cb * cc + ca * sc,
                               -sa * cb * sc + ca * cc,
                               sa * sb,
                               -sb * cc,
                               sb * sc,
                               cb};
        struct gauss g, turned = {0};
        struct err e = {0};
        kit_gauss(11, 20, 3, 3, 0, &g);
        normalise(&g);
        kit_ok(gauss_alloc(&turned, g.n, 3, 0, &e), e);
        kit_ok(gauss_append(&turned, &g, NULL, g.n, &e), e);
        axes_turn(&turned, rot);
        for (size_t i = 0; i < g.n; i++) {
            double want[3];
            for (int r = 0; r < 3; r++)
                want[r] = rot[3 * r] * (double)g.mean_m[3 * i] +
                          rot[3 * r + 1] * (double)g.mean_m[3 * i + 1] +
                          rot[3 * r + 2] * (double)g.mean_m[3 * i + 2];
            kit_near("mean", turned.mean_m + 3 * i, want, 3, ANY_TOL, 0);
            for (size_t axis = 0; axis < 3; axis++) {
                const double unit[3] = {axis == 0, axis == 1, axis == 2};
                double was[3], is[3], aim[3];
                rotate(g.quat_wxyz + 4 * i, unit, was);
                rotate(turned.quat_wxyz + 4 * i, unit, is);
                for (int r = 0; r < 3; r++)
                    aim[r] =
                        rot[3 * r] * was[0] + rot[3 * r + 1] * was[1] + rot[3 * r + 2] * was[2];
                kit_near_d("axis", is, aim, 3, ANY_TOL, 0);
                const double from = sh_eval(g.sh + i * 48, 16, axis, was),
                             to = sh_eval(turned.sh + i * 48, 16, axis, aim);
                kit_near_d("colour", &to, &from, 1, ANY_TOL, 0);
            }
        }
        gauss_free(&g);
        gauss_free(&turned);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_looks_the_same),
        cmocka_unit_test(test_there_and_back),
        cmocka_unit_test(test_single_coefficients_from_six_directions),
        cmocka_unit_test(test_any_turn),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
