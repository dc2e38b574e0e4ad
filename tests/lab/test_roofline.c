/* What kernels have to do (lab/bench/roofline.c): the table of lab/studies/gpu.md for the
 * benchmark's city, every kernel with a limit, and limits worked out by hand.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/roofline.h"
#include "tests/kit.h"

#include <math.h>
#include <string.h>

/* The table has whole megabytes, and counts of three digits. */
#define MB_ROUNDING 1.0
#define MB_OF_COUNTS 0.005

/* A million Gaussians, 1280 x 720, as the page has it. */
static const struct roofline_work city = {.n = 1e6,
                                          .all = 1e6,
                                          .owed = 3e5,
                                          .visible = 0.57e6,
                                          .grouped = 0.57e6,
                                          .lists = 2.74e6,
                                          .entries = 2.6e6,
                                          .drawn = 2.5e6,
                                          .blocks = 1.5e7,
                                          .pixels = 1280 * 720,
                                          .tiles = 3600};

static double bytes_of(bool gpu, const char *const *kernels)
{
    struct roofline_work w = city;
    struct roofline_need need;
    double sum = 0.0;
    w.gpu = gpu;
    for (size_t i = 0; kernels[i]; i++) {
        assert_true(roofline_need(kernels[i], &w, &need));
        sum += need.bytes;
    }
    return sum;
}

/* Rows of the table. Sums of blocks (sum_scan) are a part of none. */
static void the_table_of_gpus(void **state)
{
    static const struct {
        double mb;
        const char *kernels[4];
        bool cpu; /* the same on CPUs, but for the tables of bin_expand */
    } rows[] = {
        {199, {"project"}, true},
        {12 + 81 + 11 + 153, {"sum_blocks", "sum_apply", "radix_count", "radix_scatter"}, false},
        {74, {"bin_expand"}, true},
        {66, {"bin_gather"}, false},
        {206, {"blend"}, false},
        {105, {"photometric_forward", "photometric_backward"}, false},
        {52, {"scale_count", "scale_grad"}, true},
        {376, {"blend_backward"}, false},
        /* a moment of 4 bytes, or of 2 */
        {ROOFLINE_MOMENT_BYTES > 2.0 ? 1609 : 1137, {"project_step"}, false}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        for (int gpu = rows[i].cpu ? 0 : 1; gpu < 2; gpu++) {
            const char *kernels[5] = {0};
            memcpy(kernels, rows[i].kernels, sizeof rows[i].kernels);
            double mb = bytes_of(gpu, kernels) * 1e-6;
            if (fabs(mb - rows[i].mb) > MB_ROUNDING + MB_OF_COUNTS * rows[i].mb)
                fail_msg("%s, gpu %d: %.1f MB, the page has %.0f", kernels[0], gpu, mb, rows[i].mb);
        }
}

/* In one shape at least, of a city and of a frame without anything in it. */
static void every_kernel_has_a_limit(void **state)
{
    struct roofline_need need;
    size_t i = 0;
    for (; roofline_name(i); i++) {
        bool known = false;
        for (int gpu = 0; gpu < 2; gpu++) {
            struct roofline_work w = city;
            w.gpu = gpu;
            if (!roofline_need(roofline_name(i), &w, &need))
                continue;
            known = true;
            struct roofline_limit limit = roofline_limit(&need, 231, 67);
            assert_true(isfinite(need.bytes) && need.bytes > 0);
            assert_true(isfinite(need.multiply_adds) && need.multiply_adds >= 0);
            assert_true(isfinite(limit.ms) && limit.ms > 0);
            w = (struct roofline_work){.gpu = gpu, .tiles = 1, .pixels = 1};
            assert_true(roofline_need(roofline_name(i), &w, &need));
            assert_true(isfinite(need.bytes) && need.bytes >= 0);
        }
        assert_true(known);
    }
    assert_true(i > 20);
    assert_false(roofline_need("nothing", &city, &need));
}

/* 67 MB at 67 GB/s, 231 M multiply-adds at 231 GFLOP/s: 1 ms and 2 ms. */
static void what_binds(void **state)
{
    struct roofline_need need = {.bytes = 67e6, .multiply_adds = 231e6};
    struct roofline_limit limit = roofline_limit(&need, 231, 67);
    assert_true(!limit.memory && fabs(limit.ms - 2.0) < 1e-9);
    need.multiply_adds = 0;
    limit = roofline_limit(&need, 231, 67);
    assert_true(limit.memory && fabs(limit.ms - 1.0) < 1e-9);
}

/* A block of 16 pixels more: 20 multiply-adds each forward, 39 and a division of 6 backward. A
 * Gaussian more that nothing sees: parameters and moments, read and written. */
static void by_hand(void **state)
{
    static const char *const names[] = {"blend", "blend_backward"};
    const double each[] = {20, 45};
    struct roofline_need before, after;
    struct roofline_work w = city;
    w.blocks += 1;
    for (size_t i = 0; i < 2; i++) {
        assert_true(roofline_need(names[i], &city, &before));
        assert_true(roofline_need(names[i], &w, &after));
        assert_true(fabs(after.multiply_adds - before.multiply_adds - 16 * each[i]) < 1e-6);
        assert_true(fabs(after.bytes - before.bytes) < 1e-6);
    }
    w = city;
    w.n += 1;
    assert_true(roofline_need("project_step", &city, &before));
    assert_true(roofline_need("project_step", &w, &after));
    assert_true(fabs(after.bytes - before.bytes - 2 * 59 * (4 + 2 * ROOFLINE_MOMENT_BYTES) - 4) <
                1e-6);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_table_of_gpus),
                                       cmocka_unit_test(every_kernel_has_a_limit),
                                       cmocka_unit_test(what_binds), cmocka_unit_test(by_hand)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
