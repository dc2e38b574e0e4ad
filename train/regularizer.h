/* Inside of train/: regularizers, terms of the loss that are not about the photograph's colours,
 * and when the 3-D filter of Mip-Splatting is computed anew. Equations, sources and measurements:
 * docs/regularizers.md.
 *
 * Before a step's colours are drawn, regularizer_step puts what they say about mean, size, rotation
 * and opacity into one buffer that the fused backward pass adds to its gradients; densification
 * statistics never see it. Each part has kernels, and a reference in double for its test.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REGULARIZER_H
#define TRAIN_REGULARIZER_H

#include <stdint.h>

#include "core/err.h"

struct context;
struct model;
struct photo;
struct regularizer; /* buffers and compiled kernels */

/* What the configuration asks for at this step (1-based); sets m->adam.extra_grad (NULL: nothing)
 * and, with Mip-Splatting, the model's filter. Draws frames of its own: call before the step's
 * render_forward. *own: NULL at first, made when something acts; regularizer_free it. ERR_MEM,
 * ERR_DEVICE; ERR_FORMAT, ERR_NOENT, ERR_DATA: a depth map cannot be used. */
enum err_code regularizer_step(struct regularizer **own, struct model *m, struct context *ctx,
                               uint32_t step, const struct photo *photo, struct err *e) ERR_USE;
/* After the step: with --strategy mcmc the means are shaken. ERR_MEM, ERR_DEVICE. */
enum err_code regularizer_shake(struct regularizer **own, const struct model *m,
                                const struct context *ctx, uint32_t step, struct err *e) ERR_USE;
void regularizer_free(struct regularizer **r);

#endif
