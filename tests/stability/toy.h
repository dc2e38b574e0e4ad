/* What the stability tests share: a toy scene whose truth is known, a training run in this process
 * that can be looked at between steps, and one line of print for every figure measured.
 *
 * The toy is a patch of ground with seeded Gaussians on it, photographed from above by cameras on
 * rings. Photographs are drawn by the double-precision reference, so no test of a kernel leans on
 * that kernel. Failures here are those of docs/stability.md, F1 to F32.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_STABILITY_TOY_H
#define TESTS_STABILITY_TOY_H

#include "codec/scene.h"
#include "tests/kit.h"
#include "train/config.h"
#include "train/evaluate.h"
#include "train/level.h"

enum { TOY_PHOTOS_MAX = 64 };
#define TOY_HEIGHT_M 10.0 /* of the flight, for poses that are refined */

struct toy { /* toy_spec gives the usual one; change what matters, then toy_write */
    uint64_t seed;
    size_t n;         /* Gaussians of the truth */
    double half_m[3]; /* they fill this box about `center_enu_m` */
    double sigma_min_m, sigma_max_m;
    double center_enu_m[3];
    uint32_t sh_degree;
    size_t photos, test_every; /* photograph i is for tests where i % test_every == 0; 0: none */
    uint32_t width_px, height_px;
    double ring_m, height_m, fov_y_rad; /* cameras: two rings, of ring_m and half of it */
    bool blank;                         /* draw nothing: photographs are what `paint` makes */
    bool drawn;  /* the photographs are there already: write the scene alone, with other poses */
    bool points; /* write the means as sparse points, each seen by all */
    double point_noise_m; /* added to them */
    /* Changes photograph i, drawn as rgb [h][w][3]: exposure, a passing car. */
    void (*paint)(void *user, size_t i, const struct camera *cam, double *rgb);
    /* Changes the pose that the scene says of photograph i; the picture was taken at the true one.
     */
    void (*pose)(void *user, size_t i, struct camera *cam);
    void *user;
};

/* 60 blobs on 12 x 12 m, 12 photographs of 64 x 48 px, every fourth for tests. */
struct toy toy_spec(void);
/* The truth. gauss_free it. */
void toy_gauss(const struct toy *t, struct gauss *out);
struct camera toy_camera(const struct toy *t, size_t i);
/* The picture of g in double precision, 2-D anti-aliased, black behind: rgb[h][w][3]. */
void toy_draw(const struct gauss *g, const struct camera *cam, double *rgb);
/* A scene folder (dir exists) with photographs of g as PNG. */
void toy_write(const char *dir, const struct toy *t, const struct gauss *g);

/* Options for a toy: 300 steps, three levels at 1/2, 1, 1, budgets that bind, results to `out`
 * (NULL: into the scene). */
struct train_config toy_config(struct arena *a, const char *out);

/* The one device of a test program; kernels are built once. Use as group setup and teardown. */
extern struct dev toy_dev;
int toy_open_device(void **state);
int toy_close_device(void **state);

/* A run of the scene as one cell, step by step. `cfg` is borrowed. toy_run_close it. */
struct toy_run {
    struct scene scene;
    uint32_t *images, *tests;
    size_t n_images, n_tests;
    struct level level;
};
/* Starts from the scene's points. */
void toy_run_open(struct toy_run *r, const char *dir, const struct train_config *cfg);
/* Starts from these Gaussians (means relative to any origin). */
void toy_run_open_from(struct toy_run *r, const char *dir, const struct train_config *cfg,
                       const struct gauss *first);
/* Goes on from a state that state_save wrote. */
void toy_run_load(struct toy_run *r, const char *dir, const struct train_config *cfg,
                  const char *state_path);
/* n steps of the level in work; fails the test when a step does. Loss of the last one, NaN for 0.
 */
double toy_run_steps(struct toy_run *r, uint32_t n);
/* To the end of the level in work. */
double toy_run_level(struct toy_run *r);
void toy_run_next(struct toy_run *r); /* hand over to the next level */
/* Mean over the test photographs (training ones when there are none) at 1 / downsample. */
struct evaluate_score toy_run_score(struct toy_run *r, double downsample);
void toy_run_close(struct toy_run *r);

/* PSNR, dB, of two pictures of n values in 0..1; 99 where they are equal. */
double toy_psnr(const float *a, const float *b, size_t n);
double toy_psnr_d(const double *a, const double *b, size_t n);
/* Largest |a - b|. */
double toy_max_diff(const float *a, const float *b, size_t n);
/* All parameters finite and no zero quaternion. */
bool toy_finite(const struct gauss *g);

#define toy_figure kit_figure

#endif
