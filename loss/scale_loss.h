/* The loss on sizes: it shrinks Gaussians that are larger than a building, and needles.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_SCALE_LOSS_H
#define LOSS_SCALE_LOSS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

/* With s the sigmas and r_i = max_k s_ik / (median_k s_ik + 1e-8):
 *
 *     L = weight (sum_{s_ik > s_max} s_ik / (n + 1) + sum_{r_i > r_max} r_i / (m + 1))
 *         + flat_weight / (2 N) sum_i log(1 + (min_k s_ik / flat_m)^2)
 *
 * n and m are the numbers of terms of the two sums and are held fixed; N is the number of
 * Gaussians. The last term makes Gaussians flat. Its pull on log s is the same for all that are
 * thicker than flat_m, and goes to 0 below (PGSR, Chen et al. 2024, presses the least axis itself).
 * Source of the others: REUrbanGS (2025), section on regularization. Over a part of the ground
 * s_max can be smaller, and the last term can be limited to a part (struct scale_loss_ground). */
enum scale_loss_part { SCALE_LOSS_LIMITED = 1, SCALE_LOSS_FLAT = 2 };
struct scale_loss_ground { /* borrowed */
    const uint8_t *parts;  /* [ny][nx] of enum scale_loss_part, row 0 is the southernmost */
    size_t nx, ny;
    double corner_m[2], cell_m; /* south-west corner, ENU; edge of a cell */
    double s_max_m;             /* s_max there; INFINITY: the same as elsewhere */
};
struct scale_loss_input {
    double s_max_m, r_max, weight;
    double flat_weight, flat_m; /* flat_m is read where flat_weight > 0 */
    /* NULL: the outer s_max_m applies everywhere, and so does flat_weight; the first run fixes the
     * grid */
    const struct scale_loss_ground *ground;
};
struct scale_loss_value {
    double total;  /* weighted */
    uint32_t n, m; /* n: axes that are too long; m: needles */
};
struct scale_loss; /* compiled kernels */
/* Builds the kernels. Free *out with scale_loss_close. ERR_DEVICE, ERR_MEM. */
enum err_code scale_loss_open(struct dev *dev, struct scale_loss **out, struct err *e) ERR_USE;
void scale_loss_close(struct scale_loss **s);
/* Enqueues: writes dL/d(geometry) to all of extra, float [groups][LAYOUT_PLANES_GEOMETRY][16]. With
 * sizes_only it writes only the sizes' planes, [groups][3][16]. With m->list the loss is that of
 * the listed groups, and extra is in their order. It does not wait for the device.
 * ERR_DEVICE. */
enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, bool sizes_only, cl_mem extra,
                             struct err *e) ERR_USE;
/* Waits, and reads the value of the last run. ERR_DEVICE. */
enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out,
                              struct err *e) ERR_USE;
/* Reference in double. mean [n][3] is in ENU metres, NULL if in->ground is. scale_log [n][3]. grad
 * [n][3] (may be NULL) is overwritten. */
struct scale_loss_value scale_loss_ref_run(const double *mean, const double *scale_log, size_t n,
                                           const struct scale_loss_input *in, double *grad);
#endif
