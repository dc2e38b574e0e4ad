/* A coarser level from the model of the finer one: how many are left where, and what they cover.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/gauss.h"
#include "scene/cells/cell.h"
#include "tests/kit.h"
#include "train/model/coarsen.h"
#include "train/model/model.h"

#include <math.h>
#include <string.h>

/* A square of Gaussians of one size a metre apart, whose west is red and whose east is blue. The
 * cell is the west half. */
enum { SIDE = 300, N = SIDE * SIDE, EMBED = 2 };
static const struct cell west = {.id = "x0y0",
                                 .min_enu_m = {100.0 - 0.5, 200.0 - 0.5},
                                 .max_enu_m = {100.0 + SIDE / 2 - 0.5, 200.0 + SIDE - 0.5},
                                 .edge_m = SIDE};
static const double origin_m[3] = {100.0, 200.0, 0.0};
static struct dev dev;

static void square(struct gauss *g)
{
    struct err e = {0};
    kit_ok(gauss_alloc(g, N, 0, EMBED, &e), e);
    memcpy(g->origin_enu_m, origin_m, sizeof origin_m);
    for (size_t i = 0; i < N;
         i++) { /* along a Morton curve as models are, or nearly: squares of 4 */
        const size_t block = i / 16, x = block % (SIDE / 4) * 4 + i % 4,
                     y = block / (SIDE / 4) * 4 + i % 16 / 4;
        const bool red = x < SIDE / 2;
        g->mean_m[3 * i] = (float)x;
        g->mean_m[3 * i + 1] = (float)y;
        for (size_t k = 0; k < 3; k++) {
            g->scale_log[3 * i + k] = logf(0.5f);
            g->sh[3 * i + k] = red == (k == 0) ? 1.0f : -1.0f;
        }
        g->quat_wxyz[4 * i] = 1.0f;
        g->opacity_logit[i] = -1.0f;
        g->embed[EMBED * i] = 3.0f;
        g->embed[EMBED * i + 1] = red ? 1.0f : -1.0f;
    }
    g->n = N;
}

static void coarsen_square(const struct coarsen_rule *r, struct gauss *out)
{
    struct err e = {0};
    struct gauss g = {0};
    struct render *render = NULL;
    struct model m = {0};
    square(&g);
    kit_ok(render_open(&dev, &render, &e), e);
    kit_ok(model_open(&m, &dev, render, &g, N, &e), e);
    kit_ok(model_fill(&m, &g, &e), e);
    kit_ok(coarsen_model(&m, r, &e), e);
    kit_ok(model_gauss(&m, out, &e), e);
    model_close(&m);
    render_close(&render);
    gauss_free(&g);
}

struct counts {
    size_t inside, outside;
};
static struct counts count(const struct gauss *g)
{
    struct counts c = {0};
    for (size_t i = 0; i < g->n; i++)
        *(cell_distance(&west, g->origin_enu_m[0] + (double)g->mean_m[3 * i],
                        g->origin_enu_m[1] + (double)g->mean_m[3 * i + 1]) <= 0.0
              ? &c.inside
              : &c.outside) += 1;
    return c;
}

static void rules_say_how_many_are_left(void **state)
{
    (void)state;
    const struct coarsen_rule r = {.cell = &west, .budget = 100, .share = 0.5, .around = 30};
    assert_int_equal(coarsen_inside(&r, 180), 90);
    assert_int_equal(coarsen_inside(&r, 1000), 100); /* the budget */
    assert_int_equal(coarsen_inside(&r, 1), 1);
    assert_int_equal(coarsen_inside(&r, 0), 0);
    assert_int_equal(coarsen_outside(&r, 20), 20); /* all are of the coarse model */
    assert_int_equal(coarsen_outside(&r, 130), 80);
    const struct coarsen_rule same = {.cell = &west, .budget = 1000, .share = 1.0};
    assert_int_equal(coarsen_inside(&same, 700), 700);
    assert_int_equal(coarsen_outside(&same, 700), 700);
}

/* In several parts, down to the last Gaussian; none crosses the border, and colours do not mix over
 * it. */
static void both_sides_are_merged_apart_and_to_their_numbers(void **state)
{
    (void)state;
    const struct coarsen_rule r = {.cell = &west, .budget = N / 8, .share = 0.5, .around = N / 4};
    struct gauss g = {0};
    assert_true(N > 2 * COARSEN_ROWS);
    coarsen_square(&r, &g);
    const struct counts c = count(&g);
    assert_true(c.inside <= N / 8 && c.inside >= N / 8 - 2);
    assert_true(c.outside <= 3 * N / 8 && c.outside >= 3 * N / 8 - 2);
    double area[2] = {0.0, 0.0};
    for (size_t i = 0; i < g.n; i++) {
        const bool red = (double)g.mean_m[3 * i] < SIDE / 2 - 0.5;
        const double o = 1.0 / (1.0 + exp(-(double)g.opacity_logit[i])),
                     s = (double)g.scale_log[3 * i];
        assert_true(fabsf(g.sh[3 * i] - (red ? 1.0f : -1.0f)) < 1e-5f);
        assert_true(fabsf(g.embed[EMBED * i + 1] - (red ? 1.0f : -1.0f)) < 1e-5f);
        assert_true(fabsf(g.embed[EMBED * i] - 3.0f) < 1e-4f);
        area[!red] += o * exp(s + (double)g.scale_log[3 * i + 1]);
    }
    /* they cover about as much as before: what is left is larger */
    const double before = 0.25 / (1.0 + exp(1.0)) * N / 2;
    for (int k = 0; k < 2; k++)
        assert_true(area[k] > 0.7 * before && area[k] < 1.5 * before);
    gauss_free(&g);
}

static void nothing_is_merged_within_the_budget(void **state)
{
    (void)state;
    const struct coarsen_rule r = {.cell = &west, .budget = N, .share = 1.0};
    struct gauss g = {0}, was = {0};
    square(&was);
    coarsen_square(&r, &g);
    assert_int_equal(g.n, N);
    const struct counts c = count(&g);
    assert_true(c.inside == N / 2 && c.outside == N / 2);
    gauss_free(&g);
    gauss_free(&was);
}

static int open_device(void **state)
{
    (void)state;
    struct err e = {0};
    kit_ok(dev_open(NULL, &dev, &e), e);
    return 0;
}

static int close_device(void **state)
{
    (void)state;
    dev_close(&dev);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rules_say_how_many_are_left),
        cmocka_unit_test(both_sides_are_merged_apart_and_to_their_numbers),
        cmocka_unit_test(nothing_is_merged_within_the_budget),
    };
    return cmocka_run_group_tests_name("coarsen", tests, open_device, close_device);
}
