/* 3DGS-MCMC: the pull against finite differences, its kernels and those of the noise against their
 * references in both shapes, the distribution of the noise, how Gaussians share a place, and the
 * rows that a densification makes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cells/cell.h"
#include "core/camera.h"
#include "loss/mcmc.h"
#include "tests/backward_kit.h"
#include "train/densify_plan.h"
#include "train/relocate.h"

#include <math.h>
#include <string.h>

enum { N = 203 /* not a multiple of 16 */, PLANES = 14 };
#define FD_STEP 1e-5
#define FD_REL 1e-6
#define KERNEL_REL 1e-5 /* float against double: exp of arguments up to 10, cos of turns up to 6 */
#define SIGMAS 4.5      /* of a fair draw: 7e-6 to be farther out */

/* ---- the pull ---- */

static const struct mcmc_pull pull = {.opacity_weight = 0.3, .size_weight = 0.7, .unit_m = 5.0};

struct four { /* sizes and logits as floats can hold */
    double scale_log[3 * N], logit[N], grad[4 * N];
};

static void four_make(struct four *f, const struct gauss *g)
{
    for (size_t i = 0; i < 3 * N; i++)
        f->scale_log[i] = (double)g->scale_log[i];
    for (size_t i = 0; i < N; i++)
        f->logit[i] = (double)g->opacity_logit[i];
    memset(f->grad, 0, sizeof f->grad);
}

static void pull_matches_differences(void **state)
{
    (void)state;
    struct gauss g = {0};
    struct four f;
    double fd[4 * N];
    kit_gauss(4, N, 10.0, 1, 0, &g);
    four_make(&f, &g);
    double value = mcmc_ref_pull(f.scale_log, f.logit, N, &pull, f.grad), plain = 0.0;
    for (size_t i = 0; i < N; i++) {
        plain += 0.3 / (1.0 + exp(-f.logit[i])) / N;
        for (size_t k = 0; k < 3; k++)
            plain += 0.7 * exp(f.scale_log[3 * i + k]) / 5.0 / (3 * N);
    }
    assert_true(fabs(value - plain) < 1e-12 * plain);
    for (size_t i = 0; i < 4 * N; i++) {
        double *x = i % 4 < 3 ? &f.scale_log[i / 4 * 3 + i % 4] : &f.logit[i / 4], keep = *x, at[2];
        for (int k = 0; k < 2; k++) {
            *x = keep + (k ? FD_STEP : -FD_STEP);
            at[k] = mcmc_ref_pull(f.scale_log, f.logit, N, &pull, NULL);
        }
        *x = keep;
        fd[i] = (at[1] - at[0]) / (2.0 * FD_STEP);
    }
    kit_near_d("dL/d(sizes, opacity)", f.grad, fd, 4 * N, 1e-10, FD_REL);
    gauss_free(&g);
}

/* ---- kernels ---- */

struct device_case {
    struct gauss g;
    struct render *r;
    struct render_model m;
    struct mcmc *c;
    size_t floats;
};

