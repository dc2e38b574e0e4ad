/* How much of one surface another has, and how much it has besides: precision, recall and F1 of
 * points on both within a distance, after the protocol of Tanks and Temples (Knapitsch et al.
 * 2017).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SURFACE_MATCH_H
#define TRAIN_SURFACE_MATCH_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "train/surface_rays.h"

/* Points, one a voxel: the first that came. {0} and voxel_m is empty; surface_cloud_free. */
struct surface_cloud {
    double voxel_m;
    float *xyz_m;  /* [n][3] */
    uint8_t *kind; /* [n] enum surface_class; of points that have none: SURFACE_CLASSES */
    size_t n, cap;
    uint64_t *seen; /* [n_seen] a power of two: voxels, open addressing; 0: free */
    size_t n_seen;
};
/* Points within 2^20 voxels of 0; others are ERR_LIMIT. ERR_MEM. */
enum err_code surface_cloud_add(struct surface_cloud *c, const double xyz_m[3], uint8_t kind,
                                struct err *e) ERR_USE;
void surface_cloud_free(struct surface_cloud *c);

enum { SURFACE_MATCHES = 2 /* distances at once */ };
struct surface_match {       /* NAN: there are no points */
    size_t n_model, n_truth; /* that were asked */
    double precision, recall, f1;
};
/* out[d][kind], [d][SURFACE_CLASSES] of all: precision is the share of the model's points that have
 * one of the truth within within_m[d], recall the share of the truth's that have one of the model.
 * A point of the model is of the kind of the truth's nearest. At most `asked` points of each side
 * are looked at, evenly through their order. ERR_CANCEL, ERR_MEM. */
enum err_code surface_match_tell(const struct surface_cloud *model,
                                 const struct surface_cloud *truth,
                                 const double within_m[SURFACE_MATCHES], size_t asked,
                                 struct surface_match out[SURFACE_MATCHES][SURFACE_CLASSES + 1],
                                 struct err *e) ERR_USE;

#endif
