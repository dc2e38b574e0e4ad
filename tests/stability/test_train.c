/* Failures of the training loop: F15 (units of densification), F26 and F30 (the same bytes again,
 * also when resumed anywhere), F28 (scores without anything to score).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/layout.h"
#include "tests/stability/toy.h"
#include "train/base/config.h"
#include "train/density/importance.h"
#include "train/level.h"
#include "train/state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- F15 ---- */

#define F15_LIMIT 0.20 /* change of the fraction of candidates when pictures double */
enum { F15_N = 200, F15_STEPS = 18 };

/* Mean positional gradients over one epoch with all learning rates 0: [n] of signed sums, [n] of
 * absolute ones. */
static void mean_gradients(const char *dir, const struct gauss *g, float *grad, float *absg)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy_run r;
    float count[F15_N];
    struct train_config c = toy_config(&a, NULL);
    c.level_count = 1;
    c.densify_from = 1000000;
    toy_run_open_from(&r, dir, &c, g);
    r.level.stage.levels[0].fade_from = 0;
    r.level.stage.levels[0].fade_to = 0.0;
    toy_run_steps(&r, F15_STEPS);
    kit_ok(dev_read(&toy_dev, r.level.model.stats.grad, 0, sizeof count, grad, &e), e);
    kit_ok(dev_read(&toy_dev, r.level.model.stats.absg, 0, sizeof count, absg, &e), e);
    kit_ok(dev_read(&toy_dev, r.level.model.stats.count, 0, sizeof count, count, &e), e);
    for (size_t i = 0; i < F15_N; i++) {
        assert_true(count[i] > 0.0f);
        grad[i] /= count[i];
        absg[i] /= count[i];
    }
    toy_run_close(&r);
    arena_free(&a);
}

static double fraction_above(const float *v, double tau)
{
    size_t n = 0;
    for (size_t i = 0; i < F15_N; i++)
        n += (double)v[i] > tau;
    return (double)n / F15_N;
}

static int by_value(const void *a, const void *b)
{
    const float *x = a, *y = b;
    return *x < *y ? -1 : *x > *y;
}

/* The same content in pictures twice as large: who is densified must not change with it. Pixels in
 * place of picture units would double the sums, width in place of height would skew them. */
static void candidates_do_not_depend_on_picture_size(void **state)
{
    struct toy t = toy_spec();
    struct gauss truth = {0}, g = {0};
    char dir[FILE_PATH_MAX];
    static float v[2][2][F15_N]; /* [size][signed, absolute] */
    t.n = F15_N;
    t.sigma_min_m = 0.3;
    t.sigma_max_m = 0.6;
    t.photos = 24;
    t.width_px = 96;
    t.height_px = 64;
    toy_gauss(&t, &truth);
    toy_gauss(&t, &g);
    for (size_t i = 0; i < 3 * F15_N; i++) /* half learnt: moved, so that there are gradients */
        g.mean_m[i] += (float)(0.1 * rng_normal(91, 0, i));
    for (int size = 0; size < 2; size++) {
        kit_tmpdir(dir);
        toy_write(dir, &t, &truth);
        mean_gradients(dir, &g, v[size][0], v[size][1]);
        kit_rmdir(dir);
        t.width_px *= 2;
        t.height_px *= 2;
    }
    for (int kind = 0; kind < 2; kind++) {
        double worst = 0.0, at = 0.0;
        /* thresholds that 10 % .. 90 % of the small pictures' Gaussians exceed */
        for (int tenth = 1; tenth <= 9; tenth++) {
            float sorted[F15_N];
            memcpy(sorted, v[0][kind], sizeof sorted);
            qsort(sorted, F15_N, sizeof *sorted, by_value);
            double tau = (double)sorted[F15_N * tenth / 10];
            double once = fraction_above(v[0][kind], tau), twice = fraction_above(v[1][kind], tau);
            double change = fabs(twice / once - 1.0);
            if (change > worst) {
                worst = change;
                at = once;
            }
        }
        kit_figure("F15", "statistic=%s worst_change=%.3f limit=%.2f at_fraction=%.2f",
                   kind ? "absolute" : "signed", worst, F15_LIMIT, at);
        assert_true(worst < F15_LIMIT);
    }
    gauss_free(&truth);
    gauss_free(&g);
}

/* ---- F26, F30 ---- */

enum { F30_STEPS = 40 };

static void toy_scene(char dir[FILE_PATH_MAX], struct toy *t)
{
    struct gauss g = {0};
    *t = toy_spec();
    toy_gauss(t, &g);
    kit_tmpdir(dir);
    toy_write(dir, t, &g);
    gauss_free(&g);
}

