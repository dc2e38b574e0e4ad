/* Rows in another order: against one row at a time, in place and not, over more than one chunk.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <string.h>

#include "render/permute.h"

enum { PLANES = 11 /* no multiple of those moved at a time */, MANY = 40000, FEW = 35000 };

static float value_of(size_t row, uint32_t plane)
{
    return (float)(row * PLANES + plane);
}

static float *array_make(size_t n, size_t room)
{
    float *a = mem_array(layout_floats(room, PLANES), sizeof *a);
    assert_non_null(a);
    for (size_t i = 0; i < layout_floats(room, PLANES); i++)
        a[i] = -1.0f; /* what must be overwritten */
    for (size_t i = 0; i < n; i++)
        for (uint32_t p = 0; p < PLANES; p++)
            a[layout_at(i, PLANES) + p * LAYOUT_LANES] = value_of(i, p);
    return a;
}

static void expect_rows(const float *a, const struct permutation *r, bool zero_new)
{
    size_t bad = 0;
    for (size_t d = 0; d < (r->n + LAYOUT_LANES - 1) / LAYOUT_LANES * LAYOUT_LANES; d++)
        for (uint32_t p = 0; p < PLANES; p++) {
            bool zero = d >= r->n || (zero_new && (r->source[d] & PERMUTE_NEW));
            float want = zero ? 0.0f : value_of(r->source[d] & ~PERMUTE_NEW, p);
            bad += a[layout_at(d, PLANES) + p * LAYOUT_LANES] != want;
        }
    assert_int_equal(bad, 0);
}

/* n rows, drawn from n_old with repetition; every third one is new. */
static void check(size_t n_old, size_t n, bool zero_new)
{
    struct err e = {0};
    size_t room = n > n_old ? n : n_old;
    uint32_t *source = mem_array(n, sizeof *source);
    float *from = array_make(n_old, room), *to = array_make(0, n);
    assert_non_null(source);
    for (size_t d = 0; d < n; d++)
        source[d] = (uint32_t)(rng_unit(5, n, d) * (double)n_old) | (d % 3 ? 0 : PERMUTE_NEW);
    const struct permutation r = {source, n, n_old, PLANES};
    kit_ok(permute_move(&r, zero_new, from, to, &e), e);
    expect_rows(to, &r, zero_new);
    kit_ok(permute_move(&r, zero_new, from, from, &e), e);
    expect_rows(from, &r, zero_new);
    mem_free(source);
    mem_free(from);
    mem_free(to);
}

static void rows_become_more(void **state)
{
    check(FEW, MANY, true);
    check(3, 17, false);
}

static void rows_become_fewer(void **state)
{
    check(MANY, FEW + 5, true);
    check(40, 1, true);
    check(MANY, MANY, false);
}

/* An order and its inverse leave everything as it was. */
static void an_order_can_be_taken_back(void **state)
{
    struct err e = {0};
    uint32_t *there = mem_array(FEW, sizeof *there), *back = mem_array(FEW, sizeof *back);
    float *a = array_make(FEW, FEW), *b = array_make(FEW, FEW);
    assert_true(there && back);
    for (uint32_t d = 0; d < FEW; d++) {
        there[d] = (uint32_t)((uint64_t)d * 7919 % FEW); /* coprime to FEW */
        back[there[d]] = d;
    }
    kit_ok(permute_move(&(struct permutation){there, FEW, FEW, PLANES}, false, a, a, &e), e);
    assert_true(a[0] == b[0] && a[1] != b[1]);
    kit_ok(permute_move(&(struct permutation){back, FEW, FEW, PLANES}, false, a, a, &e), e);
    for (size_t i = 0; i < FEW; i++)
        for (uint32_t p = 0; p < PLANES; p++)
            assert_true(a[layout_at(i, PLANES) + p * LAYOUT_LANES] == value_of(i, p));
    mem_free(there);
    mem_free(back);
    mem_free(a);
    mem_free(b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_become_more),
        cmocka_unit_test(rows_become_fewer),
        cmocka_unit_test(an_order_can_be_taken_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
