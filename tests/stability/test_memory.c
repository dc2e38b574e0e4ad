/* Memory of a cell in training stays below what train/memory.c says of it, and below a bound a
 * Gaussian at SH degree 3, with and without appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "core/layout.h"
#include "scene/cells/cell.h"
#include "tests/stability/toy.h"
#include "train/base/config.h"
#include "train/base/schedule.h"
#include "train/density/prune.h"
#include "train/level.h"
#include "train/memory.h"
#include "train/train.h"
#include "train/train_scene.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MEMORY_SMALL = 500,
    MEMORY_MANY = 30000,
    MEMORY_GROWN = 90000,
    MEMORY_STEPS = 40,
    /* What a Gaussian may take: 472 are parameters and moments. With appearance twice 16 numbers of
     * its embedding are added, and 16 bytes of its statistics. */
    MEMORY_LIMIT_BYTES = 1024, /* 96 more than without moments of depth: 12 an intersection */
    MEMORY_LIMIT_LIGHT_BYTES = MEMORY_LIMIT_BYTES + 2 * 16 * 4 + 16,
};

/* Memory does not ask what is on the photographs: bands, so that there is something to learn. */
static void paint_bands(void *user, size_t i, const struct camera *cam, double *rgb)
{
    (void)user;
    for (size_t k = 0; k < (size_t)cam->width_px * cam->height_px * 3; k++)
        rgb[k] = 0.5 + 0.4 * sin(0.2 * (double)(k / 3 % cam->width_px) + (double)(i + k % 3));
}

enum kind { MEMORY_PLAIN, MEMORY_LIGHT, MEMORY_BOTH };

/* The options of such a run. */
static struct train_config same_config(struct arena *a, size_t budget, enum kind kind)
{
    struct train_config cfg = toy_config(a, NULL);
    cfg.level_count = 2;
    cfg.sh_degree = 3;
    cfg.iterations.one = MEMORY_STEPS;
    cfg.appearance = kind == MEMORY_LIGHT;
    cfg.level_order = kind == MEMORY_BOTH ? SCHEDULE_BOTH : SCHEDULE_COARSE_TO_FINE;
    cfg.scale_weight = 0.05;
    cfg.budget.v[1] = (int64_t)budget / 2;
    cfg.budget.v[2] = (int64_t)budget;
    return cfg;
}

/* Train n points up to `budget` over two levels in a process of its own, saving its state on the
 * way; its peak. */
static size_t peak_of(const char *program, size_t n, size_t budget, enum kind kind,
                      size_t *gaussians, struct memory_need *need)
{
    const bool appearance = kind == MEMORY_LIGHT;
    struct err e = {0};
    struct arena a = {0};
    struct toy t = toy_spec();
    struct gauss g = {0};
    struct buf said = {0};
    struct scene s;
    struct cell cell;
    struct schedule levels[TRAIN_LEVELS_MAX];
    uint32_t *images;
    size_t n_images;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    t.n = n;
    t.sigma_min_m = 0.03;
    t.sigma_max_m = 0.06;
    t.photos = 6;
    t.blank = true;
    t.paint = paint_bands;
    toy_gauss(&t, &g);
    kit_tmpdir(dir);
    toy_write(dir, &t, &g);
    gauss_free(&g);
    int rc =
        kit_run(&said,
                "%s train %s --iterations %d --level-count 2 --budget-rule table --budget %zu,%zu "
                "--densify-from 2 --densify-interval-min 5 --tau 1e-7 --prune-contribution 0 "
                "--prune-support 0 "
                "--checkpoint-interval 25 %s -q",
                program, dir, MEMORY_STEPS, budget / 2, budget,
                appearance            ? "--appearance --level-order coarse-to-fine"
                : kind == MEMORY_BOTH ? "--level-order both"
                                      : "--level-order coarse-to-fine");
    buf_u8(&said, 0);
    if (rc)
        fail_msg("train: %s", (const char *)said.data);
    const char *mib = strstr((const char *)said.data, " MiB at most");
    assert_non_null(mib);
    while (mib[-1] >= '0' && mib[-1] <= '9')
        mib--;
    size_t peak = (size_t)strtoull(mib, NULL, 10) << 20;
    /* What the estimate says for the same run. */
    struct train_config cfg = same_config(&a, budget, kind);
    kit_ok(scene_read(dir, &s, &e), e);
    kit_ok(train_scene_images(&s, SCENE_TRAIN, true, &images, &n_images, &e), e);
    cell_whole(&s, images, n_images, &cell);
    kit_ok(schedule_make(&cfg, n_images, &cell, levels, &e), e);
    *need = memory_estimate(&cfg, &s, images, n_images, levels, 2, true);
    struct ckpt c;
    snprintf(path, sizeof path, "%s/cells/all/level2.ckpt", dir);
    kit_ok(ckpt_read(path, &c, &e), e);
    *gaussians = c.g.n;
    ckpt_free(&c);
    buf_free(&said);
    scene_free(&s);
    arena_free(&a);
    kit_rmdir(dir);
    return peak;
}

