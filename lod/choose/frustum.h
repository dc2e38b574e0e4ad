/* Tests whether a camera can see boxes around splats. Internal to lod/.
 *
 * A box encloses means, each widened by 3.33 sigma, the reach of an opaque splat. A box is rejected
 * only if it lies completely behind one of five planes, so that no splat in it can touch the
 * picture. EWA splatting evaluates its Jacobian at the mean, and draws slightly beyond the true
 * cone. The planes are therefore moved outwards by the largest possible excess. There is no far
 * plane.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_FRUSTUM_H
#define LOD_FRUSTUM_H

#include "core/splat/camera.h"

#define FRUSTUM_REACH_SIGMA 3.33 /* sqrt(2 ln 255) = 3.329: from there alpha is below 1/255 */

struct frustum_plane { /* inside: dot(n, x) + d >= -slack_per_sigma * sigma_max; ENU metres */
    double n[3], d, slack_per_sigma;
};
struct frustum {
    struct frustum_plane plane[5];
};

/* Makes the planes of a camera. Its focal length and size are not 0. */
void frustum_make(const struct camera *cam, struct frustum *out);
/* As frustum_make, for an orthographic camera: see render_options.orthographic. */
void frustum_make_orthographic(const struct camera *cam, struct frustum *out);
/* Returns whether a splat in the box may touch the picture. sigma_max_m is the largest sigma of
 * those splats. */
bool frustum_sees(const struct frustum *f, const double min_enu_m[3], const double max_enu_m[3],
                  double sigma_max_m);

#endif
