/* Density control: limits, quotas, the draw, clones, and the halves of a split.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/layout.h"
#include "core/math/sample.h"
#include "core/splat/camera.h"
#include "render/permute.h"
#include "scene/cells/cell.h"
#include "scene/cells/footprint.h"
#include "tests/kit.h"
#include "train/density/importance.h"
#include "train/model/densify_plan.h"
#include "train/model/init.h"

#include <math.h>
#include <string.h>

enum { PLANES = 18 /* degree 0, embeddings of 4 */, LANES = LAYOUT_LANES };
#define LOGIT_HALF 0.0f
#define SHRINK 0.51082562f      /* -ln 0.6, of the longest axis */
#define LOGIT_SPLIT -0.3364722f /* of opacity 0.5 / 1.2 */
#define FLOAT_TOL 1e-6f         /* one rounding of values of order 1 */
/* Chance that a fair draw deviates more than this many standard deviations: 6e-5. */
#define SIGMAS 4.0

struct toy {
    size_t n;
    float *params, *grad, *score, *moments;
};

static float *at(float *p, size_t i, uint32_t plane)
{
    return p + (i / LANES * PLANES + plane) * LANES + i % LANES;
}

/* n Gaussians in a square of half-edge 10 m, sigma 0.1 m (every third 5 m), opacity 0.5,
 * gradient 1. */
static struct toy toy_make(size_t n)
{
    size_t floats = layout_floats(n, PLANES);
    struct toy t = {n, mem_array(floats, 4), mem_array(n, 4), mem_array(n, 4),
                    mem_array(floats, 4)};
    for (size_t i = 0; i < n; i++) {
        for (uint32_t k = 0; k < 3; k++) {
            *at(t.params, i, k) = (float)(20.0 * rng_unit(1, 2, 3 * i + k) - 10.0);
            *at(t.params, i, 3 + k) = logf(i % 3 == 2 ? 5.0f : 0.1f);
        }
        *at(t.params, i, 6) = 1.0f;
        *at(t.params, i, 10) = LOGIT_HALF;
        for (uint32_t k = 11; k < PLANES; k++)
            *at(t.params, i, k) = (float)i;
        t.grad[i] = 1.0f;
        t.score[i] = (float)rng_unit(1, 3, i) + 0.01f;
        for (uint32_t k = 0; k < PLANES; k++)
            *at(t.moments, i, k) = 1.0f + (float)i;
    }
    return t;
}

static void toy_free(struct toy *t)
{
    mem_free(t->params);
    mem_free(t->grad);
    mem_free(t->score);
    mem_free(t->moments);
}

static const struct cell everything = {
    .id = "all", .whole = true, .edge_m = 20.0, .extent_m = 20.0, .scene_extent_m = 20.0};
static const struct cell western = {/* x < 0 is inside */
                                    .id = "west",
                                    .min_enu_m = {-100.0, -100.0},
                                    .max_enu_m = {0.0, 100.0},
                                    .edge_m = 5.0,
                                    .extent_m = 20.0,
                                    .scene_extent_m = 20.0};

static struct densify_params params_of(const struct cell *cell, size_t inside, size_t outside)
{
    return (struct densify_params){.cell = cell,
                                   .cap_inside = inside,
                                   .cap_outside = outside,
                                   .tau = 0.5,
                                   .tau_outside = 4.0,
                                   .split_above_m = 1.0,
                                   .prune_opacity = 0.005,
                                   .seed = 7,
                                   .level = 1,
                                   .step = 100};
}

static struct densify_input input_of(const struct toy *t, bool with_score)
{
    return (struct densify_input){.params = t->params,
                                  .n = t->n,
                                  .planes = PLANES,
                                  .mean_grad = t->grad,
                                  .score = with_score ? t->score : NULL};
}

static void with_room_every_candidate_is_taken(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(99);
    struct densify_params p = params_of(&everything, 1000, 0);
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_false(plan.report.needs_importance);
    assert_int_equal(plan.report.clone_candidates, 66);
    assert_int_equal(plan.report.split_candidates, 33);
    assert_int_equal(plan.report.cloned, 66);
    assert_int_equal(plan.report.split, 33);
    assert_int_equal(plan.n, 198);
    densify_plan_free(&plan);
    for (size_t i = 0; i < t.n; i++)
        t.grad[i] =
            i % 2 ? 0.4f : NAN; /* below the threshold, or no number at all: neither grows */
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, 99);
    assert_int_equal(plan.report.room, 0);
    densify_plan_free(&plan);
    toy_free(&t);
}