static void to_the_end(struct toy_run *r)
{
    while (r->level.stage.at < r->level.stage.n_levels) {
        toy_run_level(r);
        toy_run_next(r);
    }
}

static struct hash128 model_hash(struct toy_run *r)
{
    struct err e = {0};
    size_t bytes =
        layout_floats(r->level.model.gauss.n, r->level.model.gauss.planes) * sizeof(float);
    float *v = mem_array(bytes, 1);
    assert_non_null(v);
    kit_ok(dev_read(&toy_dev, r->level.model.gauss.params, 0, bytes, v, &e), e);
    struct hash128 h = hash_bytes(v, bytes);
    mem_free(v);
    return h;
}

static struct train_config short_config(struct arena *a)
{
    struct train_config c = toy_config(a, NULL);
    c.iterations.one = F30_STEPS;
    c.densify_interval_min = 4; /* densification and three levels, all of it within 40 steps */
    return c;
}

/* Every step of a run is a place to be interrupted at. */
/* Whether a run that goes on from where this one stands ends in these bytes. */
static bool ends_in(struct toy_run *part, const char *dir, const char *path,
                    const struct hash128 *want)
{
    struct err e = {0};
    struct toy_run again;
    kit_ok(level_save(&part->level, 0.0, path, &e), e);
    toy_run_load(&again, dir, part->level.cfg, path);
    to_the_end(&again);
    struct hash128 got = model_hash(&again);
    toy_run_close(&again);
    return !memcmp(&got, want, sizeof got);
}

static void resumed_anywhere(enum schedule_order order)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy t;
    struct toy_run whole, part;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct train_config c = short_config(&a);
    size_t same = 0, tried = 0;
    c.level_order = order;
    toy_scene(dir, &t);
    toy_run_open(&whole, dir, &c);
    to_the_end(&whole);
    struct hash128 want = model_hash(&whole);
    size_t n = whole.level.model.gauss.n;
    kit_ok(file_join(path, dir, "resume.ckpt", &e), e);
    toy_run_open(&part, dir, &c);
    while (part.level.stage.at < part.level.stage.n_levels) {
        while (part.level.stage.step < part.level.stage.levels[part.level.stage.at].steps) {
            toy_run_steps(&part, 1);
            same += ends_in(&part, dir, path, &want);
            tried++;
        }
        toy_run_next(&part);
    }
    struct hash128 got = model_hash(&part);
    kit_figure("F30", "interrupted_at=%zu bit_equal=%zu gaussians=%zu", tried, same, n);
    kit_figure("F26", "training_repeats=%s", memcmp(&got, &want, sizeof got) ? "no" : "bit-equal");
    assert_memory_equal(&got, &want, sizeof got);
    assert_int_equal(tried, F30_STEPS);
    assert_int_equal(same, tried);
    toy_run_close(&whole);
    toy_run_close(&part);
    kit_rmdir(dir);
    arena_free(&a);
}

static void resumed_anywhere_it_ends_in_the_same_bytes(void **state)
{
    resumed_anywhere(SCHEDULE_COARSE_TO_FINE);
    resumed_anywhere(SCHEDULE_BOTH);
}

/* ---- F28 ---- */

static void paint_grey(void *user, size_t i, const struct camera *cam, double *rgb)
{
    (void)user;
    (void)i;
    for (size_t k = 0; k < (size_t)cam->width_px * cam->height_px * 3; k++)
        rgb[k] = 0.5;
}

static void expect_finite_scores(const char *what, const char *dir, const struct gauss *g,
                                 bool none_visible)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy_run r;
    struct train_config c = toy_config(&a, NULL);
    c.level_count = 1;
    toy_run_open_from(&r, dir, &c, g);
    size_t n = g->n, bad = 0, positive = 0;
    float *score = mem_array(n, sizeof(float));
    assert_non_null(score);
    kit_ok(importance_run(&r.level.importance, &r.level.model, &r.level.gallery, &r.level.stage,
                          score, &e),
           e);
    for (size_t i = 0; i < n; i++) {
        bad += !isfinite(score[i]) || score[i] < 0.0f;
        positive += score[i] > 0.0f;
    }
    kit_figure("F28", "input=%s scores=%zu not_finite=%zu limit=0 positive=%zu", what, n, bad,
               positive);
    assert_int_equal(bad, 0);
    /* And training on it goes on, with finite numbers. */
    double loss = none_visible ? toy_run_steps(&r, 5) : toy_run_level(&r);
    assert_true(isfinite(loss));
    struct gauss out = {0};
    kit_ok(model_gauss(&r.level.model, &out, &e), e);
    assert_true(toy_finite(&out));
    gauss_free(&out);
    mem_free(score);
    toy_run_close(&r);
    arena_free(&a);
}

