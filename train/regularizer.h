/* Internal to train/: regularizers, the terms of the loss that do not compare colours with the
 * photograph. Equations, sources and measurements: docs/training.md.
 *
 * regularizer_step runs before the step's colours are drawn. It writes the gradients of mean, size,
 * rotation and opacity into one buffer. The fused backward pass adds that buffer to its own
 * gradients. The statistics of densification do not contain these gradients. Each term has kernels,
 * and a reference in double precision for its test.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REGULARIZER_H
#define TRAIN_REGULARIZER_H

#include <stdbool.h>

#include "core/err.h"

struct cell;
struct gallery;
struct model;
struct photo;
struct regularizer; /* buffers and compiled kernels */
struct site;
struct stage;
struct timing;
struct train_config;

struct regularizer_input { /* input of one step; all borrowed */
    const struct gallery *gallery;
    const struct site *site;
    const struct stage *at;
    const struct photo *photo;
    struct timing *timing; /* counts the seconds of embedding smoothness under its own name */
};
/* Opens the kernels and depth maps that the options want at any step. *own is NULL at first; if it
 * is open already, nothing is done. Free it with regularizer_free. ERR_MEM, ERR_DEVICE. ERR_DATA:
 * no depth map can be used. Errors of the maps' files. */
enum err_code regularizer_open(struct regularizer **own, const struct gallery *g,
                               const struct site *site, struct err *e) ERR_USE;
void regularizer_free(struct regularizer **r);
/* Whether a term reaches Gaussians that a step's photograph cannot show, other than the loss on
 * sizes, which is that of the Gaussians in its frustum. */
bool regularizer_reaches_all(const struct gallery *g, const struct site *site);
/* The same without what appearance adds. */
bool regularizer_moves_all(const struct train_config *cfg, const struct cell *cell);
/* Computes the terms that act at the current step, and sets m->adam.extra_grad (NULL: none). It
 * draws frames, so call it before the step's render_forward. ERR_MEM, ERR_DEVICE. ERR_FORMAT,
 * ERR_NOENT, ERR_DATA: a depth map cannot be read. */
enum err_code regularizer_step(struct regularizer *r, struct model *m,
                               const struct regularizer_input *in, struct err *e) ERR_USE;
/* Call it after the step. With --strategy mcmc it adds noise to the means. ERR_DEVICE. */
enum err_code regularizer_shake(struct regularizer *r, const struct model *m,
                                const struct train_config *cfg, const struct cell *cell,
                                const struct stage *at, struct err *e) ERR_USE;

#endif