static void a_binding_budget_asks_for_scores_and_is_met_exactly(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(300);
    for (size_t cap = 300; cap <= 600; cap += 25) {
        struct densify_params p = params_of(&everything, cap, 0);
        struct densify_input in = input_of(&t, false);
        struct densify_plan plan;
        kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
        assert_int_equal(plan.report.needs_importance, cap > 300 && cap < 600);
        struct densify_plan asked = plan;
        in.score = t.score;
        kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
        if (asked.report.needs_importance) { /* with the score it becomes the same plan */
            assert_null(asked.rows);
            kit_ok(densify_plan_score(&p, &in, &asked, &e), e);
            assert_int_equal(asked.n, plan.n);
            assert_memory_equal(asked.rows, plan.rows, plan.n * sizeof *plan.rows);
        }
        densify_plan_free(&asked);
        size_t room = cap - 300;
        assert_int_equal(plan.report.room, room);
        assert_int_equal(plan.report.cloned,
                         room * 200 / 300); /* rounded down; splits take the rest */
        assert_int_equal(plan.report.split, room - plan.report.cloned);
        assert_int_equal(plan.n, cap);
        densify_plan_free(&plan);
    }
    toy_free(&t);
}

static void more_than_the_budget_neither_grows_nor_is_cut(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(100);
    struct densify_params p = params_of(&everything, 60, 0);
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_false(plan.report.needs_importance);
    assert_int_equal(plan.n, 100);
    densify_plan_free(&plan);
    toy_free(&t);
}

static void transparent_huge_tiny_and_broken_ones_are_removed(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(10);
    for (size_t i = 0; i < t.n; i++)
        t.grad[i] = 0.0f;
    *at(t.params, 1, 10) = -6.0f; /* opacity 0.0025 */
    *at(t.params, 3, 10) = NAN;
    for (uint32_t k = 3; k < 6; k++)
        *at(t.params, 4, k) = logf(1e-5f);
    *at(t.params, 6, 4) = logf(50.0f);
    struct densify_params p = params_of(&everything, 100, 0);
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    p.prune_above_m = 20.0;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    static const uint32_t kept[] = {0, 2, 5, 7, 8, 9};
    assert_int_equal(plan.report.pruned, 4);
    assert_int_equal(plan.n, 6);
    for (size_t i = 0; i < plan.n; i++)
        assert_int_equal(plan.rows[i].source, kept[i]);
    densify_plan_free(&plan);
    p.prune_above_m = 0.0; /* no limit of size */
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.report.pruned, 3);
    densify_plan_free(&plan);
    toy_free(&t);
}

/* Photographs support the ground west of 0, and heights up to 30 m say nothing. */
static void long_ones_over_supported_ground_are_halved(void **state)
{
    struct err e = {0};
    enum { SIDE_CELLS = 2 };
    uint8_t inside[SIDE_CELLS * SIDE_CELLS] = {1, 0, 1, 0};
    float low[4] = {-30, -30, -30, -30}, high[4] = {30, 30, 30, 30};
    const struct footprint ground = {.corner_m = {-10.0, -10.0},
                                     .cell_m = 10.0,
                                     .nx = SIDE_CELLS,
                                     .ny = SIDE_CELLS,
                                     .inside = inside,
                                     .low_m = low,
                                     .high_m = high};
    struct toy t = toy_make(99);
    memset(t.grad, 0, t.n * sizeof *t.grad);
    struct densify_params p = params_of(&everything, 1000, 0);
    p.ground = &ground;
    p.free_space_m = HUGE_VAL;
    p.size_limit_m = 2.0;
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    size_t west = 0;
    for (size_t i = 2; i < t.n; i += 3) /* those of 5 m */
        west += *at(t.params, i, 0) < 0.0f;
    assert_true(west > 5 && west < 28);
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.report.cut, west);
    assert_int_equal(plan.report.split, west);
    assert_int_equal(plan.n, t.n + west);
    for (size_t k = 0; k < plan.n; k++)
        if (plan.rows[k].kind != DENSIFY_KEEP)
            assert_true(plan.rows[k].source % 3 == 2 &&
                        *at(t.params, plan.rows[k].source, 0) < 0.0f);
    densify_plan_free(&plan);
    p.size_limit_m = 0.0; /* no limit */
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, t.n);
    densify_plan_free(&plan);
    toy_free(&t);
}

