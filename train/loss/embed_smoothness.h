/* The loss that makes embeddings of neighbours alike: embed_smoothness.c on the host,
 * embed_smoothness_step.c for a model in training.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_EMBED_SMOOTHNESS_H
#define TRAIN_LOSS_EMBED_SMOOTHNESS_H

#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

/* Gaussians that are compared with their neighbours at a step of training, and how many nearest
 * ones, itself included: REUrbanGS. */
enum { EMBED_SMOOTHNESS_SAMPLES = 20480, EMBED_SMOOTHNESS_NEIGHBOURS = 16 };

/* The sum goes over `samples` Gaussians i drawn at random, or all if there are fewer. n_0 .. n_k-1
 * are the k nearest of i by distance, itself included, and e^ = e / |e|:
 *
 *     L = weight / (M C(k, 2)) sum_i sum_{a < b} w_ib (1 - e^_{n_a} . e^_{n_b}),
 *     w_ib = exp(-falloff |mu_i - mu_{n_b}|^2) */
struct embed_smoothness_input {
    const float *mean_m; /* [n][3] */
    /* Not normalised. Value c of row i is embed[i / 16 * embed_group + i % 16 * embed_lane + c *
     * embed_next], as in a model; 16 len, len, 1 are the strides of [n][len]. */
    const float *embed;
    size_t embed_group, embed_lane, embed_next;
    size_t n, len, samples, neighbours;
    double falloff, weight; /* falloff: 1 / m^2 */
    uint64_t seed, stream;
};
/* Computes the loss now; embed_smoothness_rows then gives the gradient in pieces. The same input
 * gives the same bits, for any number of threads and any size of pieces. The input is borrowed
 * until embed_smoothness_close, which must be called also after an error. ERR_MEM. ERR_LIMIT: more
 * than 2^32 - 1 Gaussians. */
struct embed_smoothness;
enum err_code embed_smoothness_open(const struct embed_smoothness_input *in,
                                    struct embed_smoothness **out, double *loss,
                                    struct err *e) ERR_USE;
/* Writes grad [count][len]: dL/d(embed) of the rows first .. first + count - 1. */
void embed_smoothness_rows(const struct embed_smoothness *w, size_t first, size_t count,
                           float *grad);
void embed_smoothness_close(struct embed_smoothness **w);

struct embed_smoothness_step; /* compiled kernels, and a buffer */
/* Builds the kernel. Free *out with embed_smoothness_step_close. ERR_DEVICE, ERR_MEM. */
enum err_code embed_smoothness_step_open(struct dev *dev, struct embed_smoothness_step **out,
                                         struct err *e) ERR_USE;
void embed_smoothness_step_close(struct embed_smoothness_step **s);
/* Adds the loss's gradient to Adam's moments of the embeddings; the next render_backward_step
 * applies it. The function itself fills the fields of `like` that come from the model. A model
 * without embeddings has loss 0. It waits for the device. ERR_ARG: beta1 or beta2 is 0. ERR_MEM,
 * ERR_DEVICE. */
enum err_code embed_smoothness_step_run(struct embed_smoothness_step *s,
                                        const struct render_model *m,
                                        const struct render_adam *adam,
                                        const struct embed_smoothness_input *like, double *loss,
                                        struct err *e) ERR_USE;
#endif
