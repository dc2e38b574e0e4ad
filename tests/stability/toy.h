/* Shared by the stability tests: a toy scene with known truth, a training run in this process that
 * can be inspected between steps, and a line of output for every measured number.
 *
 * The toy is a patch of ground with seeded Gaussians, photographed from above by cameras on rings.
 * Photographs are drawn by the double-precision reference, so that no kernel is tested against
 * itself. Failures F1 to F32 are those of lab/STABILITY.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_STABILITY_TOY_H
#define TESTS_STABILITY_TOY_H

#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "tests/kit.h"
#include "train/base/config.h"
#include "train/level.h"
#include "train/photographs/evaluate.h"

enum { TOY_PHOTOS_MAX = 64 };
#define TOY_HEIGHT_M 10.0 /* height of the flight, for poses that are refined */

struct toy { /* begin with toy_spec, change members, then call toy_write */
    uint64_t seed;
    size_t n;         /* number of Gaussians of the truth */
    double half_m[3]; /* half-size of the box about `center_enu_m` that they fill */
    double sigma_min_m, sigma_max_m;
    double center_enu_m[3];
    uint32_t sh_degree;
    /* photograph i is a test photograph if i % test_every == 0; 0: none */
    size_t photos, test_every;
    uint32_t width_px, height_px;
    double ring_m, height_m, fov_y_rad; /* cameras: two rings, with radii ring_m and half of it */
    bool blank;                         /* draw nothing: photographs are only what `paint` makes */
    bool drawn;           /* photographs exist already: write only the scene, with other poses */
    bool points;          /* write the means as sparse points, which all photographs see */
    double point_noise_m; /* noise added to the points */
    /* Changes photograph i, drawn as rgb [h][w][3]: exposure, a passing car. */
    void (*paint)(void *user, size_t i, const struct camera *cam, double *rgb);
    /* Changes the pose of photograph i in the scene; the picture keeps the true one. */
    void (*pose)(void *user, size_t i, struct camera *cam);
    void *user;
};

/* 60 blobs on 12 x 12 m, 12 photographs of 64 x 48 px, every fourth for tests. */
struct toy toy_spec(void);
/* The Gaussians of the truth. Free *out with gauss_free. */
void toy_gauss(const struct toy *t, struct gauss *out);
struct camera toy_camera(const struct toy *t, size_t i);
/* The picture of g in double precision, with 2-D anti-aliasing and a black background: rgb
 * [h][w][3]. */
void toy_draw(const struct gauss *g, const struct camera *cam, double *rgb);
/* Writes a scene into the existing folder `dir`, with photographs of g as PNG. */
void toy_write(const char *dir, const struct toy *t, const struct gauss *g);

/* Options for a toy: 300 steps, three levels at 1/2, 1, 1, budgets that bind, results to `out`
 * (NULL: into the scene). */
struct train_config toy_config(struct arena *a, const char *out);

/* The only device of a test program, so kernels are built once. Use these as group setup and
 * teardown. */
extern struct dev toy_dev;
/* Reads a finished level of a run without cells. Free *out with ckpt_free. */
void toy_read_level(const char *dir, unsigned level, struct ckpt *out);

int toy_open_device(void **state);
int toy_close_device(void **state);

/* A run of the scene as one cell, step by step. `cfg` is borrowed. Free it with toy_run_close. */
struct toy_run {
    struct scene scene;
    uint32_t *images, *tests;
    size_t n_images, n_tests;
    struct level level;
};
/* Starts from the scene's points. */
void toy_run_open(struct toy_run *r, const char *dir, const struct train_config *cfg);
/* Starts from these Gaussians; their origin may be any. */
void toy_run_open_from(struct toy_run *r, const char *dir, const struct train_config *cfg,
                       const struct gauss *first);
/* Continues from a state that state_save wrote. */
void toy_run_load(struct toy_run *r, const char *dir, const struct train_config *cfg,
                  const char *state_path);
/* Makes n steps of the current level; a failed step fails the test. Returns the loss of the last
 * step; NaN for n = 0. */
double toy_run_steps(struct toy_run *r, uint32_t n);
/* Runs to the end of the current level. */
double toy_run_level(struct toy_run *r);
void toy_run_next(struct toy_run *r); /* goes on to the next level */
/* Mean scores over the test photographs at 1 / downsample. Without test photographs it uses
 * training ones. */
struct evaluate_score toy_run_score(struct toy_run *r, double downsample);
void toy_run_close(struct toy_run *r);

/* PSNR in dB of two pictures with n values in 0..1; 99 if they are equal. */
double toy_psnr(const float *a, const float *b, size_t n);
double toy_psnr_d(const double *a, const double *b, size_t n);
/* Largest |a - b|. */
double toy_max_diff(const float *a, const float *b, size_t n);
/* Returns whether all parameters are finite and no quaternion is 0. */
bool toy_finite(const struct gauss *g);

#define toy_figure kit_figure

#endif
