/* Internal to train/: harmonics in directions that no photograph covers.
 *
 * A survey that looks straight down sees each Gaussian from a narrow cone of directions. The
 * colours in that cone do not determine sixteen harmonics. Their undetermined part is noise, which
 * cancels inside the cone and shows outside it. At the end of a level every Gaussian gets the
 * smallest harmonics with the same colours from the places of the training photographs (ridge
 * regression):
 *
 *     minimise sum_k |sum_j Y_j(d_k) (c_j - c0_j)|^2 + weight K sum_{j>0} |c_j|^2
 *
 * d_k are directions to the Gaussian from the K photographs that have its mean in their picture. c0
 * are the trained coefficients. j = 0 is the base colour, which has no penalty. Photographs count
 * even if something hides the Gaussian: a map user does not see it from there either.
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
    uint32_t degree; /* of the coefficients in use, 0 to 3; higher ones are not changed */
};
/* Changes n rows of params, float [groups][planes][16], with means relative to origin_enu_m. A
 * Gaussian in no photograph keeps only its base colour. It uses all cores; the result does not
 * depend on their number. ERR_MEM. */
enum err_code harmonics_hold(const struct harmonics_rule *r, float *params, size_t n,
                             uint32_t planes, const double origin_enu_m[3], struct err *e) ERR_USE;
/* As harmonics_hold, for a model in training at the end of a level. Moments are kept. ERR_MEM,
 * ERR_DEVICE. */
enum err_code harmonics_level(struct model *m, const struct harmonics_rule *r,
                              struct err *e) ERR_USE;

#endif
