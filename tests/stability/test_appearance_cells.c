/* One appearance for all cells: failure F9 of lab/STABILITY.md, and the shared model that cells
 * ask for.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "tests/stability/toy_appearance.h"
#include "train/base/config.h"
#include "train/coarse.h"
#include "train/model/appearance_train.h"
#include "train/train.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* Between the two: of three seeds 0.0038 to 0.0043 with a shared network, 0.0077 to 0.0086
 * without. */
#define F9_SEAM (1.5 / 255.0)

/* ---- F9 ---- */

/* Cells take half of the steps of the coarse model: with as many, each alone learns the light as
 * well, and the feature under test shows nothing. */
enum {
    SEAM_COARSE_STEPS = 800,
    SEAM_STEPS = 400,
    SEAM_PX = 96,
    STRIP_PX = 8,
    SEAM_APPEARANCES = 12
};

/* Two cells, divided at x = 0, both trained from all photographs. */
static void toy_appearance_plan(const char *dir)
{
    struct err e = {0};
    struct scene s;
    struct partition plan = {0};
    struct partition_config pc = partition_defaults();
    char path[FILE_PATH_MAX + 64];
    kit_ok(scene_read(dir, &s, &e), e);
    pc.edge_m = 8.0;
    pc.location_margin = 2.0;
    pc.images_few = pc.images_least = 2;
    pc.use_visibility = false;
    kit_ok(partition_make(&s, &pc, &plan, &e), e);
    size_t trained = 0;
    for (size_t i = 0; i < plan.n_cells; i++)
        trained += plan.cells[i].parent < 0;
    assert_true(trained >= 2);
    snprintf(path, sizeof path, "%s/plan.json", dir);
    kit_ok(cell_plan_write(path, &s, &plan, &e), e);
    partition_free(&plan);
    scene_free(&s);
}

/* Every cell's own Gaussians in the appearance of a photograph. */
static void seam_merge(const char *dir, const struct partition *plan, const char *photo,
                       struct gauss *all)
{
    struct err e = {0};
    for (size_t i = 0; i < plan->n_cells; i++) {
        char path[FILE_PATH_MAX + 64];
        struct ckpt c;
        struct appearance a;
        uint32_t rows[1000];
        size_t n = 0;
        if (plan->cells[i].parent >= 0)
            continue;
        snprintf(path, sizeof path, "%s/cells/%s/level1.ckpt", dir, plan->cells[i].id);
        kit_ok(ckpt_read(path, &c, &e), e);
        kit_ok(coarse_read_appearance(&c, path, &a, &e), e);
        ptrdiff_t row = appearance_find(&a, photo);
        assert_true(row >= 0);
        kit_ok(appearance_bake(&a, a.images + (size_t)row * a.len_image, &c.g, &e), e);
        assert_true(c.g.n < 1000);
        for (size_t k = 0; k < c.g.n; k++)
            if (partition_owner(plan, c.g.origin_enu_m[0] + (double)c.g.mean_m[3 * k],
                                c.g.origin_enu_m[1] + (double)c.g.mean_m[3 * k + 1]) == i)
                rows[n++] = (uint32_t)k;
        if (!all->block) {
            kit_ok(gauss_alloc(all, n, c.g.sh_degree, 0, &e), e);
            all->antialiased = true;
            memcpy(all->origin_enu_m, c.g.origin_enu_m, sizeof all->origin_enu_m);
        }
        kit_ok(gauss_append(all, &c.g, rows, n, &e), e);
        appearance_free(&a);
        ckpt_free(&c);
    }
}

/* Mean colour of the strip right of the picture's middle minus that left of it. */
static void seam_step(const double *rgb, double out[3])
{
    for (size_t k = 0; k < 3; k++)
        out[k] = 0.0;
    for (size_t y = 0; y < SEAM_PX; y++)
        for (size_t x = SEAM_PX / 2 - STRIP_PX; x < SEAM_PX / 2 + STRIP_PX; x++)
            for (size_t k = 0; k < 3; k++)
                out[k] += (x < SEAM_PX / 2 ? -1.0 : 1.0) *
                          fmin(fmax(rgb[(y * SEAM_PX + x) * 3 + k], 0.0), 1.0) /
                          (SEAM_PX * STRIP_PX);
}

