/* Gaussians that reach out of the photographs are cut at their edge, and nothing else changes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/splat/gauss.h"
#include "scene/cells/footprint.h"
#include "scene/cells/trim.h"
#include "tests/scene/flight_kit.h"

enum { GRID = 60 };
#define SIGMA 2.0   /* of the Gaussians */
#define APART 3.0   /* their places */
#define EDGE_X 90.0 /* the pictures end there, */
#define EDGE_Y 80.0 /* and there */

/* A carpet of discs over the ground and beyond, turned against the grid. */
static void carpet(struct gauss *g)
{
    struct err e = {0};
    kit_ok(gauss_alloc(g, GRID * GRID, 1, 2, &e), e);
    g->n = GRID * GRID;
    g->origin_enu_m[0] = 5.0;
    for (size_t i = 0; i < g->n; i++) {
        double x = APART * ((double)(i % GRID) - 0.5 * GRID),
               y = APART * ((double)(i / GRID) - 0.5 * GRID), turn = 0.37 * (double)i;
        g->mean_m[3 * i] = (float)(1.3 * x - 5.0);
        g->mean_m[3 * i + 1] = (float)(1.1 * y);
        g->scale_log[3 * i] = (float)log(SIGMA);
        g->scale_log[3 * i + 1] = (float)log(0.7 * SIGMA);
        g->scale_log[3 * i + 2] = (float)log(0.05);
        g->quat_wxyz[4 * i] = (float)cos(turn);
        g->quat_wxyz[4 * i + 3] = (float)sin(turn);
        g->opacity_logit[i] = 2.0f;
        g->embed[2 * i] = (float)i;
    }
}

/* What lies over a place of the ground: sum of optical thicknesses times falloffs. */
static double cover(const struct gauss *g, double x, double y)
{
    double sum = 0.0;
    for (size_t i = 0; i < g->n; i++) {
        double q[4], rot[9], d[3] = {x, y, 0}, at = 0.0;
        for (int a = 0; a < 3; a++)
            d[a] -= (double)g->mean_m[3 * i + a] + g->origin_enu_m[a];
        if (fabs(d[0]) > 12 || fabs(d[1]) > 12)
            continue;
        for (int a = 0; a < 4; a++)
            q[a] = (double)g->quat_wxyz[4 * i + a];
        camera_quat_to_rot(q, rot);
        for (int k = 0; k < 3; k++) {
            double t = (rot[k] * d[0] + rot[3 + k] * d[1] + rot[6 + k] * d[2]) /
                       exp((double)g->scale_log[3 * i + k]);
            at += t * t;
        }
        sum += exp(-0.5 * at) * log1p(exp((double)g->opacity_logit[i]));
    }
    return sum;
}

/* Means over places so far outside of the edge (negative: inside), all around. */
static double ring(const struct gauss *g, double out)
{
    enum { N = 50 };
    double sum = 0.0;
    for (int k = 0; k < N; k++) {
        double u = (k + 0.5) / N * 2.0 - 1.0;
        sum +=
            cover(g, u * (EDGE_X - 10), EDGE_Y + out) + cover(g, u * (EDGE_X - 10), -EDGE_Y - out) +
            cover(g, EDGE_X + out, u * (EDGE_Y - 10)) + cover(g, -EDGE_X - out, u * (EDGE_Y - 10));
    }
    return sum / (4.0 * N);
}

static void test_edge(void **state)
{
    struct scene s;
    struct footprint f;
    struct trim t;
    struct gauss before = {0}, g = {0};
    struct err e = {0};
    size_t gone = 0, same = 0, inside = 0;
    flight_kit_scene(&s);
    kit_ok(footprint_of(&s, &f, &e), e);
    kit_ok(trim_open(&s, &f, 3, 3.0, &t, &e), e);
    carpet(&before);
    carpet(&g);
    kit_ok(trim_rows(&t, &g, &gone, &e), e);
    print_message("%zu Gaussians, %zu gone, %zu left; least sigma %.2f m\n", before.n, gone, g.n,
                  t.least_m);
    static const double outs[] = {-20, -3, -1, 0.5, 1, 2, 4};
    for (size_t k = 0; k < sizeof outs / sizeof *outs; k++)
        print_message("%5.1f m outside: %.3f before, %.3f after\n", outs[k], ring(&before, outs[k]),
                      ring(&g, outs[k]));
    assert_true(gone > 100 && gone < before.n);
    /* Outside a tenth is left one metre off, nothing at two; inside it stays covered. */
    assert_true(ring(&g, 1.0) < 0.1 * ring(&before, 1.0));
    assert_true(ring(&g, 2.0) < 0.01);
    assert_true(ring(&before, 2.0) > 1.0);
    assert_true(ring(&g, -1.0) > 0.75 * ring(&before, -1.0));
    assert_true(ring(&g, -1.0) < 1.25 * ring(&before, -1.0));
    assert_true(fabs(ring(&g, -20.0) - ring(&before, -20.0)) < 1e-4);
    /* Every middle is shown; colours and embeddings come along. */
    for (size_t i = 0; i < g.n; i++) {
        double x[3];
        for (int a = 0; a < 3; a++)
            x[a] = (double)g.mean_m[3 * i + a] + g.origin_enu_m[a];
        assert_true(fabs(x[0]) < EDGE_X + 1e-3 && fabs(x[1]) < EDGE_Y + 1e-3);
        size_t from = (size_t)(g.embed[2 * i] + 0.5f);
        same += !memcmp(&g.mean_m[3 * i], &before.mean_m[3 * from], 12) &&
                !memcmp(&g.scale_log[3 * i], &before.scale_log[3 * from], 12);
    }
    for (size_t i = 0; i < before.n; i++)
        inside += fabs((double)before.mean_m[3 * i] + 5.0) < EDGE_X - 2 * SIGMA - 1 &&
                  fabs((double)before.mean_m[3 * i + 1]) < EDGE_Y - 2 * SIGMA - 1;
    assert_true(same >= inside && inside > 1000);
    gauss_free(&before);
    gauss_free(&g);
    trim_free(&t);
    footprint_free(&f);
    arena_free(&s.arena);
}

