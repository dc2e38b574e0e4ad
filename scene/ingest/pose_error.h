/* How well the pose of a photograph is known from the points that it sees.
 *
 * Align asks it whether a photograph needs more features, and ingest whether it is kept: both by
 * pose_error_known, so that what one calls good the other keeps.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_POSE_ERROR_H
#define SCENE_INGEST_POSE_ERROR_H

#include "codec/scene/colmap.h"

struct pose_error {
    size_t n_points;        /* points that the photograph sees */
    double reprojection_px; /* median distance of its observations from where points project */
    /* Standard deviation by which the uncertain pose moves the picture, over its area at the depth
     * of its points, in pixels of COLMAP's camera; INFINITY: its points do not fix the pose. */
    double picture_px;
};
/* Fills out [m->n_images]. Where the model has no observations, n_points is 0 and picture_px
 * INFINITY. ERR_MEM. */
enum err_code pose_error_find(const struct colmap_model *m, struct pose_error *out,
                              struct err *e) ERR_USE;
/* The largest picture_px of a known pose: two pixels of a picture of 1600 px, which is what trains,
 * or of the camera's own if that is smaller. */
double pose_error_most_px(const struct lens *l);
static inline bool pose_error_known(const struct pose_error *p, const struct lens *l)
{
    return p->picture_px <= pose_error_most_px(l);
}

#endif
