/* Compares two surfaces by points: precision, recall and F1 within a distance, by the protocol of
 * Tanks and Temples (Knapitsch et al. 2017).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_SURFACE_MATCH_H
#define LAB_SURFACE_MATCH_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "lab/truth/surface_rays.h"

/* Points: the first one that was added in each voxel. {0} with voxel_m is empty. Free with
 * surface_cloud_free. */
struct surface_cloud {
    double voxel_m;
    float *xyz_m;  /* [n][3] */
    uint8_t *kind; /* [n] enum surface_class; SURFACE_CLASSES: none */
    size_t n, cap;
    /* [n_seen] table of voxels with open addressing; the size is a power of two; 0: free */
    uint64_t *seen;
    size_t n_seen;
};
/* Adds a point. ERR_LIMIT: it is more than 2^20 voxels from 0. ERR_MEM. */
enum err_code surface_cloud_add(struct surface_cloud *c, const double xyz_m[3], uint8_t kind,
                                struct err *e) ERR_USE;
void surface_cloud_free(struct surface_cloud *c);

enum { SURFACE_MATCHES = 2 /* number of distances */ };
struct surface_match {       /* NAN: there are no points */
    size_t n_model, n_truth; /* number of points that were compared */
    double precision, recall, f1;
};
/* Computes out[d][kind], and out[d][SURFACE_CLASSES] for all kinds. Precision is the share of the
 * model's points with a point of the truth within within_m[d]. Recall is the share of the truth's
 * points with one of the model. A point of the model has the kind of the nearest point of the
 * truth. At most `asked` points of each side are compared, evenly spaced in their order.
 * ERR_CANCEL, ERR_MEM. */
enum err_code surface_match_tell(const struct surface_cloud *model,
                                 const struct surface_cloud *truth,
                                 const double within_m[SURFACE_MATCHES], size_t asked,
                                 struct surface_match out[SURFACE_MATCHES][SURFACE_CLASSES + 1],
                                 struct err *e) ERR_USE;

#endif