/* How much the step at the border, beyond the truth's, changes with the appearance: root mean
 * square about its mean over appearances, all channels. What is left of a step in all of them is
 * not the appearance's: cells without any, trained on one light, have 0.018 of it on this toy. */
static double seam_measure(const char *dir, struct toy *t, const struct gauss *truth)
{
    struct err e = {0};
    struct scene s;
    struct partition plan = {0};
    char path[FILE_PATH_MAX + 64];
    double eye[3] = {0.0, 0.0, t->height_m}, down[3] = {0.0, 0.0, 0.0}, sum = 0.0;
    double step[SEAM_APPEARANCES][3], mean[3] = {0.0};
    struct camera cam = camera_look_at(eye, down, 0.7, SEAM_PX, SEAM_PX);
    double *rgb = mem_array(SEAM_PX * SEAM_PX * 3, sizeof *rgb);
    assert_non_null(rgb);
    kit_ok(scene_read(dir, &s, &e), e);
    snprintf(path, sizeof path, "%s/plan.json", dir);
    kit_ok(cell_plan_read(path, &s, &plan, &e), e);
    for (size_t k = 0, i = 0; k < SEAM_APPEARANCES; k++, i++) {
        struct gauss all = {0};
        double want[3], got[3];
        while (s.images[i].split != SCENE_TRAIN)
            i++;
        toy_draw(truth, &cam, rgb);
        toy_appearance_paint(t->user, i, &cam, rgb);
        seam_step(rgb, want);
        seam_merge(dir, &plan, s.images[i].name, &all);
        toy_draw(&all, &cam, rgb);
        seam_step(rgb, got);
        for (size_t c = 0; c < 3; c++) {
            step[k][c] = got[c] - want[c];
            mean[c] += step[k][c] / SEAM_APPEARANCES;
        }
        gauss_free(&all);
    }
    for (size_t k = 0; k < SEAM_APPEARANCES; k++)
        for (size_t c = 0; c < 3; c++)
            sum += (step[k][c] - mean[c]) * (step[k][c] - mean[c]);
    mem_free(rgb);
    partition_free(&plan);
    scene_free(&s);
    return sqrt(sum / (3 * SEAM_APPEARANCES));
}

static void cells_agree_on_appearance_at_their_border(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct gauss truth = {0};
    struct train_result result = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    double strength = 0.6, seam[2];
    struct toy t = toy_appearance(&strength);
    kit_tmpdir(dir);
    toy_gauss(&t, &truth);
    toy_write(dir, &t, &truth);
    toy_appearance_plan(dir);
    for (int shared = 0; shared < 2; shared++) {
        struct train_config c = toy_appearance_config(&a, NULL, true);
        c.iterations.one = 0;
        c.iterations.v[2] = SEAM_STEPS;
        c.coarse_iterations = SEAM_COARSE_STEPS;
        c.appearance_shared = shared;
        c.overwrite = shared;
        train_result_free(&result);
        kit_ok(train_run(dir, &c, &result, &e), e);
        seam[shared] = seam_measure(dir, &t, &truth);
    }
    snprintf(path, sizeof path, "%s/cells/coarse/level1.ckpt", dir);
    assert_true(file_exists(path));
    toy_figure("F9", "seam_shared=%.5f seam_own=%.5f limit=%.5f", seam[1], seam[0], F9_SEAM);
    assert_true(seam[1] < F9_SEAM);
    assert_true(seam[0] > F9_SEAM); /* else the limit tests nothing */
    train_result_free(&result);
    gauss_free(&truth);
    kit_rmdir(dir);
    arena_free(&a);
}

/* One cell alone asks for the shared model, and takes it once it is there; making it again does
 * nothing. */
