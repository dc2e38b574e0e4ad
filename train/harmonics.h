/* Inside of train/: harmonics in directions that no photograph covers.
 *
 * A survey that looks straight down sees each Gaussian from a narrow cone of directions. The
 * colours in that cone do not determine sixteen harmonics. The rest is noise: it cancels inside the
 * cone and shows outside it. At the end of a level every Gaussian gets the smallest harmonics that
 * give it the same colours from the places of the training photographs (ridge regression):
 *
 *   minimise sum_k |sum_j Y_j(d_k) (c_j - c0_j)|^2 + weight K sum_{j>0} |c_j|^2,
 *
 * d_k the directions from the K photographs that have its mean in their picture to it, c0 the
 * coefficients as trained, j = 0 the base colour, which costs nothing. Photographs from which the
 * Gaussian is hidden count like the others: a map user does not see it from there either.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_HARMONICS_H
#define TRAIN_HARMONICS_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct camera;
struct model;

struct harmonics_rule {
    const struct camera *cams; /* [n_cams], any picture size */
    size_t n_cams;
    double weight;   /* above 0 */
    uint32_t degree; /* of the coefficients that are in use, 0 to 3; those above stay */
};
/* Rows of params, float [groups][planes][16]; means are relative to origin_enu_m. A Gaussian that
 * lies in no photograph keeps its base colour only. Works on all cores; the result does not depend
 * on their number. ERR_MEM. */
enum err_code harmonics_hold(const struct harmonics_rule *r, float *params, size_t n,
                             uint32_t planes, const double origin_enu_m[3], struct err *e) ERR_USE;
/* The same for a model in training, at the end of a level. Moments are kept. ERR_MEM,
 * ERR_DEVICE. */
enum err_code harmonics_level(struct model *m, const struct harmonics_rule *r,
                              struct err *e) ERR_USE;

#endif
