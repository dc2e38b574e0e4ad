/* Inside of train/: regularizers, terms of the loss that are not about the photograph's colours,
 * and the 3-D filter of Mip-Splatting. Equations, sources and measurements: docs/regularizers.md.
 *
 * Before a step's colours are drawn, regularizer_step puts what they say about mean, size, rotation and
 * opacity into one buffer that the fused backward pass adds to its gradients; densification
 * statistics never see it. Each part has kernels, and a reference in double for its test.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REGULARIZER_H
#define TRAIN_REGULARIZER_H

#include "render/render.h"

struct level;
struct photo;
struct regularizer; /* of one level: buffers and compiled kernels, made on first use */

/* What the configuration asks for at this step; sets l->adam.extra_grad (NULL: nothing) and, with
 * Mip-Splatting, l->model.filter. Draws frames of its own: call before the step's render_forward.
 */
enum err_code regularizer_step(struct level *l, uint32_t step, const struct photo *photo,
                               struct err *e) ERR_USE;
void regularizer_free(struct regularizer **r);
/* With Mip-Splatting: compute l->model.filter if it is not that of the Gaussians as they are. */
enum err_code regularizer_filter(struct level *l, struct err *e) ERR_USE;

#endif