static void a_single_cell_needs_the_shared_model(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64], id[32];
    struct buf first = {0}, again = {0};
    struct scene s;
    struct partition plan = {0};
    toy_appearance_scene(dir, 0.3);
    toy_appearance_plan(dir);
    kit_ok(scene_read(dir, &s, &e), e);
    snprintf(path, sizeof path, "%s/plan.json", dir);
    kit_ok(cell_plan_read(path, &s, &plan, &e), e);
    size_t cell = 0;
    while (plan.cells[cell].parent >= 0)
        cell++;
    snprintf(id, sizeof id, "%s", plan.cells[cell].id);
    struct train_config c = toy_appearance_config(&a, NULL, true);
    c.iterations.one = 30;
    c.cell = id;
    kit_fails(train_run(dir, &c, &r, &e), ERR_NOENT, e, "--coarse-only");
    train_result_free(&r);
    c.cell = NULL;
    c.coarse_only = true;
    for (int i = 0; i < 2; i++) {
        kit_ok(train_run(dir, &c, &r, &e), e);
        assert_int_equal(r.n_cells, 0);
        train_result_free(&r);
        snprintf(path, sizeof path, "%s/cells/coarse/level1.ckpt", dir);
        kit_ok(file_read(path, 0, i ? &again : &first, &e), e);
    }
    assert_int_equal(first.size, again.size);
    assert_memory_equal(first.data, again.data, first.size);
    c.coarse_only = false;
    c.cell = id;
    kit_ok(train_run(dir, &c, &r, &e), e);
    train_result_free(&r);
    struct ckpt whole, one;
    kit_ok(ckpt_read(path, &whole, &e), e);
    snprintf(path, sizeof path, "%s/cells/%s/level1.ckpt", dir, id);
    kit_ok(ckpt_read(path, &one, &e), e);
    const struct ckpt_blob *x = ckpt_find(&whole, APPEARANCE_TRAIN_BLOB),
                           *y = ckpt_find(&one, APPEARANCE_TRAIN_BLOB);
    assert_true(x && y);
    assert_int_equal(x->size_bytes, y->size_bytes);
    assert_memory_equal(x->data, y->data, x->size_bytes);
    ckpt_free(&whole);
    ckpt_free(&one);
    buf_free(&first);
    buf_free(&again);
    partition_free(&plan);
    scene_free(&s);
    kit_rmdir(dir);
    arena_free(&a);
}

/* A network that would learn nothing, or next to nothing, is refused. */
static void a_network_needs_steps(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    toy_appearance_scene(dir, 0.3);
    struct train_config c = toy_appearance_config(&a, NULL, true);
    c.iterations.one = 40;
    c.appearance_warmup = TOY_APPEARANCE_STEPS;
    kit_fails(train_run(dir, &c, &r, &e), ERR_ARG, e, "warm-up of 40 steps");
    train_result_free(&r);
    toy_appearance_plan(dir);
    c.coarse_only = true;
    c.appearance_warmup = 1000;
    c.coarse_iterations = 1000;
    c.coarse_iterations_min = 2000;
    kit_fails(train_run(dir, &c, &r, &e), ERR_ARG, e, "--coarse-iterations of at least 2000");
    train_result_free(&r);
    c.coarse_iterations = 7000; /* the share of so short a run would be 175 steps */
    c.coarse_iterations_min = 300;
    kit_ok(train_run(dir, &c, &r, &e), e);
    train_result_free(&r);
    struct ckpt whole;
    snprintf(path, sizeof path, "%s/cells/coarse/level1.ckpt", dir);
    kit_ok(ckpt_read(path, &whole, &e), e);
    assert_int_equal(json_integer_value(json_object_get(whole.meta, "steps")), 300);
    ckpt_free(&whole);
    kit_rmdir(dir);
    arena_free(&a);
}

int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cells_agree_on_appearance_at_their_border),
        cmocka_unit_test(a_single_cell_needs_the_shared_model),
        cmocka_unit_test(a_network_needs_steps),
    };
    return cmocka_run_group_tests_name("appearance of cells", tests, toy_open_device,
                                       toy_close_device);
}
