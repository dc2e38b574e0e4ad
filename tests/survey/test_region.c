/* Connected regions of pixels: shapes that join late, sums, random pictures against a flood fill.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "survey/region.h"

enum { WIDE = 61, HIGH = 47, PIXELS = WIDE * HIGH };

struct picture {
    int8_t kind[PIXELS];
    float value[PIXELS], sigma[PIXELS], edge[PIXELS];
    uint32_t region[PIXELS]; /* of the second pass */
};

static void find(struct picture *p, struct region_map *m)
{
    struct err e = {0};
    kit_ok(region_begin(m, WIDE, &e), e);
    for (size_t y = 0; y < HIGH; y++)
        kit_ok(region_add(m, p->kind + y * WIDE, p->value + y * WIDE, p->sigma + y * WIDE,
                          p->edge + y * WIDE, &e),
               e);
    uint32_t n = m->n;
    kit_ok(region_begin(m, WIDE, &e), e);
    for (size_t y = 0; y < HIGH; y++)
        memcpy(p->region + y * WIDE, region_tell(m, p->kind + y * WIDE), WIDE * sizeof *p->region);
    assert_int_equal(m->n, n);
}

/* A U whose arms meet in its last row, and a loss beside it. */
static void arms_of_a_u_are_one_region(void **state)
{
    static struct picture p;
    struct region_map m = {0};
    for (size_t y = 5; y < 20; y++)
        for (size_t x = 5; x < 20; x++)
            if (x < 7 || x >= 18 || y >= 18) {
                p.kind[y * WIDE + x] = 1;
                p.value[y * WIDE + x] = 2;
                p.sigma[y * WIDE + x] = 0.5f;
            }
    p.edge[10 * WIDE + 5] = 0.3f;
    p.kind[10 * WIDE + 5] = REGION_PIXEL | REGION_SEED | REGION_FIRM;
    p.kind[6 * WIDE + 5] = REGION_PIXEL | REGION_FIRM;
    p.value[10 * WIDE + 5] = 7;
    p.kind[10 * WIDE + 7] = -(REGION_PIXEL | REGION_SEED); /* touches it */
    p.value[10 * WIDE + 7] = -3;
    find(&p, &m);
    size_t pixels = 15 * 15 - 11 * 13;
    const struct region *u = &m.list[p.region[5 * WIDE + 5]],
                        *lost = &m.list[p.region[10 * WIDE + 7]];
    assert_int_equal(p.region[5 * WIDE + 5], p.region[5 * WIDE + 19]);
    assert_int_equal(u->pixels, pixels);
    assert_int_equal(u->seeds, 1);
    assert_int_equal(u->firm, 2);
    assert_true(fabs(u->sum - (2.0 * (double)pixels + 5)) < 1e-9 && u->most == 7);
    assert_true(fabs(u->variance - (0.25 * (double)pixels - 0.09)) < 1e-6);
    assert_true(fabs(u->edge - 0.3) < 1e-6);
    assert_int_equal(lost->pixels, 1);
    assert_true(lost->sum == -3 && lost->seeds == 1 && !lost->firm);
    assert_int_equal(p.region[0], 0);
    region_free(&m);
    region_free(&m); /* idempotent */
}

static void flood(const struct picture *p, size_t from, uint8_t *seen, size_t *pixels, double *sum)
{
    static size_t stack[4 * PIXELS];
    size_t n = 0;
    int sign = p->kind[from] > 0 ? 1 : -1;
    stack[n++] = from;
    while (n) {
        size_t at = stack[--n], x = at % WIDE, y = at / WIDE;
        if (seen[at] || p->kind[at] * sign <= 0)
            continue;
        seen[at] = 1;
        ++*pixels;
        *sum += (double)p->value[at];
        assert_int_equal(p->region[at], p->region[from]);
        if (x > 0)
            stack[n++] = at - 1;
        if (x + 1 < WIDE)
            stack[n++] = at + 1;
        if (y > 0)
            stack[n++] = at - WIDE;
        if (y + 1 < HIGH)
            stack[n++] = at + WIDE;
    }
}

static void random_pictures_are_as_flooded(void **state)
{
    static struct picture p;
    static uint8_t seen[PIXELS];
    for (uint64_t round = 0; round < 40; round++) {
        struct region_map m = {0};
        size_t regions = 0, roots = 0;
        for (size_t i = 0; i < PIXELS; i++) {
            double u = rng_unit(9, round, i);
            p.kind[i] = u < 0.2 ? 0 : u < 0.6 ? 1 : u < 0.63 ? REGION_PIXEL | REGION_SEED : -1;
            p.value[i] = (float)(p.kind[i] * rng_unit(10, round, i));
            p.sigma[i] = 1;
        }
        find(&p, &m);
        memset(seen, 0, sizeof seen);
        for (size_t i = 0; i < PIXELS; i++) {
            size_t pixels = 0;
            double sum = 0;
            if (seen[i] || !p.kind[i])
                continue;
            flood(&p, i, seen, &pixels, &sum);
            const struct region *r = &m.list[p.region[i]];
            assert_true(r->pixels == pixels && fabs(r->sum - sum) < 1e-6);
            assert_true(r->variance == (double)pixels);
            regions++;
        }
        for (uint32_t i = 1; i < m.n; i++)
            roots += m.list[i].of == i;
        assert_int_equal(roots, regions);
        region_free(&m);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(arms_of_a_u_are_one_region),
        cmocka_unit_test(random_pictures_are_as_flooded),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
