/* The loss on sizes: nothing larger than a building, no needles.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_SCALE_LOSS_H
#define LOSS_SCALE_LOSS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

/* With s the sigmas, r_i = max_k s_ik / (median_k s_ik + 1e-8):
 *   L = weight (sum_{s_ik > s_max} s_ik / (n + 1) + sum_{r_i > r_max} r_i / (m + 1)),
 * n and m the numbers of terms, held fixed. REUrbanGS (2025), section on regularization. Over a
 * part of the ground s_max can be smaller. */
struct scale_loss_ground { /* borrowed */
    const uint8_t *inside; /* [ny][nx], row 0 is the southernmost: not 0 where s_max_m holds */
    size_t nx, ny;
    double corner_m[2], cell_m; /* south-west corner, ENU; edge of a cell */
    double s_max_m;
};
struct scale_loss_input {
    double s_max_m, r_max, weight;
    const struct scale_loss_ground *ground; /* NULL: s_max_m everywhere; the grid is that of the
                                             * first run */
};
struct scale_loss_value {
    double total;  /* weighted */
    uint32_t n, m; /* axes that are too long, needles */
};
struct scale_loss; /* compiled kernels */
/* Build the kernels. scale_loss_close it. ERR_DEVICE, ERR_MEM. */
enum err_code scale_loss_open(struct dev *dev, struct scale_loss **out, struct err *e) ERR_USE;
void scale_loss_close(struct scale_loss **s);
/* Enqueue: write dL/d(geometry) into extra, float [groups][LAYOUT_PLANES_GEOMETRY][16], all of it;
 * with sizes_only dL/d(planes 3-5), [groups][3][16]. Does not wait for the device. ERR_DEVICE. */
enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, bool sizes_only, cl_mem extra,
                             struct err *e) ERR_USE;
/* Wait and read the value of the last run. ERR_DEVICE. */
enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out,
                              struct err *e) ERR_USE;
/* In double; mean [n][3] in ENU metres (NULL where in->ground is), scale_log [n][3]; grad [n][3]
 * (may be NULL) is written. */
struct scale_loss_value scale_loss_ref_run(const double *mean, const double *scale_log, size_t n,
                                           const struct scale_loss_input *in, double *grad);
#endif
