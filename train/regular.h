/* Inside of train/: regularisers, terms of the loss that are not about the photograph's colours,
 * and the 3-D filter of Mip-Splatting. Equations, sources and measurements: docs/regularisers.md.
 *
 * Before a step's colours are drawn, regular_step puts what they say about mean, size, rotation and
 * opacity into one buffer that the fused backward pass adds to its gradients; densification
 * statistics never see it. Each part has kernels, and a reference in double for its test.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REGULAR_H
#define TRAIN_REGULAR_H

#include "render/render.h"

struct level;
struct feed_photo;
struct regular; /* of one level: buffers and compiled kernels, made on first use */

/* What the configuration asks for at this step; sets l->adam.extra_grad (NULL: nothing) and, with
 * Mip-Splatting, l->model.filter. Draws frames of its own: call before the step's render_forward.
 */
enum err_code regular_step(struct level *l, uint32_t step, const struct feed_photo *photo,
                           struct err *e) ERR_USE;
void regular_free(struct regular **r);
/* With Mip-Splatting: compute l->model.filter if it is not that of the Gaussians as they are. */
enum err_code regular_filter(struct level *l, struct err *e) ERR_USE;

/* ---- scale_loss.c: nothing larger than a building, no needles
 * ------------------------------------ */

/* With s the sigmas, r_i = max_k s_ik / (median_k s_ik + 1e-8):
 *   L = weight (sum_{s_ik > s_max} s_ik / (n + 1) + sum_{r_i > r_max} r_i / (m + 1)),
 * n and m the numbers of terms, held fixed. REUrbanGS (2025), section on regularisation. */
struct scale_loss_input {
    double s_max_m, r_max, weight;
};
struct scale_loss_value {
    double total;  /* weighted */
    uint32_t n, m; /* axes that are too long, needles */
};
struct scale_loss; /* compiled kernels */
enum err_code scale_loss_open(struct dev *dev, struct scale_loss **out, struct err *e) ERR_USE;
void scale_loss_close(struct scale_loss **s);
/* Enqueue: write dL/d(planes 0-10) into extra, float [groups][11][16], all of it. */
enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, cl_mem extra,
                             struct err *e) ERR_USE;
/* Wait and read the value of the last run. */
enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out,
                              struct err *e) ERR_USE;
/* In double; scale_log [n][3], grad [n][3] (may be NULL) is written. */
struct scale_loss_value scale_loss_ref_run(const double *scale_log, size_t n,
                                           const struct scale_loss_input *in, double *grad);

/* ---- mip.c: the 3-D filter of Mip-Splatting
 * ------------------------------------------------------ */

struct mip; /* compiled kernels and the cameras */
enum err_code mip_open(struct dev *dev, struct mip **out, struct err *e) ERR_USE;
void mip_close(struct mip **m);
/* Compute model->filter (made when NULL) from the cameras: f_i = sqrt(0.2) min z / f_max, in m. */
enum err_code mip_run(struct mip *m, struct render_model *model, const struct camera *cams,
                      size_t n_cams, struct err *e) ERR_USE;
/* In double; f [g->n]. */
void mip_ref_filter(const struct gauss *g, const struct camera *cams, size_t n_cams, double *f);
/* Widen by the filter: scale_log and opacity_logit become those of what is drawn. */
void mip_fold(struct gauss *g, const float *filter);
void mip_fold_one(double f, double scale_log[3], double *opacity_logit);
/* Gradients of the folded parameters (in) to those of the raw ones (out), at the raw ones. */
void mip_fold_grad(double f, const double scale_log[3], double opacity_logit, double g_scale[3],
                   double *g_opacity);

#endif
