/* The terms on the least axis of Gaussians: they are flat, and at the rim they lie level.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_FLAT_LOSS_H
#define TRAIN_LOSS_FLAT_LOSS_H

#include <stdbool.h>
#include <stddef.h>

#include "render/render.h"
#include "train/loss/ground_parts.h"

/* With s the sigmas, N the number of Gaussians, and n_i the direction of the least axis:
 *
 *     L = flat_weight / (2 N) sum_i log(1 + (min_k s_ik / flat_m)^2)    on GROUND_PART_FLAT
 *         + level_weight / N sum_i (1 - n_iz^2)                         on GROUND_PART_LEVEL
 *
 * The first term makes Gaussians flat. Its gradient in log s is the same for all that are thicker
 * than flat_m, and goes to 0 below (PGSR, Chen et al. 2024, penalises the least axis itself). The
 * second turns flat Gaussians level, and acts on their rotations alone. */
struct flat_loss_input {
    double flat_weight, flat_m; /* flat_m is read where flat_weight > 0 */
    double level_weight;
    /* NULL: all ground is GROUND_PART_FLAT; the first run fixes the grid */
    const struct ground_parts *ground;
};
struct flat_loss; /* compiled kernel */
/* Builds the kernel. Free *out with flat_loss_close. ERR_DEVICE, ERR_MEM. */
enum err_code flat_loss_open(struct dev *dev, struct flat_loss **out, struct err *e) ERR_USE;
void flat_loss_close(struct flat_loss **s);
/* Enqueues: adds dL/d(sizes, rotations) to extra, as scale_loss_run. ERR_DEVICE. */
enum err_code flat_loss_run(struct flat_loss *s, const struct render_model *m,
                            const struct flat_loss_input *in, bool fresh, cl_mem extra,
                            struct err *e) ERR_USE;
struct flat_loss_gauss {     /* for the reference */
    const double *mean;      /* [n][3] ENU metres; NULL if there is no ground */
    const double *scale_log; /* [n][3] */
    const double *quat;      /* [n][4] w x y z of any length; NULL if there is no level_weight */
    size_t n;
};
/* Reference in double: returns L. grad [n][7] (may be NULL), sizes and then rotations, is
 * overwritten. */
double flat_loss_ref_run(const struct flat_loss_gauss *g, const struct flat_loss_input *in,
                         double *grad);
#endif
