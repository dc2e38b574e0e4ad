/* What a camera can see, for boxes around splats: internal to lod/.
 *
 * A box is left out only if no splat in it can touch the picture: it (means grown by 3.33 sigma,
 * the reach of an opaque splat) must lie wholly behind one of five planes. EWA splatting evaluates
 * its Jacobian at the mean and so draws a little beyond the true cone; the planes are moved by
 * exactly what that can be. There is no far plane.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_FRUSTUM_H
#define LOD_FRUSTUM_H

#include "core/camera.h"

#define FRUSTUM_REACH_SIGMA 3.33 /* sqrt(2 ln 255) = 3.329: alpha falls below 1/255 */

struct frustum_plane { /* inside: dot(n, x) + d >= -slack_per_sigma * sigma_max; ENU metres */
    double n[3], d, slack_per_sigma;
};
struct frustum {
    struct frustum_plane plane[5];
};

/* cam has a focal length and pixels. */
void frustum_make(const struct camera *cam, struct frustum *out);
/* The same of an orthographic view: see render_options.orthographic. */
void frustum_make_orthographic(const struct camera *cam, struct frustum *out);
/* May anything within the box touch the picture? sigma_max_m: of the splats in it. */
bool frustum_sees(const struct frustum *f, const double min_enu_m[3], const double max_enu_m[3],
                  double sigma_max_m);

#endif
