/* The 3-D filter of Mip-Splatting (Yu 2024).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_MIP_H
#define LOSS_MIP_H

#include <stddef.h>

#include "core/camera.h"
#include "core/gauss.h"
#include "render/render.h"

struct mip; /* compiled kernels and the cameras */
/* Builds the kernels. Free *out with mip_close. ERR_DEVICE, ERR_MEM. */
enum err_code mip_open(struct dev *dev, struct mip **out, struct err *e) ERR_USE;
void mip_close(struct mip **m);
/* Computes model->filter from the cameras: f_i = sqrt(0.2) min z / f_max, in m. It allocates the
 * buffer if that is NULL, and does not wait for the device. ERR_ARG: there are no cameras. ERR_MEM,
 * ERR_DEVICE. */
enum err_code mip_run(struct mip *m, struct render_model *model, const struct camera *cams,
                      size_t n_cams, struct err *e) ERR_USE;
/* Reference in double; f [g->n]. */
void mip_ref_filter(const struct gauss *g, const struct camera *cams, size_t n_cams, double *f);
/* Fold the filter into a model: scale_log and opacity_logit become those that are drawn. */
void mip_fold(struct gauss *g, const float *filter);
void mip_fold_one(double f, double scale_log[3], double *opacity_logit);
/* Converts gradients of the folded parameters (in) to those of the raw parameters (out). scale_log
 * and opacity_logit are raw. */
void mip_fold_grad(double f, const double scale_log[3], double opacity_logit, double g_scale[3],
                   double *g_opacity);
#endif