static void expect_below_the_estimate(enum kind kind)
{
    const bool appearance = kind == MEMORY_LIGHT;
    struct memory_need small, many;
    size_t n_small, n_many;
    const char *program = kit_program();
    /* Once for nothing: where kernels are not cached yet, their compiler is the peak. */
    (void)peak_of(program, MEMORY_SMALL, MEMORY_SMALL, kind, &n_small, &small);
    size_t base = peak_of(program, MEMORY_SMALL, MEMORY_SMALL, kind, &n_small, &small);
    size_t peak = peak_of(program, MEMORY_MANY, MEMORY_GROWN, kind, &n_many, &many);
    /* Of those that the level grew to, before it was thinned to n_many. */
    double each =
        ((double)peak - (double)base) / ((double)many.gaussians - (double)small.gaussians);
    int limit = appearance ? MEMORY_LIMIT_LIGHT_BYTES : MEMORY_LIMIT_BYTES;
    kit_figure("memory",
               "kind=%d bytes_per_gaussian=%.0f limit=%d estimate=%zu gaussians=%zu "
               "program_mib=%.0f peak_mib=%.0f",
               (int)kind, each, limit, many.per_gaussian, n_many, (double)base / 1048576.0,
               (double)peak / 1048576.0);
    assert_true(n_many > 2 * MEMORY_MANY); /* it did grow */
    assert_true(peak - base <= many.total - small.total);
    assert_true(each <= limit);
    /* And the bound is not so wide that nothing could break it. */
    assert_true(1.5 * each > (double)many.per_gaussian);
}

static void memory_stays_below_the_estimate(void **state)
{
    expect_below_the_estimate(MEMORY_PLAIN);
    expect_below_the_estimate(MEMORY_BOTH);
}

static void and_with_appearance(void **state)
{
    expect_below_the_estimate(MEMORY_LIGHT);
}

/* ---- rows in place ---- */

enum { REMOVAL_STEPS = 12, REMOVAL_PARTS = 2 };

/* Parameters and moments as they lie on the device. */
static float *arrays_of(const struct level *l, size_t floats)
{
    struct err e = {0};
    cl_mem parts[REMOVAL_PARTS] = {l->model.gauss.params, l->model.adam.moments};
    float *all = mem_array(REMOVAL_PARTS * floats, sizeof *all);
    assert_non_null(all);
    for (size_t k = 0; k < REMOVAL_PARTS; k++)
        kit_ok(dev_read(&toy_dev, parts[k], 0, floats * sizeof(float), all + k * floats, &e), e);
    return all;
}

static bool same_row(const float *a, size_t i, const float *b, size_t j, uint32_t planes)
{
    bool same = true;
    for (uint32_t p = 0; p < planes; p++)
        same = same && a[layout_at(i, planes) + (size_t)p * LAYOUT_LANES] ==
                           b[layout_at(j, planes) + (size_t)p * LAYOUT_LANES];
    return same;
}

/* Half the weight's worth of Gaussians are candidates at a level's end: none goes when that may
 * cost nothing, some where it may cost a little, all where it may cost anything; the others stay in
 * their order. */
static void as_many_go_as_may(void **state)
{
    struct err e = {0};
    static const double may_cost_db[3] = {0.0, 0.5, 100.0};
    for (int k = 0; k < 3; k++) {
        struct arena a = {0};
        struct toy t = toy_spec();
        struct gauss g = {0};
        struct toy_run r;
        char dir[FILE_PATH_MAX];
        toy_gauss(&t, &g);
        kit_tmpdir(dir);
        toy_write(dir, &t, &g);
        struct train_config c = toy_config(&a, NULL);
        c.level_count = 1;
        c.prune_contribution = 0.5;
        c.prune_support = 0;
        c.prune_loss_db = may_cost_db[k];
        toy_run_open(&r, dir, &c);
        toy_run_steps(&r, REMOVAL_STEPS);
        struct level *l = &r.level;
        uint32_t n = l->model.gauss.n, planes = l->model.gauss.planes;
        size_t floats = layout_floats(n, planes);
        float *before = arrays_of(l, floats);
        struct prune_report report;
        kit_ok(prune_level(&l->model, &l->gallery, l->site.ground, &l->stage, &report, NULL, &e),
               e);
        toy_figure("F30", "candidates=%zu may_cost_db=%.1f removed=%zu lost_db=%.3f", report.faint,
                   may_cost_db[k], report.removed, report.lost_db);
        assert_true(report.faint > 0 && report.lost_db <= may_cost_db[k]);
        assert_true((report.removed == 0) == (k == 0));
        assert_true((report.removed == report.faint) == (k == 2));
        float *after = arrays_of(l, floats);
        if (!k) {
            assert_int_equal(l->model.gauss.n, n);
            assert_memory_equal(before, after, REMOVAL_PARTS * floats * sizeof *after);
        }
        assert_int_equal(l->model.gauss.n, n - report.removed);
        for (size_t part = 0; part < REMOVAL_PARTS; part++) {
            const float *was = before + part * floats, *is = after + part * floats;
            size_t from = 0;
            for (size_t i = 0; i < l->model.gauss.n; i++, from++)
                while (!same_row(is, i, was, from, planes))
                    assert_true(++from < n); /* a later one */
            for (size_t i = l->model.gauss.n; i % LAYOUT_LANES; i++)
                for (uint32_t p = 0; p < planes; p++)
                    assert_true(is[layout_at(i, planes) + (size_t)p * LAYOUT_LANES] == 0.0f);
        }
        toy_run_steps(&r, 1); /* and training goes on */
        mem_free(before);
        mem_free(after);
        toy_run_close(&r);
        gauss_free(&g);
        kit_rmdir(dir);
        arena_free(&a);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(memory_stays_below_the_estimate),
                                       cmocka_unit_test(and_with_appearance),
                                       cmocka_unit_test(as_many_go_as_may)};
    return cmocka_run_group_tests_name("memory", tests, toy_open_device, toy_close_device);
}
