/* What the tests of the backward pass share: small seeded scenes that go everywhere, the
 * reference's gradients as one block, moving between struct gauss and the device's layout, a model
 * with its optimiser.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_BACKWARD_KIT_H
#define TESTS_BACKWARD_KIT_H

#include "core/camera.h"
#include "render/render.h"
#include "tests/kit.h"

enum { PX_W = 40, PX_H = 32 };

/* ---- scenes: parameters on a grid of 2^-16, so that steps of powers of two are exact ---- */

struct view_case { /* view_case_free */
    struct gauss g;
    struct camera cam;
    struct render_options o;
    double *rgb_grad;     /* [h][w][3] */
    double offset_weight; /* of the mean opacity offset, in frames with appearance */
    double *moments_grad; /* [h][w][3]; NULL: none, see view_case_moments */
};
struct view_case view_case_make(uint64_t seed, size_t n, enum render_aa aa, uint32_t degree);
struct view_case
view_case_saturated(enum render_aa aa); /* alpha at its maximum, pixels that stop early */
struct view_case
view_case_outside(enum render_aa aa); /* centres beyond the Jacobian's clamp on every side */
struct view_case view_case_needles(enum render_aa aa); /* axes from 0.4 m down to 0.1 mm */
void view_case_free(struct view_case *s);
/* The objective has moments of depth, too. */
void view_case_moments(struct view_case *s);
/* Another background behind the middle of the picture. */
void view_case_split_background(struct view_case *s);
double *grad_make(size_t n, uint64_t seed); /* standard normal; mem_free */
/* sum(rgb * rgb_grad) + offset_weight * mean of y3 in double, and a hash of every decision taken on
 * the way. The method holds the view direction of SH fixed when a mean moves: `rgb_of` (may be
 * NULL) [n][3] replaces the colours then. */
double view_case_objective(const struct view_case *s, const double *rgb_of, uint64_t *signature);
/* Its fourth-order central difference with respect to *p, on the grid; false when every step
 * changes a decision. */
bool view_case_differentiate(struct view_case *s, float *p, const double *rgb_of, double *out);
double *view_case_colors(const struct view_case *s); /* [n][3] as the scene stands; mem_free */

/* ---- the reference's gradients ---- */

struct grads { /* one block: mem_free(block) */
    double *block;
    struct render_ref_grads r;
    size_t count[5];
    double *part[5]; /* mean, scale_log, quat_wxyz, opacity_logit, sh */
};
extern const char *const backward_part[5];
struct grads grads_make(const struct gauss *g);
double rms(const double *v, size_t n);
/* Clear rgb_grad in pixels where float and double could decide differently; the fraction that is
 * left. */
double clear_ambiguous(struct view_case *s);

/* ---- device ---- */

struct dev *dev_get(void);                /* opened once a process; close it at the end */
float *floats_read(cl_mem mem, size_t n); /* mem_free */
/* Draw s (uploading it when m is empty) and set dL/dcolour. */
void kernel_forward(struct render *r, const struct view_case *s, struct render_model *m);
/* A buffer in the layout of the parameters, as arrays in the layout of gauss. */
void planes_read(const struct render_model *m, cl_mem mem, struct gauss *out);
void gauss_like(const struct gauss *g, struct gauss *out);
float *part_of(struct gauss *g, size_t part);

/* ---- a model with its optimiser ---- */

struct trainer { /* trainer_free */
    struct render *r;
    struct render_model m;
    struct render_adam adam;
    struct render_density_stats stats;
};
struct trainer trainer_make(const struct gauss *g);
void trainer_free(struct trainer *t);
void trainer_step(struct trainer *t, const struct view_case *s); /* draw, backward, Adam */
uint32_t trainer_repaired(const struct trainer *t);

#endif
