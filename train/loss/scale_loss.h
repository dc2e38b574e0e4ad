/* The loss on sizes: it shrinks Gaussians that are larger than a building, and needles.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_SCALE_LOSS_H
#define TRAIN_LOSS_SCALE_LOSS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/render.h"
#include "train/loss/ground_parts.h"

/* With s the sigmas and r_i = max_k s_ik / (median_k s_ik + 1e-8):
 *
 *     L = weight (sum_{s_ik > s_max} s_ik / (n + 1) + sum_{r_i > r_max} r_i / (m + 1))
 *
 * n and m are the numbers of terms of the two sums and are held fixed. s_max is smaller on a part
 * of the ground. Source: REUrbanGS (2025), section on regularization. */
struct scale_loss_input {
    double s_max_m, r_max, weight;
    /* NULL: s_max_m applies everywhere; the first run fixes the grid */
    const struct ground_parts *ground;
    double s_near_m; /* s_max on GROUND_PART_LIMITED; INFINITY: the same as elsewhere */
};
struct scale_loss_value {
    double total;  /* weighted */
    uint32_t n, m; /* n: axes that are too long; m: needles */
};
struct scale_loss; /* compiled kernels */
/* Builds the kernels. Free *out with scale_loss_close. ERR_DEVICE, ERR_MEM. */
enum err_code scale_loss_open(struct dev *dev, struct scale_loss **out, struct err *e) ERR_USE;
void scale_loss_close(struct scale_loss **s);
/* Enqueues: adds dL/d(sizes) to extra, float [groups][LAYOUT_PLANES_SCALE][16]; where that is
 * fresh, every value is written instead. With m->list the loss is that of the listed groups, and
 * extra is in their order. It does not wait for the device. ERR_DEVICE. */
enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, bool fresh, cl_mem extra,
                             struct err *e) ERR_USE;
/* Waits, and reads the value of the last run. ERR_DEVICE. */
enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out,
                              struct err *e) ERR_USE;
struct scale_loss_gauss {    /* for the reference */
    const double *mean;      /* [n][3] ENU metres; NULL if there is no ground */
    const double *scale_log; /* [n][3] */
    size_t n;
};
/* Reference in double. grad [n][3] (may be NULL) is overwritten. */
struct scale_loss_value scale_loss_ref_run(const struct scale_loss_gauss *g,
                                           const struct scale_loss_input *in, double *grad);
#endif