/* Scores of all Gaussians of g before the first step. */
static float *scores_at_first(const struct toy *t, const struct gauss *truth, const struct gauss *g)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy_run r;
    char dir[FILE_PATH_MAX];
    struct train_config c = toy_config(&a, NULL);
    c.level_count = 1;
    kit_tmpdir(dir);
    toy_write(dir, t, truth);
    toy_run_open_from(&r, dir, &c, g);
    float *score = mem_array(g->n, sizeof(float));
    assert_non_null(score);
    kit_ok(importance_run(&r.level.importance, &r.level.model, &r.level.gallery, &r.level.stage,
                          score, &e),
           e);
    toy_run_close(&r);
    kit_rmdir(dir);
    arena_free(&a);
    return score;
}

/* Photographs of 290 x 270 px are drawn at half of that, those of 145 x 135 px as they are. Both
 * show the same, so scores differ by what means of four pixels are off from a picture of that size.
 */
static void scores_of_halved_photographs_are_those_of_small_ones(void **state)
{
    struct toy large = toy_spec(), small;
    struct gauss truth = {0}, g = {0};
    double mean[2] = {0}, off = 0.0, spread = 0.0;
    large.width_px = 290;
    large.height_px = 270;
    small = large;
    small.width_px /= 2;
    small.height_px /= 2;
    toy_gauss(&large, &truth);
    toy_gauss(&large, &g);
    for (size_t i = 0; i < g.n; i += 3)
        g.opacity_logit[i] -= 2.0f; /* errors that importance looks for */
    float *score[2] = {scores_at_first(&large, &truth, &g), scores_at_first(&small, &truth, &g)};
    for (size_t i = 0; i < g.n; i++)
        for (int k = 0; k < 2; k++)
            mean[k] += (double)score[k][i] / (double)g.n;
    for (size_t i = 0; i < g.n; i++) {
        double a = (double)score[0][i] / mean[0], b = (double)score[1][i] / mean[1];
        off += fabs(a - b) / (double)g.n;
        spread += fabs(b - 1.0) / (double)g.n;
    }
    kit_figure("F28", "halved_scores_off=%.5f limit=0.01 spread=%.3f", off, spread);
    assert_true(spread > 0.2 && off < 0.01);
    mem_free(score[0]);
    mem_free(score[1]);
    gauss_free(&truth);
    gauss_free(&g);
}

static void scores_survive_constant_and_empty_input(void **state)
{
    struct toy t = toy_spec();
    struct gauss g = {0};
    char dir[FILE_PATH_MAX];
    t.paint = paint_grey; /* photographs without an edge */
    toy_gauss(&t, &g);
    kit_tmpdir(dir);
    toy_write(dir, &t, &g);
    expect_finite_scores("constant-photographs", dir, &g, false);
    struct gauss equal = {0}; /* the picture is the photograph: residuals all 0 */
    struct toy one = t;
    one.n = 40;
    toy_gauss(&one, &equal);
    for (size_t i = 0; i < equal.n; i++)
        equal.opacity_logit[i] = -20.0f; /* nothing is drawn */
    expect_finite_scores("all-transparent", dir, &equal, true);
    for (size_t i = 0; i < g.n; i++)
        g.mean_m[3 * i + 2] += 1000.0f; /* above the cameras, behind them */
    expect_finite_scores("none-visible", dir, &g, true);
    kit_rmdir(dir);
    t.paint = NULL;
    for (size_t i = 0; i < g.n; i++)
        g.mean_m[3 * i + 2] -= 1000.0f;
    kit_tmpdir(dir);
    toy_write(dir, &t, &g);
    expect_finite_scores("no-residual", dir, &g, false);
    kit_rmdir(dir);
    gauss_free(&g);
    gauss_free(&equal);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(candidates_do_not_depend_on_picture_size),
        cmocka_unit_test(resumed_anywhere_it_ends_in_the_same_bytes),
        cmocka_unit_test(scores_of_halved_photographs_are_those_of_small_ones),
        cmocka_unit_test(scores_survive_constant_and_empty_input),
    };
    return cmocka_run_group_tests_name("train", tests, toy_open_device, toy_close_device);
}