/* Where there is room for a few of them only, those with the largest gradients are halved,
 * wherever they stand. */
static void the_most_wanted_are_cut_first(void **state)
{
    struct err e = {0};
    enum { N = 40, ROOM = 20, CUTS = ROOM / 4 };
    uint8_t inside[1] = {1};
    float low[1] = {-100}, high[1] = {100};
    const struct footprint ground = {.corner_m = {-1000.0, -1000.0},
                                     .cell_m = 2000.0,
                                     .nx = 1,
                                     .ny = 1,
                                     .inside = inside,
                                     .low_m = low,
                                     .high_m = high};
    struct toy t = toy_make(N);
    struct densify_params p = params_of(&everything, N + ROOM, 0);
    p.ground = &ground;
    p.free_space_m = HUGE_VAL;
    p.size_limit_m = 2.0;
    for (size_t i = 0; i < N; i++) {
        t.grad[i] =
            i + CUTS < N ? 1e-9f * (float)i : 0.0f; /* more and more, the last of them not */
        for (uint32_t k = 3; k < 6; k++)
            *at(t.params, i, k) = logf(2.5f);
    }
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.report.cut, CUTS);
    assert_int_equal(plan.n, N + CUTS);
    for (size_t k = 0; k < plan.n; k++) {
        size_t i = plan.rows[k].source;
        assert_true((plan.rows[k].kind != DENSIFY_KEEP) == (i >= N - 2 * CUTS && i < N - CUTS));
    }
    densify_plan_free(&plan);
    toy_free(&t);
}

struct arrays {
    float *params, *moments;
};

/* The rows of a plan; the caller frees the arrays. */
static struct arrays apply(const struct densify_params *p, const struct toy *t,
                           const struct densify_plan *plan)
{
    struct err e = {0};
    struct densify_input in = input_of(t, false);
    struct densify_order order;
    size_t floats = layout_floats(plan->n, PLANES);
    struct arrays to = {mem_array(floats, 4), mem_array(floats, 4)};
    assert_true(to.params && to.moments);
    kit_ok(densify_order(p, &in, plan, &order, &e), e);
    kit_ok(permute_move(&order.rows, false, t->params, to.params, &e), e);
    kit_ok(permute_move(&order.rows, true, t->moments, to.moments, &e), e);
    densify_halve(&order, to.params);
    densify_order_free(&order);
    return to;
}

static void arrays_free(struct arrays *a)
{
    mem_free(a->params);
    mem_free(a->moments);
}

/* Where the order is kept, row d of the plan is row d, and halves are those of the plan. */
static void a_kept_order_is_that_of_the_plan(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(500);
    struct densify_params p = params_of(&everything, 700, 0);
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    struct densify_order order;
    size_t halves = 0, fresh = 0;
    for (size_t i = 0; i < t.n; i++)
        t.grad[i] = i % 3 ? 0.0f : 100.0f;
    for (size_t i = 0; i < t.n; i += 6) /* every other candidate is large */
        for (uint32_t k = 3; k < 6; k++)
            *at(t.params, i, k) = logf(2.0f * (float)p.split_above_m);
    p.keep_order = true;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    kit_ok(densify_order(&p, &in, &plan, &order, &e), e);
    assert_int_equal(order.rows.n, plan.n);
    for (size_t d = 0; d < plan.n; d++) {
        const bool keeps = plan.rows[d].kind == DENSIFY_KEEP,
                   half =
                       plan.rows[d].kind == DENSIFY_SPLIT_A || plan.rows[d].kind == DENSIFY_SPLIT_B;
        assert_int_equal(order.rows.source[d], plan.rows[d].source | (keeps ? 0 : PERMUTE_NEW));
        assert_true(!d || plan.rows[d - 1].source <= plan.rows[d].source);
        if (half)
            assert_int_equal(order.split[halves++], d);
        fresh += !keeps;
    }
    assert_int_equal(halves, order.n_split);
    assert_true(halves > 0 && fresh > 100);
    densify_order_free(&order);
    densify_plan_free(&plan);
    toy_free(&t);
}

