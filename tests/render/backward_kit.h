/* Shared by tests of the backward pass: small seeded scenes that reach every branch, the
 * reference's gradients as one block, conversion between struct gauss and the device's layout, a
 * model with its optimiser.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_BACKWARD_KIT_H
#define TESTS_BACKWARD_KIT_H

#include "core/splat/camera.h"
#include "render/render.h"
#include "tests/kit.h"

enum { PX_W = 40, PX_H = 32 };

/* ---- scenes: parameters are multiples of 2^-16, so steps of powers of two are exact ---- */

struct view_case { /* free with view_case_free */
    struct gauss g;
    struct camera cam;
    struct render_options o;
    double *rgb_grad;     /* [h][w][3] */
    double offset_weight; /* weight of the mean opacity offset, in frames with appearance */
    double *moments_grad; /* [h][w][3]; NULL: none, see view_case_moments */
};
struct view_case view_case_make(uint64_t seed, size_t n, enum render_aa aa, uint32_t degree);
struct view_case
view_case_saturated(enum render_aa aa); /* alpha at its maximum, and pixels that stop early */
struct view_case
view_case_outside(enum render_aa aa); /* centres beyond the limits of the Jacobian on every side */
struct view_case view_case_needles(enum render_aa aa); /* axes from 0.4 m down to 0.1 mm */
void view_case_free(struct view_case *s);
/* Adds moments of depth to the objective, or sums about depths that are known in most pixels. */
void view_case_moments(struct view_case *s);
void view_case_known(struct view_case *s);
/* Puts another background behind the middle of the picture. */
void view_case_split_background(struct view_case *s);
double *grad_make(size_t n, uint64_t seed); /* standard normal numbers; free with mem_free */
/* Computes sum(rgb * rgb_grad) + offset_weight * mean of y3 in double, and a hash of all decisions
 * on the way. The method holds the direction of view of SH fixed when a mean moves. `rgb_of` [n][3]
 * (may be NULL) then replaces the colours. */
double view_case_objective(const struct view_case *s, const double *rgb_of, uint64_t *signature);
/* The objective's fourth-order central difference with respect to *p. Returns false if every step
 * changes a decision. */
bool view_case_differentiate(struct view_case *s, float *p, const double *rgb_of, double *out);
/* [n][3] colours of the scene now; free with mem_free */
double *view_case_colors(const struct view_case *s);

/* ---- the reference's gradients ---- */

struct grads { /* one block; free with mem_free(block) */
    double *block;
    struct render_ref_grads r;
    size_t count[5];
    double *part[5]; /* mean, scale_log, quat_wxyz, opacity_logit, sh */
};
extern const char *const backward_part[5];
struct grads grads_make(const struct gauss *g);
double rms(const double *v, size_t n);
/* Sets rgb_grad to 0 in pixels where float and double could decide differently. Returns the
 * fraction of pixels that are left. */
double clear_ambiguous(struct view_case *s);

/* ---- device ---- */

struct dev *dev_get(void);                /* opened once a process; close it at the end */
float *floats_read(cl_mem mem, size_t n); /* free with mem_free */
/* The moments of a struct render_adam as floats: n first ones, n second ones; free with mem_free */
float *moments_read(cl_mem mem, size_t n);
/* The same of n words, into out [2][n]. */
void moments_split(const void *words, size_t n, float *out);
/* Sets them; values that 16 bits do not hold lose their lower bits. */
void moments_write(cl_mem mem, const float *first, const float *second, size_t n);
/* How often moments were rounded up, by how far they lay above their lower neighbour. */
enum { MOMENT_STRATA = 8 };
struct moment_rounding {
    size_t n[MOMENT_STRATA];
    double over[MOMENT_STRATA], up[MOMENT_STRATA]; /* sums: what should be, and what was */
};
/* Whether `got` is one of the two neighbours of a moment that is `want` to within `tolerance`.
 * Counts it. */
bool moment_rounds(struct moment_rounding *r, float got, double want, double tolerance);
/* Each stratum has `least` of them, and as many were rounded up as should be, within five standard
 * deviations. */
void moment_rounding_check(const struct moment_rounding *r, size_t least);
/* Draws s and sets dL/d(colour). It uploads s first if m is empty. */
void kernel_forward(struct render *r, const struct view_case *s, struct render_model *m);
/* Converts a buffer in the layout of the parameters to arrays in the layout of gauss. */
void planes_read(const struct render_model *m, cl_mem mem, struct gauss *out);
void gauss_like(const struct gauss *g, struct gauss *out);
float *part_of(struct gauss *g, size_t part);

/* ---- a model with its optimiser ---- */

struct trainer { /* free with trainer_free */
    struct render *r;
    struct render_model m;
    struct render_adam adam;
    struct render_density_stats stats;
};
struct trainer trainer_make(const struct gauss *g);
void trainer_free(struct trainer *t);
/* draws, runs the backward pass and makes an Adam step */
void trainer_step(struct trainer *t, const struct view_case *s);
uint32_t trainer_repaired(const struct trainer *t);

#endif
