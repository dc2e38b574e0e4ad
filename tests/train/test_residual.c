/* Ranking photographs by their residuals: z-scores by hand, ties and even columns, the file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "train/photographs/residual.h"

#define HAND_TOL 1e-12 /* a few operations in double */

static void z_scores_are_those_worked_out_by_hand(void **state)
{
    /* Median of 1 2 3 4 100 is 3, of the distances 2 1 0 1 97 it is 1. */
    const double x[5] = {1.0, 2.0, 3.0, 4.0, 100.0};
    double scratch[5], z[5];
    residual_z(x, 5, 0.0, scratch, z);
    const double want[5] = {-2 * 0.6745, -0.6745, 0.0, 0.6745, 97 * 0.6745};
    kit_near_d("z", z, want, 5, HAND_TOL, HAND_TOL);
    /* An even number: median 2.5, distances 1.5 0.5 0.5 1.5, MAD 1. */
    residual_z(x, 4, 0.0, scratch, z);
    const double even[4] = {-1.5 * 0.6745, -0.5 * 0.6745, 0.5 * 0.6745, 1.5 * 0.6745};
    kit_near_d("even", z, even, 4, HAND_TOL, HAND_TOL);
    /* All alike: the least MAD keeps rounding from being suspicious. */
    const double same[3] = {0.5, 0.5 + 1e-9, 0.5};
    residual_z(same, 3, 1e-3, scratch, z);
    assert_true(fabs(z[1]) < 1e-5);
    residual_z(x, 0, 0.0, scratch, z);
}

static void a_photograph_that_does_not_fit_is_named_first(void **state)
{
    struct err e = {0};
    struct residual_list l = {0};
    static char names[100][8];
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    for (size_t i = 0; i < 100; i++) {
        snprintf(names[i], sizeof names[i], "p%02zu", i);
        /* 25 dB and SSIM 0.8 with some spread; photograph 40 has bad structure alone, 70 bad
         * colours alone, and 10 fits better than all. */
        double db = 25.0 + 0.5 * rng_normal(1, 0, i), ssim = 0.8 + 0.01 * rng_normal(1, 1, i);
        ssim = i == 40 ? 0.6 : i == 10 ? 0.99 : fmin(fmax(ssim, 0.78), 0.82);
        db = i == 70 ? 18.0 : i == 10 ? 40.0 : fmin(fmax(db, 24.2), 25.8);
        kit_ok(residual_add(&l, names[i], pow(10.0, -0.1 * db), ssim, 0.0, &e), e);
    }
    kit_ok(residual_rank(&l, &e), e);
    assert_int_equal(l.n, 100);
    assert_int_equal(l.n_suspicious, 2);
    assert_true(l.rows[0].z >= l.rows[1].z && l.rows[1].z > RESIDUAL_LIMIT);
    for (size_t i = 0; i < 2; i++) {
        bool structure = !strcmp(l.rows[i].name, "p40");
        assert_true(structure || !strcmp(l.rows[i].name, "p70"));
        assert_true(structure ? l.rows[i].z_ssim > l.rows[i].z_mse
                              : l.rows[i].z_mse > l.rows[i].z_ssim);
    }
    kit_expect_text(l.rows[99].name, "p10", __FILE__, __LINE__);
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "residuals.json", &e), e);
    kit_ok(residual_write(&l, path, "level 3", &e), e);
    struct json_t *o = NULL;
    kit_ok(jsonc_read(path, &o, &e), e);
    const json_t *first = json_array_get(json_object_get(o, "photographs"), 0);
    assert_int_equal(json_array_size(json_object_get(o, "photographs")), 100);
    assert_int_equal(json_integer_value(json_object_get(o, "suspicious")), 2);
    assert_true(json_is_true(json_object_get(first, "suspicious")));
    assert_string_equal(json_string_value(json_object_get(first, "name")), l.rows[0].name);
    json_decref(o);
    /* Everything fits exactly: nothing to suspect, nothing divides by zero. */
    residual_clear(&l);
    for (size_t i = 0; i < 5; i++)
        kit_ok(residual_add(&l, names[i], 0.0, 1.0, 0.0, &e), e);
    kit_ok(residual_rank(&l, &e), e);
    assert_int_equal(l.n_suspicious, 0);
    kit_expect_text(l.rows[0].name, "p00", __FILE__, __LINE__);
    kit_ok(residual_write(&l, path, "level 3", &e), e);
    residual_clear(&l);
    kit_ok(residual_rank(&l, &e), e);
    residual_free(&l);
    kit_rmdir(dir);
}

/* At the rim all fit worse, and are not suspected for that; the one that fits badly even there
 * is. */
static void photographs_are_compared_with_those_of_like_coverage(void **state)
{
    enum { N = 60, RIM = 20 };
    static char names[N][8];
    for (int known = 0; known < 2; known++) {
        struct residual_list l = {0};
        struct err e = {0};
        for (int i = 0; i < N; i++) {
            bool rim = i < RIM;
            double db = (rim ? 24.0 : 32.0) + 0.05 * (i * 7 % 11) - (i == 5 ? 3.0 : 0.0);
            snprintf(names[i], sizeof names[i], "p%02d", i);
            kit_ok(residual_add(&l, names[i], pow(10.0, -0.1 * db), rim ? 0.8 : 0.95,
                                known ? (rim ? 1.5 : 4.0) : 0.0, &e),
                   e);
        }
        kit_ok(residual_rank(&l, &e), e);
        assert_int_equal(l.n_suspicious, known ? 1 : RIM);
        if (known)
            kit_expect_text(l.rows[0].name, "p05", __FILE__, __LINE__);
        residual_free(&l);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(z_scores_are_those_worked_out_by_hand),
        cmocka_unit_test(a_photograph_that_does_not_fit_is_named_first),
        cmocka_unit_test(photographs_are_compared_with_those_of_like_coverage),
    };
    return cmocka_run_group_tests_name("residual", tests, NULL, NULL);
}
