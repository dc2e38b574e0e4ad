/* Scores by half images: failure F31 of lab/STABILITY.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/half_image.h"
#include "tests/stability/toy_appearance.h"
#include "train/base/config.h"
#include "train/model/appearance_train.h"
#include "train/photographs/evaluate.h"
#include "train/photographs/photo_loader.h"

#include <string.h>

/* A toy in changing light, trained for a quarter of its steps, and its first test photograph. */
struct half_case {
    struct arena arena;
    char dir[FILE_PATH_MAX];
    struct train_config cfg;
    struct toy_run run;
    struct appearance_view view;
    struct photo_loader *loader;
    struct half_image *h;
    struct render_options ro;
    struct photo photo;
    size_t n;                          /* its pixels */
    float start[APPEARANCE_IMAGE_MAX]; /* embedding that learning starts from */
};

static void half_case_open(struct half_case *t)
{
    struct err e = {0};
    *t = (struct half_case){0};
    toy_appearance_scene(t->dir, 0.6);
    t->cfg = toy_appearance_config(&t->arena, NULL, true);
    toy_run_open(&t->run, t->dir, &t->cfg);
    toy_run_steps(&t->run, TOY_APPEARANCE_STEPS / 4);
    struct level *l = &t->run.level;
    struct photo_loader_config f = {.scene = &t->run.scene,
                                    .images = t->run.tests,
                                    .n_images = t->run.n_tests,
                                    .downsample = 1.0,
                                    .cache_bytes = 1 << 20};
    kit_ok(appearance_view_open(&t->view, &l->appearance.model, &t->run.scene, &e), e);
    const struct half_image_config hc = {.dev = &toy_dev,
                                         .render = l->engine.render,
                                         .loss = l->engine.loss,
                                         .appearance = &t->view,
                                         .steps = 10,
                                         .lr = HALF_IMAGE_LR,
                                         .lr_end = HALF_IMAGE_LR_END};
    t->ro = gallery_options(&l->gallery, &l->stage);
    kit_ok(half_image_open(&hc, &t->h, &e), e);
    kit_ok(photo_loader_open(&f, &t->loader, &e), e);
    kit_ok(photo_loader_get_nth(t->loader, 0, &t->photo, &e), e);
    t->n = (size_t)t->photo.cam.width_px * t->photo.cam.height_px;
    assert_int_equal(appearance_train_nearest(t->view.model, &t->run.scene, t->view.row,
                                              &t->photo.cam, t->view.reach_m, t->start),
                     3);
}

static void half_case_close(struct half_case *t)
{
    photo_loader_close(&t->loader);
    half_image_close(&t->h);
    appearance_view_close(&t->view);
    toy_run_close(&t->run);
    kit_rmdir(t->dir);
    arena_free(&t->arena);
}

static void half_score(struct half_case *t, const struct photo *p, enum half_image_side side,
                       struct evaluate_score *out)
{
    struct err e = {0};
    kit_ok(half_image_score(t->h, p, &t->run.level.model.gauss, &t->ro, side, t->start, out, &e),
           e);
}

static void half_fit(struct half_case *t, const struct photo *p, enum half_image_side side,
                     float *embedding)
{
    struct err e = {0};
    kit_ok(half_image_fit(t->h, p, &t->run.level.model.gauss, &t->ro, side, embedding, &e), e);
}

/* A camera can be drawn in the appearance of any photograph; of one without, in the nearest's. */
static void a_view_has_the_appearance_that_it_is_given(void **state)
{
    struct half_case t;
    half_case_open(&t);
    const struct appearance *a = t.view.model;
    size_t floats = appearance_frame_floats(a->len_gauss, a->hidden);
    float *nearest = mem_array(floats, sizeof *nearest), *own = mem_array(floats, sizeof *own);
    float image[APPEARANCE_IMAGE_MAX];
    assert_true(nearest && own);
    memcpy(nearest, appearance_view_frame(&t.view, &t.photo.cam), floats * sizeof *nearest);
    size_t with = 0, without = 0;
    for (uint32_t i = 0; i < t.run.scene.n_images; i++) {
        t.view.photograph = i;
        const float *frame = appearance_view_frame(&t.view, &t.photo.cam);
        if (t.view.row[i] == APPEARANCE_TRAIN_ROW_NONE) {
            assert_memory_equal(frame, nearest, floats * sizeof *frame);
            without++;
            continue;
        }
        appearance_blend(a, &t.view.row[i], (const double[]){1.0}, 1, image);
        appearance_frame(a, image, own);
        assert_memory_equal(frame, own, floats * sizeof *frame);
        assert_memory_not_equal(frame, nearest, floats * sizeof *frame);
        with++;
    }
    assert_true(with > 2 && without > 0);
    mem_free(nearest);
    mem_free(own);
    half_case_close(&t);
}