/* Count the rows of a plan by side, children of splits at their own places. */
static void count_sides(const struct densify_params *p, const struct toy *t,
                        struct densify_plan *plan, size_t *inside, size_t *outside)
{
    struct arrays to = apply(p, t, plan);
    *inside = *outside = 0;
    for (size_t i = 0; i < plan->n; i++) {
        bool in_cell = cell_distance(p->cell, (double)*at(to.params, i, 0),
                                     (double)*at(to.params, i, 1)) <= 0.0;
        *inside += in_cell;
        *outside += !in_cell;
    }
    arrays_free(&to);
}

static void both_ceilings_hold_where_children_cross_the_border(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(600);
    size_t in0 = 0;
    for (size_t i = 0; i < t.n; i++) {
        t.grad[i] = 100.0f; /* over four times the threshold: candidates on both sides */
        in0 += *at(t.params, i, 0) <= 0.0f;
    }
    size_t out0 = t.n - in0;
    for (size_t extra = 0; extra <= 320; extra += 40)
        for (size_t outside = out0; outside <= out0 + 150; outside += 50) {
            struct densify_params p = params_of(&western, in0 + extra, outside);
            struct densify_input in = input_of(&t, true);
            struct densify_plan plan;
            size_t n_in, n_out;
            kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
            count_sides(&p, &t, &plan, &n_in, &n_out);
            assert_int_equal(n_in, plan.report.inside);
            assert_int_equal(n_out, plan.report.outside);
            assert_true(n_in <= in0 + extra);
            assert_true(n_out <= outside);
            densify_plan_free(&plan);
        }
    toy_free(&t);
}

/* Candidates outside have a room of their own: however many and however important they are, those
 * inside get all that the cell's ceiling leaves. */
static void many_candidates_outside_take_no_room_inside(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(900);
    size_t in0 = 0;
    for (size_t i = 0; i < t.n; i++) {
        bool inside = i < 90;
        *at(t.params, i, 0) = inside ? -5.0f : 5.0f;
        for (uint32_t k = 3; k < 6; k++)
            *at(t.params, i, k) = logf(0.1f); /* all are clones */
        t.grad[i] = 100.0f;
        t.score[i] = inside ? 0.01f : 100.0f;
        in0 += inside;
    }
    struct densify_params p = params_of(&western, in0 + 60, t.n - in0 + 50);
    struct densify_input in = input_of(&t, true);
    struct densify_plan plan;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.report.inside, in0 + 60);
    assert_int_equal(plan.report.outside, t.n - in0 + 50);
    assert_int_equal(plan.report.room, 110);
    assert_int_equal(plan.report.cloned, 110);
    densify_plan_free(&plan);
    /* No room outside: the same inside. */
    p.cap_outside = 0;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.report.inside, in0 + 60);
    assert_int_equal(plan.report.outside, t.n - in0);
    densify_plan_free(&plan);
    toy_free(&t);
}

static void the_threshold_rises_outside_the_cell(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(3);
    static const float east[3] = {-1.0f, 2.5f,
                                  50.0f}; /* inside; half a cell edge; far beyond one */
    for (size_t i = 0; i < 3; i++)
        *at(t.params, i, 0) = east[i];
    struct densify_params p = params_of(&western, 100, 100);
    struct densify_input in = input_of(&t, true);
    struct {
        float grad;
        size_t candidates;
    } want[] = {{0.49f, 0}, {0.51f, 1}, {1.24f, 1}, {1.26f, 2}, {1.99f, 2}, {2.01f, 3}};
    for (size_t k = 0; k < sizeof want / sizeof want[0]; k++) {
        struct densify_plan plan;
        for (size_t i = 0; i < 3; i++)
            t.grad[i] = want[k].grad;
        kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
        assert_int_equal(plan.report.clone_candidates + plan.report.split_candidates,
                         want[k].candidates);
        densify_plan_free(&plan);
    }
    toy_free(&t);
}

