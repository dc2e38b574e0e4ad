/* See blobs.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/train/blobs.h"

#include "codec/image/image.h"
#include "render/render.h"

#include <math.h>
#include <stdio.h>

#define GROUND_M 6.0

char blobs_dir[FILE_PATH_MAX];

static void blobs_gauss(struct gauss *g)
{
    struct err e = {0};
    kit_ok(gauss_alloc(g, BLOBS, 0, 0, &e), e);
    g->n = BLOBS;
    g->antialiased = true;
    for (size_t i = 0; i < BLOBS; i++) {
        for (size_t k = 0; k < 3; k++) {
            double half = k < 2 ? GROUND_M : 0.3;
            g->mean_m[3 * i + k] = (float)(half * (2.0 * rng_unit(11, 1, 3 * i + k) - 1.0));
            g->scale_log[3 * i + k] = logf((float)(0.3 + 0.7 * rng_unit(11, 2, 3 * i + k)));
            g->sh[3 * i + k] = (float)((rng_unit(11, 3, 3 * i + k) - 0.5) / GAUSS_SH_C0);
        }
        for (size_t k = 0; k < 4; k++)
            g->quat_wxyz[4 * i + k] = (float)rng_normal(11, 4, 4 * i + k);
        g->opacity_logit[i] = 2.0f;
    }
}

struct camera blobs_camera(size_t i)
{
    double angle = 2.0 * 3.14159265358979 * (double)i / BLOBS_PHOTOS;
    double eye[3] = {6.0 * cos(angle), 6.0 * sin(angle), 10.0}, target[3] = {0.0, 0.0, 0.0};
    return camera_look_at(eye, target, 0.9, BLOBS_WIDTH, BLOBS_HEIGHT);
}

static void blobs_photo(struct render *r, const struct render_model *m, const struct camera *cam,
                        const char *path)
{
    struct err e = {0};
    struct image img = {0};
    struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    float *rgb = mem_array(BLOBS_WIDTH * BLOBS_HEIGHT * 3, sizeof(float));
    assert_non_null(rgb);
    kit_ok(render_forward(r, m, cam, &ro, rgb, NULL, &e), e);
    kit_ok(image_alloc(BLOBS_WIDTH, BLOBS_HEIGHT, 3, &img, &e), e);
    for (size_t i = 0; i < BLOBS_WIDTH * BLOBS_HEIGHT * 3; i++)
        img.px[i] = (uint8_t)(fminf(fmaxf(rgb[i], 0.0f), 1.0f) * 255.0f + 0.5f);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    image_free(&img);
    mem_free(rgb);
}

void blobs_write(const char *dir, bool with_points)
{
    struct err e = {0};
    struct gauss g = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    struct scene s = {.scale = 1.0, .rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}, .n_images = BLOBS_PHOTOS};
    struct scene_image images[BLOBS_PHOTOS];
    struct scene_point points[BLOBS];
    char names[BLOBS_PHOTOS][16], sub[FILE_PATH_MAX], path[FILE_PATH_MAX];
    blobs_gauss(&g);
    kit_ok(file_join(sub, dir, "images", &e), e);
    kit_ok(file_mkdir(sub, &e), e);
    kit_ok(render_open(&toy_dev, &r, &e), e);
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    for (size_t i = 0; i < BLOBS_PHOTOS; i++) {
        snprintf(names[i], sizeof names[i], "p%zu.png", i);
        images[i] = (struct scene_image){.name = names[i],
                                         .cam = blobs_camera(i),
                                         .split = i ? SCENE_TRAIN : SCENE_TEST,
                                         .group = (uint32_t)i,
                                         .gps_enu_m = {(double)NAN, (double)NAN, (double)NAN},
                                         .residual_m = (double)NAN};
        kit_ok(file_join(path, sub, names[i], &e), e);
        blobs_photo(r, &m, &images[i].cam, path);
    }
    for (size_t i = 0; i < BLOBS; i++) {
        points[i] = (struct scene_point){.error_px = 0.5f, .track_length = 3};
        for (size_t k = 0; k < 3; k++) {
            points[i].enu_m[k] = (double)g.mean_m[3 * i + k];
            points[i].rgb[k] = (uint8_t)(255.0 * rng_unit(11, 3, 3 * i + k));
        }
    }
    s.images = images;
    s.points = points;
    s.n_points = with_points ? BLOBS : 0;
    kit_ok(scene_write(dir, &s, &e), e);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
}

enum err_code blobs_train(const char *dir, const struct train_config *c, struct train_result *r,
                          struct err *e)
{
    train_result_free(r);
    return train_run(dir, c, r, e);
}

void blobs_same_levels(unsigned finest, const char *a, const char *b)
{
    for (unsigned level = 1; level <= finest; level++) {
        struct ckpt x, y;
        toy_read_level(a, level, &x);
        toy_read_level(b, level, &y);
        assert_int_equal(x.g.n, y.g.n);
        assert_memory_equal(x.g.mean_m, y.g.mean_m, x.g.n * 12);
        assert_memory_equal(x.g.scale_log, y.g.scale_log, x.g.n * 12);
        assert_memory_equal(x.g.quat_wxyz, y.g.quat_wxyz, x.g.n * 16);
        assert_memory_equal(x.g.opacity_logit, y.g.opacity_logit, x.g.n * 4);
        assert_memory_equal(x.g.sh, y.g.sh, x.g.n * 12 * gauss_sh_count(x.g.sh_degree));
        ckpt_free(&x);
        ckpt_free(&y);
    }
}

void trial_open(struct trial *t)
{
    *t = (struct trial){.dir = blobs_dir};
    kit_tmpdir(t->out);
    kit_tmpdir(t->parts);
    t->c = toy_config(&t->a, t->out);
}

void trial_open_in(struct trial *t)
{
    trial_open(t);
    t->dir = t->out;
    t->c.output = NULL;
}

enum err_code trial_run(struct trial *t)
{
    return blobs_train(t->dir, &t->c, &t->r, &t->e);
}

void trial_close(struct trial *t)
{
    kit_rmdir(t->out);
    kit_rmdir(t->parts);
    train_result_free(&t->r);
    arena_free(&t->a);
}

int blobs_open(void **state)
{
    toy_open_device(state);
    kit_tmpdir(blobs_dir);
    blobs_write(blobs_dir, true);
    return 0;
}

int blobs_close(void **state)
{
    kit_rmdir(blobs_dir);
    return toy_close_device(state);
}