static void the_score_of_a_half_does_not_know_the_other(void **state)
{
    struct half_case t;
    struct evaluate_score s[2] = {{0}};
    float image[2][APPEARANCE_IMAGE_MAX];
    half_case_open(&t);
    uint32_t w = t.photo.cam.width_px;
    uint8_t *px = mem_array(3 * t.n, 1);
    assert_non_null(px);
    for (size_t i = 0; i < 3 * t.n; i++)
        px[i] = i / 3 % w < w / 2 ? (uint8_t)(255 - t.photo.px[i]) : t.photo.px[i];
    struct photo changed = t.photo;
    changed.px = px;
    const struct photo *photos[2] = {&t.photo, &changed};
    for (int k = 0; k < 2; k++) {
        memcpy(image[k], t.start, sizeof t.start);
        half_score(&t, photos[k], HALF_IMAGE_RIGHT, &s[k]);
        half_fit(&t, photos[k], HALF_IMAGE_RIGHT, image[k]);
    }
    toy_figure("F31", "psnr_difference_db=%g ssim_difference=%g", s[0].psnr_db - s[1].psnr_db,
               s[0].ssim - s[1].ssim);
    assert_true(s[0].psnr_db == s[1].psnr_db && s[0].ssim == s[1].ssim && s[0].l1 == s[1].l1);
    assert_true(s[0].ssim_valid == s[1].ssim_valid);
    assert_memory_equal(image[0], image[1], sizeof image[0]); /* learning from the right half */
    /* ... and the left half does decide where it should. */
    memcpy(image[1], image[0], sizeof image[0]);
    for (int k = 0; k < 2; k++)
        half_fit(&t, photos[k], HALF_IMAGE_LEFT, image[k]);
    assert_memory_not_equal(image[0], image[1], sizeof image[0]);
    mem_free(px);
    half_case_close(&t);
}

/* Masks are cut with the picture: what they hide decides nothing, and what they hide on one side
 * changes nothing on the other. */
static void masked_pixels_of_a_half_count_nothing(void **state)
{
    struct half_case t;
    struct evaluate_score whole = {0}, s[2][2] = {{{0}}};
    float image[2][APPEARANCE_IMAGE_MAX];
    half_case_open(&t);
    uint32_t w = t.photo.cam.width_px, rows = t.photo.cam.height_px;
    uint8_t *px = mem_array(t.n, 3), *mask = mem_array(t.n, 1);
    assert_true(px && mask);
    for (size_t i = 0; i < t.n; i++) { /* hide the upper third of the left half, and spoil it */
        bool hidden = i % w < w / 2 && i / w < rows / 3;
        mask[i] = hidden ? 0 : 255;
        for (size_t k = 3 * i; k < 3 * i + 3; k++)
            px[k] = hidden ? (uint8_t)(255 - t.photo.px[k]) : t.photo.px[k];
    }
    struct photo hidden = t.photo, spoilt = t.photo;
    hidden.mask = spoilt.mask = mask;
    spoilt.px = px;
    const struct photo *pair[2] = {&hidden, &spoilt};
    half_score(&t, &t.photo, HALF_IMAGE_RIGHT, &whole);
    for (int k = 0; k < 2; k++) {
        memcpy(image[k], t.start, sizeof t.start);
        half_fit(&t, pair[k], HALF_IMAGE_LEFT, image[k]);
        for (int side = 0; side < 2; side++)
            half_score(&t, pair[k], (enum half_image_side)side, &s[k][side]);
    }
    toy_figure("F31", "masked_psnr_db=%.3f spoilt_psnr_db=%.3f other_half_db=%.3f whole_db=%.3f",
               s[0][0].psnr_db, s[1][0].psnr_db, s[0][1].psnr_db, whole.psnr_db);
    assert_memory_equal(image[0], image[1], sizeof image[0]);
    assert_memory_not_equal(image[0], t.start, sizeof image[0]);
    assert_true(s[0][HALF_IMAGE_LEFT].psnr_db == s[1][HALF_IMAGE_LEFT].psnr_db);
    assert_true(s[0][HALF_IMAGE_RIGHT].psnr_db == whole.psnr_db);
    mem_free(px);
    mem_free(mask);
    half_case_close(&t);
}

/* Scores of half images take no longer than the training did. */
static void scores_take_no_longer_than_training(void **state)
{
    static const struct {
        double trained;
        size_t photos;
        uint32_t steps;
    } cases[] = {
        {0.0, 10, 200}, {30000.0, 25, 200}, {1000.0, 10, 100}, {750.0, 300, 2}, {5.0, 9, 1}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++)
        assert_int_equal(half_image_steps(cases[i].trained, cases[i].photos), cases[i].steps);
}

int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_view_has_the_appearance_that_it_is_given),
        cmocka_unit_test(the_score_of_a_half_does_not_know_the_other),
        cmocka_unit_test(masked_pixels_of_a_half_count_nothing),
        cmocka_unit_test(scores_take_no_longer_than_training),
    };
    return cmocka_run_group_tests_name("half images", tests, toy_open_device, toy_close_device);
}