static void clones_are_copies_and_halves_lie_within_their_parent(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(33);
    struct densify_params p = params_of(&everything, 1000, 0);
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    struct arrays to = apply(&p, &t, &plan);
    size_t kept = 0, fresh = 0, moved = 0;
    for (size_t i = 0; i < plan.n; i++) {
        size_t source = (size_t)*at(to.params, i, 11); /* its colour says who the parent was */
        bool split = source % 3 == 2;
        bool carries = *at(to.moments, i, 5) == 1.0f + (float)source &&
                       *at(to.moments, i, 12) == 1.0f + (float)source;
        bool zero = *at(to.moments, i, 5) == 0.0f && *at(to.moments, i, 12) == 0.0f;
        assert_true(carries || zero);
        kept += carries;
        fresh += zero;
        float shrink = split ? SHRINK : 0.0f;
        assert_true(fabsf(*at(to.params, i, 3) - (*at(t.params, source, 3) - shrink)) < FLOAT_TOL);
        assert_true(fabsf(*at(to.params, i, 10) - (split ? LOGIT_SPLIT : LOGIT_HALF)) < FLOAT_TOL);
        assert_true(*at(to.params, i, PLANES - 1) == (float)source); /* and its embedding */
        float d = fabsf(*at(to.params, i, 0) - *at(t.params, source, 0));
        moved += d > 0.0f;
        assert_true(split ? fabsf(d - 0.8f * 5.0f) < 1e-5f : d == 0.0f);
    }
    assert_int_equal(kept, 22); /* one of each clone pair; both halves of a split start anew */
    assert_int_equal(fresh, 22 + 22);
    assert_int_equal(moved, 22);
    for (size_t i = plan.n; i % LANES; i++) /* lanes after the last one are zero */
        assert_true(*at(to.params, i, 6) == 0.0f && *at(to.moments, i, 6) == 0.0f);
    arrays_free(&to);
    densify_plan_free(&plan);
    toy_free(&t);
}

/* Split along its longest axis, a Gaussian is replaced by two that have its mean, its covariance
 * and its mass together: what it contributed to pictures hardly changes. */
static void halves_along_the_axis_keep_the_moments(void **state)
{
    struct err e = {0};
    struct toy t = toy_make(3);
    struct densify_params p = params_of(&everything, 1000, 0);
    struct densify_input in = input_of(&t, false);
    struct densify_plan plan;
    static const float quat[4] = {0.5f, 0.1f, -0.7f, 0.3f};
    static const double sigma[3] = {1.5, 4.0, 2.5};
    double rot[9], axis[3], opacity = 0.0, second = 0.0, middle[3] = {0};
    const double quat_d[4] = {0.5, (double)0.1f, (double)-0.7f, (double)0.3f};
    for (uint32_t k = 0; k < 4; k++)
        *at(t.params, 2, 6 + k) = quat[k];
    for (uint32_t k = 0; k < 3; k++)
        *at(t.params, 2, 3 + k) = (float)log(sigma[k]);
    t.grad[0] = t.grad[1] = 0.0f;
    t.grad[2] = 1.0f;
    camera_quat_to_rot(quat_d, rot);
    for (uint32_t k = 0; k < 3; k++)
        axis[k] = rot[3 * k + 1];
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.n, 4);
    struct arrays to = apply(&p, &t, &plan);
    size_t halves = 0;
    for (size_t i = 0; i < plan.n; i++) {
        if (*at(to.params, i, 11) != 2.0f)
            continue;
        double along = 0.0, across = 0.0, d[3];
        for (uint32_t k = 0; k < 3; k++) {
            d[k] = (double)*at(to.params, i, k) - (double)*at(t.params, 2, k);
            middle[k] += d[k];
            along += d[k] * axis[k];
        }
        for (uint32_t k = 0; k < 3; k++)
            across = fmax(across, fabs(d[k] - along * axis[k]));
        double half = exp((double)*at(to.params, i, 4));
        assert_true(across < 1e-5);
        assert_true(fabs(along * along + half * half - 16.0) < 1e-4); /* variance of the pair */
        assert_true(*at(to.params, i, 3) == *at(t.params, 2, 3));
        assert_true(*at(to.params, i, 5) == *at(t.params, 2, 5));
        double o = 1.0 / (1.0 + exp(-(double)*at(to.params, i, 10)));
        opacity += o * half;
        second += along;
        halves++;
    }
    assert_int_equal(halves, 2);
    assert_true(fabs(second) < 1e-5 && fabs(middle[0]) + fabs(middle[1]) + fabs(middle[2]) < 1e-5);
    double before = 1.0 / (1.0 + exp(-(double)LOGIT_HALF)) * 4.0;
    assert_true(fabs(opacity - before) < 1e-5); /* opacity times length: mass */
    arrays_free(&to);
    densify_plan_free(&plan);
    toy_free(&t);
}

