/* Terms of 3DGS-MCMC (Kheradmand et al. 2024) in a training step. A pull on opacities and sizes
 * makes Gaussians vanish that no photograph needs. Noise on positions moves nearly transparent
 * Gaussians. train/relocate.h changes their number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_MCMC_H
#define LOSS_MCMC_H

#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

/* With o the opacities and s the sigmas of n Gaussians:
 *
 *     L = opacity_weight sum_i o_i / n + size_weight sum_ik s_ik / (3 n unit_m) */
struct mcmc_pull {
    double opacity_weight, size_weight;
    double unit_m; /* length of the scene, because the paper's sigmas have no unit */
};
/* mean += rate_per_m Sigma g(o) xi. xi is standard normal, Sigma the covariance in m^2, g(o) = 1 /
 * (1 + exp(100 (o - 0.005))). The paper's rate is 5e5 lr / length of the scene. */
struct mcmc_noise {
    double rate_per_m;
    uint64_t seed, stream; /* the same values give the same noise */
};
struct mcmc; /* compiled kernels */
/* Builds the kernels. Free *out with mcmc_close. ERR_DEVICE, ERR_MEM. */
enum err_code mcmc_open(struct dev *dev, struct mcmc **out, struct err *e) ERR_USE;
void mcmc_close(struct mcmc **c);
/* Enqueues: adds dL/d(sizes, opacity) to extra, float [groups][LAYOUT_PLANES_GEOMETRY][16].
 * ERR_DEVICE. */
enum err_code mcmc_pull_run(struct mcmc *c, const struct render_model *m,
                            const struct mcmc_pull *in, cl_mem extra, struct err *e) ERR_USE;
/* Enqueues: moves the means. ERR_DEVICE. */
enum err_code mcmc_noise_run(struct mcmc *c, const struct render_model *m,
                             const struct mcmc_noise *in, struct err *e) ERR_USE;

/* Reference in double: returns L. scale_log [n][3], logit [n]. grad [n][4] (may be NULL) is added
 * to, sizes first. */
double mcmc_ref_pull(const double *scale_log, const double *logit, size_t n,
                     const struct mcmc_pull *in, double *grad);
/* Reference in double: what is added to the mean of Gaussian i. quat is w x y z, of any length
 * except 0. */
void mcmc_ref_noise(const double scale_log[3], const double quat[4], double logit, uint32_t i,
                    const struct mcmc_noise *in, double add[3]);
#endif
