/* Memory of a cell in training stays below what train/memory.c says of it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/stability/toy.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "train/memory.h"

enum { MEMORY_SMALL = 500, MEMORY_MANY = 8000, MEMORY_GROWN = 24000, MEMORY_STEPS = 30 };

/* Train n points up to `budget` in a process of its own; its peak. */
static size_t peak_of(const char *program, size_t n, size_t budget, size_t *gaussians,
                      struct memory_need *need)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy t = toy_spec();
    struct gauss g = {0};
    struct buf said = {0};
    struct scene s;
    struct train_cell cell;
    struct schedule levels[TRAIN_LEVELS_MAX];
    uint32_t *images;
    size_t n_images;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    t.n = n;
    t.sigma_min_m = 0.03;
    t.sigma_max_m = 0.06;
    t.photos = 6;
    toy_gauss(&t, &g);
    kit_tmpdir(dir);
    toy_write(dir, &t, &g);
    gauss_free(&g);
    int rc = kit_run(&said,
                     "%s train %s --iterations %d --level-count 1 --budget table --budget-3 %zu "
                     "--densify-from 5 --densify-interval-min 10 --tau-3 1e-7 --score-views 2 "
                     "--checkpoint-interval 25 -q",
                     program, dir, MEMORY_STEPS, budget);
    buf_u8(&said, 0);
    if (rc)
        fail_msg("train: %s", (const char *)said.data);
    const char *mib = strstr((const char *)said.data, " MiB at most");
    assert_non_null(mib);
    while (mib[-1] >= '0' && mib[-1] <= '9')
        mib--;
    size_t peak = (size_t)strtoull(mib, NULL, 10) << 20;
    /* What the estimate says for the same run. */
    struct train_config cfg = toy_config(&a, NULL);
    cfg.level_count = 1;
    cfg.sh_degree = 3;
    cfg.iterations = MEMORY_STEPS;
    cfg.budget_3 = (int64_t)budget;
    kit_ok(scene_read(dir, &s, &e), e);
    kit_ok(train_images(&s, SCENE_TRAIN, true, &images, &n_images, &e), e);
    cell_whole(&s, images, n_images, &cell);
    kit_ok(schedule_make(&cfg, n_images, &cell, levels, &e), e);
    *need = memory_estimate(&cfg, &s, images, n_images, levels, 1, true);
    struct ckpt c;
    snprintf(path, sizeof(path), "%s/cells/all/level1.ckpt", dir);
    kit_ok(ckpt_read(path, &c, &e), e);
    *gaussians = c.g.n;
    ckpt_free(&c);
    buf_free(&said);
    scene_free(&s);
    arena_free(&a);
    kit_rmdir(dir);
    return peak;
}

static void memory_stays_below_the_estimate(void **state)
{
    (void)state;
    struct memory_need small, many;
    size_t n_small, n_many;
    const char *program = kit_program();
    size_t base = peak_of(program, MEMORY_SMALL, MEMORY_SMALL, &n_small, &small);
    size_t peak = peak_of(program, MEMORY_MANY, MEMORY_GROWN, &n_many, &many);
    double each = ((double)peak - (double)base) / (double)MEMORY_GROWN;
    kit_figure("memory",
               "bytes_per_gaussian=%.0f limit=%zu gaussians=%zu program_mib=%.0f peak_mib=%.0f",
               each, many.per_gaussian, n_many, (double)base / 1048576.0, (double)peak / 1048576.0);
    assert_true(n_many > MEMORY_MANY); /* it did grow */
    assert_true(peak - base <= many.total - small.total);
    /* And the bound is not so wide that nothing could break it. */
    assert_true(2.0 * each > (double)many.per_gaussian);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(memory_stays_below_the_estimate)};
    return cmocka_run_group_tests_name("memory", tests, toy_open_device, toy_close_device);
}