static void the_draw_takes_exactly_k_different_ones(void **state)
{
    struct err e = {0};
    enum { N = 1000 };
    float score[N];
    uint32_t ids[N], chosen[N];
    for (uint32_t i = 0; i < N; i++) {
        score[i] = i % 10 ? 1.0f : 0.0f;
        ids[i] = i;
    }
    for (size_t k = 0; k <= N; k += 50) {
        bool seen[N] = {false};
        kit_ok(sample_race(score, ids, N, k, 3, 9, chosen, &e), e);
        for (size_t j = 0; j < k; j++) {
            assert_false(seen[chosen[j]]);
            seen[chosen[j]] = true;
            if (k <= 900) /* those without a score come last */
                assert_int_not_equal(chosen[j] % 10, 0);
        }
    }
    kit_fails(sample_race(score, ids, N, N + 1, 3, 9, chosen, &e), ERR_ARG, e, "cannot be drawn");
    score[5] = NAN;
    score[6] = INFINITY;
    kit_ok(sample_race(score, ids, N, 100, 3, 9, chosen, &e), e);
    assert_int_equal(chosen[0], 6);
}

static void the_draw_is_proportional_to_the_score(void **state)
{
    struct err e = {0};
    enum { TRIALS = 4000 };
    static const float score[4] = {1.0f, 2.0f, 3.0f, 4.0f};
    static const uint32_t ids[4] = {0, 1, 2, 3};
    double first[4] = {0};
    for (uint64_t s = 0; s < TRIALS; s++) {
        uint32_t chosen[1];
        kit_ok(sample_race(score, ids, 4, 1, s, 1, chosen, &e), e);
        first[chosen[0]] += 1.0;
    }
    for (int i = 0; i < 4; i++) {
        double p = (double)score[i] / 10.0, sigma = sqrt(p * (1.0 - p) / TRIALS);
        assert_true(fabs(first[i] / TRIALS - p) < SIGMAS * sigma);
    }
}

/* F32: beyond the 2^24 that sampling by a float's cumulative sum can count. */
static void the_draw_has_no_limit_at_two_to_the_24(void **state)
{
    struct err e = {0};
    const size_t n = 20 * 1000 * 1000, k = 12345;
    uint32_t *ids = mem_array(n, sizeof *ids), *chosen = mem_array(k, sizeof *chosen);
    float *score = mem_array(n, sizeof *score);
    assert_true(ids && chosen && score);
    for (size_t i = 0; i < n; i++) {
        ids[i] = (uint32_t)i;
        score[i] = 1.0f + (float)(i % 7);
    }
    memset(chosen, 0xff, k * sizeof *chosen);
    kit_ok(sample_race(score, ids, n, k, 1, 1, chosen, &e), e);
    size_t beyond = 0, different = 0;
    for (size_t j = 0; j < k; j++) {
        assert_true(chosen[j] < n);
        different += score[chosen[j]] > 0.0f;
        score[chosen[j]] = 0.0f; /* seen */
        beyond += chosen[j] >= (1u << 24);
    }
    kit_figure("F32", "scores=%zu quota=%zu selected=%zu beyond_2_24=%zu", n, k, different, beyond);
    assert_int_equal(different, k);
    double p = 1.0 - (double)(1u << 24) / (double)n, sigma = sqrt(p * (1.0 - p) / (double)k);
    assert_true(fabs((double)beyond / (double)k - p) < SIGMAS * sigma);
    mem_free(score);
    mem_free(ids);
    mem_free(chosen);
}

/* Of 5 x 3 pixels the last column and the last row are left out. */
static void a_photograph_of_half_the_edges_has_the_means_of_four(void **state)
{
    enum { W = 5, H = 3 };
    uint8_t px[3 * W * H], mask[W * H], half[3 * 2], half_mask[2];
    for (uint64_t i = 0; i < sizeof px; i++)
        px[i] = (uint8_t)(256.0 * rng_unit(6, 1, i));
    memset(mask, 255, sizeof mask);
    mask[W + 3] = 0; /* one of the second four */
    importance_halve(px, 3, W, H, half);
    importance_halve_mask(mask, W, H, half_mask);
    for (size_t x = 0; x < 2; x++)
        for (size_t c = 0; c < 3; c++) {
            double sum = 0.0;
            for (size_t k = 0; k < 4; k++)
                sum += px[3 * (W * (k / 2) + 2 * x + k % 2) + c];
            assert_int_equal(half[3 * x + c], (int)floor(0.25 * sum + 0.5));
        }
    assert_true(half_mask[0] && !half_mask[1]);
}

