/* What 3DGS-MCMC (Kheradmand et al. 2024) adds to a step. A pull on opacities and sizes makes
 * Gaussians that no photograph needs vanish. Noise on positions moves nearly transparent Gaussians
 * to other places. train/relocate.h changes their number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_MCMC_H
#define LOSS_MCMC_H

#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

/* With o the opacities and s the sigmas of n Gaussians:
 *   L = opacity_weight sum_i o_i / n + size_weight sum_ik s_ik / (3 n unit_m). */
struct mcmc_pull {
    double opacity_weight, size_weight;
    double unit_m; /* length of the scene: the paper's sigmas have no unit */
};
/* mean += rate_per_m Sigma g(o) xi, xi standard normal, Sigma the covariance in m^2,
 * g(o) = 1 / (1 + exp(100 (o - 0.005))). The paper's rate 5e5 lr / length of the scene. */
struct mcmc_noise {
    double rate_per_m;
    uint64_t seed, stream; /* the same ones: the same noise */
};
struct mcmc; /* compiled kernels */
/* Build the kernels. mcmc_close it. ERR_DEVICE, ERR_MEM. */
enum err_code mcmc_open(struct dev *dev, struct mcmc **out, struct err *e) ERR_USE;
void mcmc_close(struct mcmc **c);
/* Enqueue: add dL/d(sizes, opacity) to extra, float [groups][LAYOUT_PLANES_GEOMETRY][16].
 * ERR_DEVICE. */
enum err_code mcmc_pull_run(struct mcmc *c, const struct render_model *m,
                            const struct mcmc_pull *in, cl_mem extra, struct err *e) ERR_USE;
/* Enqueue: move the means. ERR_DEVICE. */
enum err_code mcmc_noise_run(struct mcmc *c, const struct render_model *m,
                             const struct mcmc_noise *in, struct err *e) ERR_USE;

/* In double: the value of L; scale_log [n][3], logit [n]; grad [n][4] is added to, sizes first, and
 * may be NULL. */
double mcmc_ref_pull(const double *scale_log, const double *logit, size_t n,
                     const struct mcmc_pull *in, double *grad);
/* In double: what is added to the mean of Gaussian i; quat w x y z of any length, not 0. */
void mcmc_ref_noise(const double scale_log[3], const double quat[4], double logit, uint32_t i,
                    const struct mcmc_noise *in, double add[3]);
#endif
