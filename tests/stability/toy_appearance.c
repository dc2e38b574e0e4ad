/* Implements tests/stability/toy_appearance.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/stability/toy_appearance.h"

#include "lab/eval/half_image.h"
#include "train/loss/photometric.h"
#include "train/model/appearance_train.h"
#include "train/photographs/photo_loader.h"

#include <math.h>

#define NOISE 0.04

void toy_appearance_paint(void *user, size_t i, const struct camera *cam, double *rgb)
{
    const double *strength = user;
    double ev = *strength * (2.0 * rng_unit(5, 1, i / 2) - 1.0);
    double warm = 0.3 * *strength * (2.0 * rng_unit(5, 2, i / 2) - 1.0);
    double gain[3] = {exp2(ev + warm), exp2(ev), exp2(ev - warm)};
    for (size_t k = 0; k < (size_t)cam->width_px * cam->height_px * 3; k++)
        rgb[k] = fmin(rgb[k] * gain[k % 3], 1.0) + NOISE * rng_normal(6, i, k);
}

struct toy toy_appearance(double *strength)
{
    struct toy t = toy_spec();
    t.photos = TOY_APPEARANCE_PHOTOS;
    t.paint = toy_appearance_paint;
    t.user = strength;
    return t;
}

struct train_config toy_appearance_config(struct arena *a, const char *out, bool appearance)
{
    struct train_config c = toy_config(a, out);
    c.level_count = 1;
    c.iterations.one = TOY_APPEARANCE_STEPS;
    c.iterations.v[2] = TOY_APPEARANCE_STEPS; /* kappa 1: the warm-up below is in steps */
    c.appearance = appearance;
    c.appearance_warmup = TOY_APPEARANCE_STEPS / 8;
    c.densify_from = 1000000;
    return c;
}

void toy_appearance_scene(char dir[FILE_PATH_MAX], double strength)
{
    struct gauss g = {0};
    struct toy t = toy_appearance(&strength);
    kit_tmpdir(dir);
    toy_gauss(&t, &g);
    toy_write(dir, &t, &g);
    gauss_free(&g);
}

struct evaluate_score toy_appearance_score(struct toy_run *r)
{
    struct err e = {0};
    struct level *l = &r->level;
    struct appearance_view view = {0};
    struct half_image *h = NULL;
    struct photo_loader *loader = NULL;
    struct evaluate_score sum = {0};
    struct photo_loader_config f = {.scene = &r->scene,
                                    .images = r->tests,
                                    .n_images = r->n_tests,
                                    .downsample = 1.0,
                                    .cache_bytes = 1 << 20};
    struct half_image_config c = {.dev = &toy_dev,
                                  .render = l->engine.render,
                                  .loss = l->engine.loss,
                                  .steps = HALF_IMAGE_STEPS,
                                  .lr = HALF_IMAGE_LR,
                                  .lr_end = HALF_IMAGE_LR_END};
    struct render_options ro = gallery_options(&l->gallery, &l->stage);
    if (appearance_train_is_on(&l->appearance)) {
        kit_ok(appearance_view_open(&view, &l->appearance.model, &r->scene, &e), e);
        c.appearance = &view;
    }
    kit_ok(half_image_open(&c, &h, &e), e);
    kit_ok(photo_loader_open(&f, &loader, &e), e);
    for (size_t i = 0; i < r->n_tests; i++)
        for (int side = 0; side < 2; side++) {
            struct photo p;
            float image[APPEARANCE_IMAGE_MAX];
            enum half_image_side from = (enum half_image_side)side,
                                 to = side ? HALF_IMAGE_LEFT : HALF_IMAGE_RIGHT;
            kit_ok(photo_loader_get_nth(loader, i, &p, &e), e);
            if (c.appearance) {
                assert_int_equal(appearance_train_nearest(view.model, &r->scene, view.row, &p.cam,
                                                          view.reach_m, image),
                                 3);
                kit_ok(half_image_fit(h, &p, &l->model.gauss, &ro, from, image, &e), e);
            }
            kit_ok(half_image_score(h, &p, &l->model.gauss, &ro, to, c.appearance ? image : NULL,
                                    &sum, &e),
                   e);
        }
    evaluate_divide(&sum, 2.0 * (double)r->n_tests);
    half_image_close(&h);
    photo_loader_close(&loader);
    appearance_view_close(&view);
    return sum;
}
