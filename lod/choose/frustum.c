/* Planes of a view and boxes against them. The corner of a box that is farthest along a plane's
 * normal decides (p-vertex test), so a box that straddles a border is always kept.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/choose/frustum.h"

#include <math.h>

#define FRUSTUM_LENS_MARGIN                                                                        \
    0.15                    /* of the picture: where the renderer clamps x / z in the Jacobian */
#define FRUSTUM_SOFT_PX 3.0 /* 3.33 sqrt(0.3) of low-pass and 1 of rounding, upwards */

/* Plane through the eye with the camera-frame normal (a, 0, c) or (0, a, c), in the world frame.
 * `t` is tan of the angle between axis and plane, `t_clamp` that of the steepest ray the Jacobian
 * is evaluated at. */
static struct frustum_plane frustum_side(const struct camera *cam, size_t axis, double sign,
                                         double t, double t_clamp, double soft)
{
    struct frustum_plane p = {0};
    double edge = t + soft, len = sqrt(1.0 + edge * edge);
    for (size_t k = 0; k < 3; k++)
        p.n[k] = (sign * cam->rot[3 * axis + k] + edge * cam->rot[6 + k]) / len;
    p.d = (sign * cam->trans[axis] + edge * cam->trans[2]) / len;
    /* A splat at x/z = r > t reaches 3.33 sigma sqrt(1 + min(r, t_clamp)^2), the box has 3.33 sigma
     * sqrt(1 + t^2). */
    double steepest = fmax(fabs(t), fabs(t_clamp));
    p.slack_per_sigma =
        FRUSTUM_REACH_SIGMA * (sqrt(1.0 + steepest * steepest) - sqrt(1.0 + t * t)) / len;
    return p;
}

void frustum_make(const struct camera *cam, struct frustum *out)
{
    double w = cam->width_px, h = cam->height_px;
    const double edge[2][2] = {{(w - cam->cx_px) / cam->fx_px, cam->cx_px / cam->fx_px},
                               {(h - cam->cy_px) / cam->fy_px, cam->cy_px / cam->fy_px}};
    const double margin[2] = {FRUSTUM_LENS_MARGIN * w / cam->fx_px,
                              FRUSTUM_LENS_MARGIN * h / cam->fy_px};
    const double soft[2] = {FRUSTUM_SOFT_PX / cam->fx_px, FRUSTUM_SOFT_PX / cam->fy_px};
    for (size_t axis = 0; axis < 2; axis++)
        for (size_t side = 0; side < 2; side++) {
            double t = edge[axis][side];
            out->plane[2 * axis + side] =
                frustum_side(cam, axis, side ? 1.0 : -1.0, t, t + margin[axis], soft[axis]);
        }
    /* The near plane cuts by the mean, which is inside the box, and lies in front of the eye. */
    out->plane[4] =
        (struct frustum_plane){.n = {cam->rot[6], cam->rot[7], cam->rot[8]}, .d = cam->trans[2]};
}

void frustum_make_orthographic(const struct camera *cam, struct frustum *out)
{
    const double edge_m[2][2] = {{(cam->width_px - cam->cx_px + FRUSTUM_SOFT_PX) / cam->fx_px,
                                  (cam->cx_px + FRUSTUM_SOFT_PX) / cam->fx_px},
                                 {(cam->height_px - cam->cy_px + FRUSTUM_SOFT_PX) / cam->fy_px,
                                  (cam->cy_px + FRUSTUM_SOFT_PX) / cam->fy_px}};
    for (size_t axis = 0; axis < 2; axis++)
        for (size_t side = 0; side < 2; side++) {
            const double *to = cam->rot + 3 * axis, sign = side ? 1.0 : -1.0;
            out->plane[2 * axis + side] =
                (struct frustum_plane){.n = {sign * to[0], sign * to[1], sign * to[2]},
                                       .d = sign * cam->trans[axis] + edge_m[axis][side]};
        }
    out->plane[4] =
        (struct frustum_plane){.n = {cam->rot[6], cam->rot[7], cam->rot[8]}, .d = cam->trans[2]};
}

bool frustum_sees(const struct frustum *f, const double min_enu_m[3], const double max_enu_m[3],
                  double sigma_max_m)
{
    for (size_t i = 0; i < 5; i++) {
        const struct frustum_plane *p = &f->plane[i];
        double at = p->d + p->slack_per_sigma * sigma_max_m;
        for (size_t k = 0; k < 3; k++)
            at += p->n[k] * (p->n[k] > 0.0 ? max_enu_m[k] : min_enu_m[k]);
        if (at < 0.0)
            return false;
    }
    return true;
}