/* Mean squared distance of each point to its three nearest others. */
static void look_at_all_pairs(const float *xyz, size_t n, double *out)
{
    for (size_t i = 0; i < n; i++) {
        double best[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL};
        for (size_t j = 0; j < n; j++) {
            double d = 0.0;
            for (int k = 0; k < 3; k++)
                d += pow((double)xyz[3 * i + k] - (double)xyz[3 * j + k], 2.0);
            for (int k = 0; k < 3 && i != j; k++)
                if (d < best[k]) {
                    double old = best[k];
                    best[k] = d;
                    d = old;
                }
        }
        out[i] = (best[0] + best[1] + best[2]) / 3.0;
    }
}

/* Points so even that no size is limited. */
static void sizes_agree_with_looking_at_all_pairs(void **state)
{
    struct err e = {0};
    enum { N = 700 };
    float xyz[3 * N], got[N];
    double want[N];
    for (size_t i = 0; i < 3 * N; i++)
        xyz[i] = (float)(rng_unit(4, 4, i) * 100.0);
    for (size_t i = 0; i < 30; i++) /* duplicates */
        xyz[i] = xyz[30 + i];
    look_at_all_pairs(xyz, N, want);
    kit_ok(init_size2(xyz, N, got, &e), e);
    kit_near("mean squared distance", got, want, N, 1e-6, 1e-5); /* float against double sums */
    for (size_t n = 0; n < 4; n++) { /* too few to have three neighbours */
        kit_ok(init_size2(xyz, n, got, &e), e);
        for (size_t i = 0; i < n; i++)
            assert_true(isfinite(got[i]));
    }
}

/* A grid of 1 m and one point 40 m under it: the grid keeps its sizes, the lone point gets no
 * Gaussian of 40 m. */
static void a_lone_point_does_not_become_a_huge_gaussian(void **state)
{
    enum { SIDE = 20, N = SIDE * SIDE + 1 };
    float xyz[3 * N], got[N];
    double plain[N];
    struct err e = {0};
    for (int i = 0; i < SIDE * SIDE; i++) {
        xyz[3 * i] = (float)(i % SIDE);
        xyz[3 * i + 1] = (float)(i / SIDE);
        xyz[3 * i + 2] = 0.0f;
    }
    memcpy(xyz + 3 * (N - 1), (float[]){9.5f, 9.5f, -40.0f}, 3 * sizeof(float));
    look_at_all_pairs(xyz, N, plain);
    kit_ok(init_size2(xyz, N, got, &e), e);
    kit_near("the grid", got, plain, N - 1, 1e-6, 1e-5);
    assert_true(plain[N - 1] > 1600.0);
    assert_true(got[N - 1] > 0.99f && got[N - 1] < 9.01f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(with_room_every_candidate_is_taken),
        cmocka_unit_test(a_binding_budget_asks_for_scores_and_is_met_exactly),
        cmocka_unit_test(more_than_the_budget_neither_grows_nor_is_cut),
        cmocka_unit_test(transparent_huge_tiny_and_broken_ones_are_removed),
        cmocka_unit_test(long_ones_over_supported_ground_are_halved),
        cmocka_unit_test(the_most_wanted_are_cut_first),
        cmocka_unit_test(both_ceilings_hold_where_children_cross_the_border),
        cmocka_unit_test(many_candidates_outside_take_no_room_inside),
        cmocka_unit_test(the_threshold_rises_outside_the_cell),
        cmocka_unit_test(halves_along_the_axis_keep_the_moments),
        cmocka_unit_test(clones_are_copies_and_halves_lie_within_their_parent),
        cmocka_unit_test(the_draw_takes_exactly_k_different_ones),
        cmocka_unit_test(the_draw_is_proportional_to_the_score),
        cmocka_unit_test(the_draw_has_no_limit_at_two_to_the_24),
        cmocka_unit_test(a_kept_order_is_that_of_the_plan),
        cmocka_unit_test(a_photograph_of_half_the_edges_has_the_means_of_four),
        cmocka_unit_test(sizes_agree_with_looking_at_all_pairs),
        cmocka_unit_test(a_lone_point_does_not_become_a_huge_gaussian),
    };
    return cmocka_run_group_tests_name("densify", tests, NULL, NULL);
}