/* Asked place by place it is what the cameras say, whichever way a cell is known. */
static void test_places(void **state)
{
    struct scene s;
    struct footprint f;
    struct trim t;
    struct err e = {0};
    size_t seen = 0, n = 0;
    flight_kit_scene(&s);
    s.images[7].split = SCENE_TEST;
    kit_ok(footprint_of(&s, &f, &e), e);
    kit_ok(trim_open(&s, &f, 3, 3.0, &t, &e), e);
    for (int column = 0; column < 142; column++)
        for (int row = 0; row < 170; row++, n++) {
            const double x = -120.25 + 1.7 * column, y = -110.25 + 1.3 * row, at[3] = {x, y, 0};
            bool want = fabs(x) < EDGE_X && fabs(y) < EDGE_Y;
            assert_true(trim_shows(&t, at) == want);
            seen += want;
        }
    assert_true(seen > n / 3 && seen < n);
    const double far[3] = {1e6, 0, 0};
    assert_true(!trim_shows(&t, far) && !trim_holds(&t, far));
    /* Where many look heights are free, at the rim they are those of the points around. */
    const double middle[3] = {0, 0, 20}, rim[3] = {85, 75, 0.5}, over[3] = {85, 75, 1.0},
                 under[3] = {85, 75, -1.0};
    assert_true(trim_holds(&t, middle) && trim_holds(&t, rim));
    assert_true(trim_shows(&t, over) && !trim_holds(&t, over) && !trim_holds(&t, under));
    static const double flat[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const double large[3] = {3, 3, 0.1}, small[3] = {0.3, 0.3, 0.1};
    assert_true(trim_judge(&t, middle, large, flat, 1.0) == TRIM_INSIDE);
    assert_true(trim_judge(&t, rim, large, flat, 1.0) == TRIM_STICKS_OUT);
    assert_true(trim_judge(&t, rim, large, flat, 4.0) == TRIM_INSIDE);
    assert_true(trim_judge(&t, rim, small, flat, 1.0) == TRIM_INSIDE);
    const double tall[3] = {0.3, 0.3, 3}, at_rim[3] = {80, 70, 0.5};
    assert_true(trim_judge(&t, at_rim, tall, flat, 1.0) == TRIM_INSIDE); /* heights are tile's */
    assert_true(trim_judge(&t, over, small, flat, 1.0) == TRIM_OUTSIDE);
    const double out[3] = {100, 100, 0};
    assert_true(trim_judge(&t, out, small, flat, 1.0) == TRIM_OUTSIDE);
    assert_true(trim_judge(&t, far, small, flat, 1.0) == TRIM_INSIDE); /* a horizon may be */
    size_t apart = 0; /* what is far is inside however it is turned */
    for (uint64_t i = 0; i < 4000; i++) {
        const double x[3] = {240.0 * rng_unit(5, 1, 3 * i) - 120.0,
                             240.0 * rng_unit(5, 1, 3 * i + 1) - 120.0,
                             4.0 * rng_unit(5, 1, 3 * i + 2) - 2.0},
                     sigma[3] = {8.0 * rng_unit(5, 2, 3 * i), 8.0 * rng_unit(5, 2, 3 * i + 1),
                                 8.0 * rng_unit(5, 2, 3 * i + 2)},
                     quat[4] = {1.0, rng_normal(5, 3, 3 * i), rng_normal(5, 3, 3 * i + 1),
                                rng_normal(5, 3, 3 * i + 2)};
        double rot[9];
        if (!trim_is_far(&t, x, fmax(fmax(sigma[0], sigma[1]), sigma[2])))
            continue;
        camera_quat_to_rot(quat, rot);
        assert_true(trim_judge(&t, x, sigma, rot, 1.0) == TRIM_INSIDE);
        apart++;
    }
    assert_true(apart > 100 && apart < 3900);
    trim_free(&t);
    footprint_free(&f);
    arena_free(&s.arena);
}

/* Without a footprint nothing is known and nothing changes. */
static void test_nothing_known(void **state)
{
    struct scene s = {0};
    struct footprint f = {0};
    struct trim t;
    struct gauss g = {0};
    struct err e = {0};
    size_t gone = 7;
    kit_ok(trim_open(&s, &f, 3, 3.0, &t, &e), e);
    carpet(&g);
    kit_ok(trim_rows(&t, &g, &gone, &e), e);
    assert_true(g.n == GRID * GRID && gone == 0);
    trim_free(&t);
    gauss_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_edge),
        cmocka_unit_test(test_places),
        cmocka_unit_test(test_nothing_known),
    };
    return cmocka_run_group_tests_name("trim", tests, NULL, NULL);
}
