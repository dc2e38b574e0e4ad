/* Rows that need only look alike: the same ellipsoid under the rotation that is the smallest, the
 * same colours from above by coarser harmonics, the same mass.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/quant_look.h"

#include <math.h>
#include <string.h>

#include "codec/splat/draco.h"
#include "core/splat/sh.h"
#include "tests/codec/quant_kit.h"
#include "tests/kit.h"

enum { N = 2000, DIRECTIONS = 40 };

/* sizes[c] along the axes of the rotation: [6] of the symmetric matrix. */
static void covariance(const float q_any[4], const double size[3], double out[6])
{
    double q[4], n = 0;
    for (int i = 0; i < 4; i++)
        n += (double)q_any[i] * (double)q_any[i];
    for (int i = 0; i < 4; i++)
        q[i] = (double)q_any[i] / sqrt(n);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double m[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                            {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                            {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    for (int r = 0, at = 0; r < 3; r++)
        for (int c = 0; c <= r; c++, at++) {
            out[at] = 0;
            for (int k = 0; k < 3; k++)
                out[at] += m[r][k] * size[k] * m[c][k];
        }
}

static void test_turned_ellipsoids_are_the_same(void **state)
{
    const double half_turn = cos(62.8 / 2 / 57.29577951308232); /* no rotation is farther off */
    for (uint64_t i = 0; i < N; i++) {
        float q[4], was[4];
        uint8_t scale[3];
        double size[3], want[6], got[6], n = 0;
        for (uint64_t k = 0; k < 4; k++) {
            q[k] = was[k] = (float)(3 * rng_normal(1, k, i));
            n += (double)q[k] * (double)q[k];
        }
        for (uint64_t k = 0; k < 3; k++) {
            scale[k] = (uint8_t)(1 + 250 * rng_unit(2, k, i));
            size[k] = scale[k];
        }
        covariance(q, size, want);
        quant_look_turn(q, scale);
        for (int k = 0; k < 3; k++)
            size[k] = scale[k];
        covariance(q, size, got);
        kit_near_d("covariance", got, want, 6, 1e-3, 0);
        assert_true(fabs((double)q[0]) / sqrt(n) > half_turn);
        memcpy(was, q, sizeof was);
        quant_look_turn(q, scale); /* a second time: it is turned least already */
        assert_memory_equal(q, was, sizeof q);
    }
}

/* Sums over rows and channels of the colour's squared error, seen from above and from below,
 * weighted by the cosine to the vertical; and how many harmonics are not 0. */
struct seen {
    double above, below;
    size_t n_set;
};

static struct seen seen_error(const struct gauss *g, uint32_t degree, const struct quant_grid *grid)
{
    struct quant q;
    struct gauss back;
    struct err e = {0};
    struct seen s = {0};
    kit_ok(quant_from_gauss(g, degree, grid, &q, &e), e);
    kit_ok(quant_to_gauss(&q, &back, &e), e);
    const size_t k_in = gauss_sh_count(g->sh_degree), k_out = gauss_sh_count(back.sh_degree);
    for (size_t i = 0; i < 3 * (k_out - 1) * q.n; i++)
        s.n_set += q.sh[i] != 128;
    for (size_t i = 0; i < g->n; i++)
        for (uint64_t d = 0; d < DIRECTIONS; d++) {
            double dir[3], y[LAYOUT_SH_MAX], length = 0;
            for (uint64_t k = 0; k < 3; k++) {
                dir[k] = rng_normal(3, k, i * DIRECTIONS + d);
                length += dir[k] * dir[k];
            }
            for (int k = 0; k < 3; k++)
                dir[k] /= sqrt(length);
            sh_basis(dir, 3, y);
            for (size_t c = 0; c < 3; c++) {
                double off = 0;
                for (size_t k = 0; k < k_in; k++)
                    off += y[k] * (double)g->sh[(i * k_in + k) * 3 + c];
                for (size_t k = 0; k < k_out; k++)
                    off -= y[k] * (double)back.sh[(i * k_out + k) * 3 + c];
                *(dir[1] < 0 ? &s.above : &s.below) += off * off * fabs(dir[1]); /* y is up */
            }
        }
    gauss_free(&back);
    quant_free(&q);
    return s;
}

static void colored(struct gauss *g)
{
    kit_gauss(4, N / 4, 30, 3, 0, g);
    for (size_t i = 0; i < 48 * g->n; i++)
        g->sh[i] *= i % 48 < 3 ? 0.5f : 0.3f; /* as trained: harmonics of 1.5 steps */
}

static void test_colors_look_alike_from_above(void **state)
{
    struct gauss g;
    colored(&g);
    struct quant_grid look = *quant_preset_grid(QUANT_BALANCED), nearest = look;
    assert_int_equal(look.look, 1);
    nearest.look = 0;
    const struct seen a = seen_error(&g, 3, &look), b = seen_error(&g, 3, &nearest);
    if (!(a.above < 0.8 * b.above && a.below < 6 * b.below && a.n_set < b.n_set))
        fail_msg("above %g of %g, below %g of %g, %zu of %zu harmonics", a.above, b.above, a.below,
                 b.below, a.n_set, b.n_set);
    for (uint32_t degree = 0; degree < 3; degree++) { /* what lower degrees lack is made up for */
        const struct seen less = seen_error(&g, degree, &look),
                          cut = seen_error(&g, degree, &nearest);
        if (!(less.above < 0.9 * cut.above))
            fail_msg("degree %u: %g of %g", degree, less.above, cut.above);
    }
    gauss_free(&g);
}

/* Numbers without limits end at the limits of the fields, as elsewhere. */
static void test_limits(void **state)
{
    struct gauss g;
    struct quant q;
    struct err e = {0};
    kit_gauss(5, 8, 30, 3, 0, &g);
    for (size_t i = 0; i < 48 * g.n; i++)
        g.sh[i] = i % 2 ? 3e38f : -3e38f;
    for (size_t i = 0; i < g.n; i++) {
        g.opacity_logit[i] = i % 2 ? 1e5f : -1e5f;
        g.scale_log[3 * i] = 3e38f;
        g.scale_log[3 * i + 1] = -3e38f;
    }
    kit_ok(quant_from_gauss(&g, 3, quant_preset_grid(QUANT_BALANCED), &q, &e), e);
    for (size_t i = 0; i < g.n; i++) {
        assert_true(i % 2 ? q.alpha[i] >= 239 : q.alpha[i] == 0);
        for (size_t c = 0; c < 3; c++)
            assert_true(q.color[3 * i + c] <= 16 || q.color[3 * i + c] >= 239);
    }
    quant_free(&q);
    gauss_free(&g);
}

static double mass(double opacity, const float ln[3])
{
    const double a = (double)ln[0], b = (double)ln[1], c = (double)ln[2];
    return opacity * (exp(a + b) + exp(a + c) + exp(b + c));
}

static double mass_error(const struct gauss *g, const struct quant_grid *grid)
{
    struct quant q;
    struct gauss back;
    struct err e = {0};
    double sum = 0;
    kit_ok(quant_from_gauss(g, 0, grid, &q, &e), e);
    kit_ok(quant_to_gauss(&q, &back, &e), e);
    for (size_t i = 0; i < g->n; i++) {
        const double o = 1 / (1 + exp(-(double)g->opacity_logit[i]));
        sum += fabs(
            mass(q.alpha[i] / 255.0, back.scale_log + 3 * i) / mass(o, g->scale_log + 3 * i) - 1);
    }
    quant_free(&q);
    gauss_free(&back);
    return sum / (double)g->n;
}

static void test_opacity_makes_up_for_sizes(void **state)
{
    struct gauss g;
    struct quant_grid look = {.scale = 1, .look = 1}, nearest = {.scale = 1};
    kit_gauss(6, N, 30, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) /* of 0.2 to 0.7: steps of 255 are a percent, none is cut */
        g.opacity_logit[i] = (float)(2.2 * rng_unit(7, 0, i) - 1.4);
    const double a = mass_error(&g, &look), b = mass_error(&g, &nearest);
    if (!(a < 0.01 && a < 0.25 * b))
        fail_msg("mass off by %g, of nearest sizes %g", a, b);
    gauss_free(&g);
}

static size_t file_bytes(const struct gauss *g, const struct quant_grid *grid)
{
    struct quant q;
    struct buf b = {0};
    struct err e = {0};
    kit_ok(quant_from_gauss(g, 3, grid, &q, &e), e);
    kit_ok(draco_encode(&q, NULL, &b, &e), e);
    const size_t bytes = b.size;
    quant_free(&q);
    buf_free(&b);
    return bytes;
}

static void test_files_are_smaller(void **state)
{
    struct gauss g;
    struct quant_grid look = *quant_preset_grid(QUANT_BALANCED), nearest = look;
    nearest.look = 0;
    kit_gauss(8, 20000, 30, 0, 0, &g);
    const size_t a = file_bytes(&g, &look), b = file_bytes(&g, &nearest);
    if (!((double)a < (double)b - 0.45 * (double)g.n)) /* log2(24) bits a row are 0.57 bytes */
        fail_msg("%zu bytes, %zu with the nearest integers", a, b);
    gauss_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_turned_ellipsoids_are_the_same),
        cmocka_unit_test(test_colors_look_alike_from_above),
        cmocka_unit_test(test_limits),
        cmocka_unit_test(test_opacity_makes_up_for_sizes),
        cmocka_unit_test(test_files_are_smaller),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