static void device_open(struct device_case *d, uint32_t width)
{
    struct err e = {0};
    uint32_t own = dev_get()->vector_width;
    *d = (struct device_case){0};
    kit_gauss(4, N, 10.0, 1, 0, &d->g);
    for (size_t i = 0; i < N; i += 3) /* nearly dead ones, which noise is for */
        d->g.opacity_logit[i] = -4.0f - (float)(i % 4);
    kit_ok(render_open(dev_get(), &d->r, &e), e);
    kit_ok(render_model_upload(d->r, &d->g, &d->m, &e), e);
    d->floats = (size_t)d->m.groups * d->m.planes * 16;
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = mcmc_open(dev_get(), &d->c, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
}

static void device_close(struct device_case *d)
{
    mcmc_close(&d->c);
    render_model_free(&d->m);
    render_close(&d->r);
    gauss_free(&d->g);
}

static void check_pull(uint32_t width)
{
    struct device_case d;
    struct four f;
    struct err e = {0};
    cl_mem extra = NULL;
    device_open(&d, width);
    four_make(&f, &d.g);
    (void)mcmc_ref_pull(f.scale_log, f.logit, N, &pull, f.grad);
    size_t floats = (size_t)d.m.groups * 11 * 16;
    float *ones = mem_array(floats, sizeof *ones);
    assert_non_null(ones);
    for (size_t i = 0; i < floats; i++)
        ones[i] = 1e-4f;
    kit_ok(dev_buffer(dev_get(), floats * sizeof *ones, ones, &extra, &e), e);
    kit_ok(mcmc_pull_run(d.c, &d.m, &pull, extra, &e), e);
    float *got = floats_read(extra, floats);
    for (size_t i = 0; i < floats / 11; i++)
        for (size_t p = 0; p < 11; p++) {
            double is = (double)got[(i / 16 * 11 + p) * 16 + i % 16], should = 1e-4;
            if (i < N && ((p >= 3 && p < 6) || p == 10))
                should += f.grad[4 * i + (p == 10 ? 3 : p - 3)];
            if (!(fabs(is - should) <= KERNEL_REL * should))
                fail_msg("width %u, Gaussian %zu, plane %zu: %g, want %g", width, i, p, is, should);
        }
    mem_free(got);
    mem_free(ones);
    dev_release(&extra);
    device_close(&d);
}

static const struct mcmc_noise noise = {.rate_per_m = 0.4, .seed = 7, .stream = 11};

static void check_noise(uint32_t width)
{
    struct device_case d;
    struct err e = {0};
    size_t moved = 0;
    device_open(&d, width);
    float *before = floats_read(d.m.params, d.floats);
    kit_ok(mcmc_noise_run(d.c, &d.m, &noise, &e), e);
    float *after = floats_read(d.m.params, d.floats);
    for (size_t i = 0; i < (size_t)d.m.groups * 16; i++)
        for (size_t p = 0; p < d.m.planes; p++) {
            size_t at = (i / 16 * d.m.planes + p) * 16 + i % 16;
            double add[3] = {0.0, 0.0, 0.0}, scale_log[3], quat[4];
            for (size_t k = 0; i < N && k < 4; k++) {
                quat[k] = (double)d.g.quat_wxyz[4 * i + k];
                scale_log[k % 3] = (double)d.g.scale_log[3 * i + k % 3];
            }
            if (i < N && p < 3)
                mcmc_ref_noise(scale_log, quat, (double)d.g.opacity_logit[i], (uint32_t)i, &noise,
                               add);
            double is = (double)after[at] - (double)before[at], should = p < 3 ? add[p] : 0.0;
            double room = KERNEL_REL * (fabs(add[0]) + fabs(add[1]) + fabs(add[2])) +
                          (p < 3 && i < N ? 1e-7 * fabs((double)before[at]) : 0.0);
            moved += fabs(should) > 10.0 * room;
            if (!(fabs(is - should) <= room))
                fail_msg("width %u, Gaussian %zu, plane %zu: moved %g, want %g", width, i, p, is,
                         should);
        }
    assert_true(moved > N); /* of 3 N coordinates: the comparison is not of zeros */
    mem_free(before);
    mem_free(after);
    device_close(&d);
}

static void kernels_match_the_references(void **state)
{
    (void)state;
    for (uint32_t width = 0; width < 2; width++) {
        check_pull(width);
        check_noise(width);
    }
}

/* Mean 0 and covariance (rate g)^2 Sigma Sigma; what is opaque stays. */
static void noise_is_distributed_as_said(void **state)
{
    (void)state;
    enum { DRAWS = 20000 };
    const double scale_log[3] = {log(0.5), log(1.0), log(2.0)}, quat[4] = {0.9, -0.3, 0.2, 0.4};
    double rot[9], sigma[9], want[9], mean[3] = {0}, second[9] = {0}, add[3];
    double gate = 0.4 / (1.0 + exp(100.0 * (1.0 / (1.0 + exp(5.5)) - 0.005)));
    camera_quat_to_rot(quat, rot);
    for (int i = 0; i < 9; i++) {
        sigma[i] = 0.0;
        for (int k = 0; k < 3; k++)
            sigma[i] += rot[i / 3 * 3 + k] * exp(2.0 * scale_log[k]) * rot[i % 3 * 3 + k];
    }
    for (int i = 0; i < 9; i++) {
        want[i] = 0.0;
        for (int k = 0; k < 3; k++)
            want[i] += gate * gate * sigma[i / 3 * 3 + k] * sigma[k * 3 + i % 3];
    }
    for (uint32_t t = 0; t < DRAWS; t++) {
        mcmc_ref_noise(scale_log, quat, -5.5, t, &noise, add);
        for (int i = 0; i < 9; i++)
            second[i] += add[i / 3] * add[i % 3] / DRAWS;
        for (int i = 0; i < 3; i++)
            mean[i] += add[i] / DRAWS;
    }
    for (int i = 0; i < 3; i++)
        assert_true(fabs(mean[i]) < SIGMAS * sqrt(want[4 * i] / DRAWS));
    for (int i = 0; i < 9; i++) { /* variance of x y: s_xx s_yy + s_xy^2 */
        double both = want[4 * (i / 3)] * want[4 * (i % 3)] + want[i] * want[i];
        assert_true(fabs(second[i] - want[i]) < SIGMAS * sqrt(both / DRAWS));
    }
    mcmc_ref_noise(scale_log, quat, 0.0, 3, &noise, add);
    assert_true(fabs(add[0]) + fabs(add[1]) + fabs(add[2]) < 1e-18);
}

/* ---- sharing a place ---- */

/* Along a line through the centre: what N of them stop, against what one did. */
static void those_that_share_stop_as_much_light(void **state)
{
    (void)state;
    static const double opacity[] = {0.02, 0.3, 0.8, 0.999};
    static const unsigned parts[] = {2, 3, 10, RELOCATE_MOST};
    for (size_t a = 0; a < 4; a++)
        for (size_t b = 0; b < 4; b++) {
            struct relocate_share s = relocate_share(opacity[a], parts[b]);
            double one = 0.0, all = 0.0, step = 1e-3;
            assert_true(fabs(1.0 - pow(1.0 - s.opacity, parts[b]) - opacity[a]) < 1e-12);
            for (double x = -12.0; x < 12.0; x += step) {
                one += step * opacity[a] * exp(-0.5 * x * x);
                double y = x / s.shrink;
                all += step * (1.0 - pow(1.0 - s.opacity * exp(-0.5 * y * y), parts[b]));
            }
            if (!(fabs(all - one) < 1e-6 * one))
                fail_msg("%u of opacity %g: %g, one %g", parts[b], opacity[a], all, one);
        }
    struct relocate_share same = relocate_share(0.7, 1);
    assert_true(fabs(same.opacity - 0.7) < 1e-15 && fabs(same.shrink - 1.0) < 1e-15);
}

static void places_are_drawn_by_weight(void **state)
{
    (void)state;
    enum { OF = 40, ROOM = 400 };
    float weight[OF];
    uint32_t ids[OF / 2];
    uint8_t copies[OF] = {0}, again[OF] = {0};
    struct err e = {0};
    size_t placed, n = 0, sum = 0;
    double all = 0.0;
    for (uint32_t i = 0; i < OF; i++)
        weight[i] = 0.1f + 0.02f * (float)i;
    for (uint32_t i = 0; i < OF; i += 2)
        ids[n++] = i, all += (double)weight[i];
    struct relocate_from from = {.weight = weight, .ids = ids, .n = n, .seed = 3, .stream = 4};
    kit_ok(relocate_draw(&from, ROOM, copies, &placed, &e), e);
    assert_int_equal(placed, ROOM);
    for (uint32_t i = 0; i < OF; i++) {
        double p = i % 2 ? 0.0 : (double)weight[i] / all;
        sum += copies[i];
        assert_true(fabs((double)copies[i] - ROOM * p) <= SIGMAS * sqrt(ROOM * p * (1.0 - p)));
    }
    assert_int_equal(sum, ROOM);
    kit_ok(relocate_draw(&from, ROOM, again, &placed, &e), e);
    assert_memory_equal(copies, again, sizeof copies);
    memset(again, 0, sizeof again);
    from.n = 1;
    kit_ok(relocate_draw(&from, ROOM, again, &placed, &e), e);
    assert_int_equal(again[0], RELOCATE_MOST - 1); /* no more share a place */
    assert_int_equal(placed, RELOCATE_MOST - 1);
    memset(weight, 0, sizeof weight);
    from.n = n;
    kit_ok(relocate_draw(&from, ROOM, again, &placed, &e), e);
    assert_int_equal(placed, 0); /* nobody can be drawn */
}

/* ---- the plan ---- */

static float *plane_of(float *params, size_t i, uint32_t plane)
{
    return params + layout_at(i, PLANES) + (size_t)plane * LAYOUT_LANES;
}

/* West of 0 is inside; every fifth is dead. */
static float *toy_params(void)
{
    float *params = mem_array(layout_floats(N, PLANES), sizeof *params);
    assert_non_null(params);
    for (size_t i = 0; i < N; i++) {
        for (uint32_t k = 0; k < 3; k++) {
            *plane_of(params, i, k) = (float)(20.0 * rng_unit(1, 2, 3 * i + k) - 10.0);
            *plane_of(params, i, 3 + k) = logf(0.1f);
        }
        *plane_of(params, i, 6) = 1.0f;
        *plane_of(params, i, 10) = i % 5 == 0 ? -7.0f : 0.0f;
        *plane_of(params, i, 11) = (float)i;
    }
    return params;
}

static void the_dead_move_and_the_number_is_the_ceiling(void **state)
{
    (void)state;
    static const struct cell west = {.id = "west",
                                     .min_enu_m = {-100.0, -100.0},
                                     .max_enu_m = {0.0, 100.0},
                                     .edge_m = 5.0,
                                     .extent_m = 20.0,
                                     .scene_extent_m = 20.0};
    struct err e = {0};
    float *params = toy_params(), *grad = mem_array(N, sizeof *grad);
    size_t out_before = 0, shared = 0;
    assert_non_null(grad);
    struct densify_params p = {.cell = &west,
                               .cap_inside = 150,
                               .cap_outside = 1000,
                               .strategy = DENSIFY_STRATEGY_MCMC,
                               .tau = 0.5,
                               .tau_outside = 4.0,
                               .split_above_m = 1.0,
                               .prune_opacity = 0.005,
                               .seed = 7,
                               .level = 1,
                               .step = 100};
    struct densify_input in = {.params = params, .n = N, .planes = PLANES, .mean_grad = grad};
    struct densify_plan plan;
    struct densify_order order;
    for (size_t i = 0; i < N; i++)
        out_before += *plane_of(params, i, 0) > 0.0f;
    kit_ok(densify_plan_make(&p, &in, &plan, &e), e);
    assert_int_equal(plan.report.pruned, (N + 4) / 5);
    assert_int_equal(plan.report.inside, 150);         /* the ceiling */
    assert_int_equal(plan.report.outside, out_before); /* as many as there were */
    assert_int_equal(plan.n, plan.report.after);
    for (size_t d = 0; d < plan.n; d++) {
        assert_true(plan.rows[d].source % 5 != 0);
        shared += plan.rows[d].kind == DENSIFY_SHARE;
    }
    kit_ok(densify_order(&p, &in, &plan, &order, &e), e);
    assert_int_equal(order.n_shared, shared);
    float *to = mem_array(layout_floats(plan.n, PLANES), sizeof *to);
    assert_non_null(to);
    kit_ok(permute_move(&order.rows, false, params, to, &e), e);
    densify_halve(&order, &in, to);
    size_t of_source[N] = {0};
    for (size_t d = 0; d < plan.n; d++)
        of_source[(size_t)*plane_of(to, d, 11)]++;
    for (size_t d = 0; d < plan.n; d++) {
        size_t i = (size_t)*plane_of(to, d, 11);
        struct relocate_share s = relocate_share(0.5, (unsigned)of_source[i]);
        for (uint32_t k = 0; k < 3; k++) {
            assert_true(*plane_of(to, d, k) == *plane_of(params, i, k));
            assert_true(fabs((double)*plane_of(to, d, 3 + k) - log(0.1 * s.shrink)) < 1e-6);
        }
        assert_true(fabs((double)*plane_of(to, d, 10) - log(s.opacity / (1.0 - s.opacity))) < 1e-6);
        /* the optimiser begins anew for all that share */
        assert_true(((order.rows.source[d] & PERMUTE_NEW) != 0) == (of_source[i] > 1));
    }
    mem_free(to);
    densify_order_free(&order);
    densify_plan_free(&plan);
    mem_free(params);
    mem_free(grad);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pull_matches_differences),
        cmocka_unit_test(kernels_match_the_references),
        cmocka_unit_test(noise_is_distributed_as_said),
        cmocka_unit_test(those_that_share_stop_as_much_light),
        cmocka_unit_test(places_are_drawn_by_weight),
        cmocka_unit_test(the_dead_move_and_the_number_is_the_ceiling),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
