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
 *         + level_weight / N sum_i (1 - n_iz^2)
 *
 * n and m are the numbers of terms of the two sums and are held fixed; N is the number of
 * Gaussians, n_i the direction of the least axis. The third term makes Gaussians flat. Its pull on
 * log s is the same for all that are thicker than flat_m, and goes to 0 below (PGSR, Chen et al.
 * 2024, presses the least axis itself). The last term turns flat Gaussians level, and acts on their
 * rotations alone. Source of the others: REUrbanGS (2025), section on regularization. Each applies
 * to a part of the ground (struct scale_loss_ground): a smaller s_max, the third term, the last. */
enum scale_loss_part { SCALE_LOSS_LIMITED = 1, SCALE_LOSS_FLAT = 2, SCALE_LOSS_LEVEL = 4 };
struct scale_loss_ground { /* borrowed */
    const uint8_t *parts;  /* [ny][nx] of enum scale_loss_part, row 0 is the southernmost */
    size_t nx, ny;
    double corner_m[2], cell_m; /* south-west corner, ENU; edge of a cell */
    double s_max_m;             /* s_max there; INFINITY: the same as elsewhere */
};
struct scale_loss_input {
    double s_max_m, r_max, weight;
    double flat_weight, flat_m; /* flat_m is read where flat_weight > 0 */
    double level_weight;
    /* NULL: the outer s_max_m applies everywhere, flat_weight too, and level_weight nowhere; the
     * first run fixes the grid */
    const struct scale_loss_ground *ground;
    bool value; /* scale_loss_read is wanted; without it the first pass only counts */
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
 * shapes_only it writes only the planes of sizes and rotations, [groups][LAYOUT_PLANES_SHAPE][16].
 * With m->list the loss is that of the listed groups, and extra is in their order. It does not wait
 * for the device.
 * ERR_DEVICE. */
enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, bool shapes_only, cl_mem extra,
                             struct err *e) ERR_USE;
/* Waits, and reads the value of the last run, which had `value`. ERR_DEVICE. */
enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out,
                              struct err *e) ERR_USE;
struct scale_loss_gauss {    /* for the reference */
    const double *mean;      /* [n][3] ENU metres; NULL if there is no ground */
    const double *scale_log; /* [n][3] */
    const double *quat;      /* [n][4] w x y z of any length; NULL if there is no level_weight */
    size_t n;
};
/* Reference in double. grad [n][7] (may be NULL), sizes and then rotations, is overwritten. */
struct scale_loss_value scale_loss_ref_run(const struct scale_loss_gauss *g,
                                           const struct scale_loss_input *in, double *grad);
#endif
