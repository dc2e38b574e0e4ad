/* Checks of COLMAP records that the binary and the text reader share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/colmap_parse.h"

#include <math.h>

#include "codec/colmap.h"

const char *colmap_check_camera(const struct colmap_camera *c)
{
    double fx, fy, cx, cy;
    for (size_t i = 0; i < lens_param_count(c->lens.model); i++)
        if (!isfinite(c->lens.params[i]))
            return "a lens parameter is not finite";
    lens_focal(&c->lens, &fx, &fy, &cx, &cy);
    if (!(fx > 0 && fy > 0))
        return "the focal length is not positive";
    return NULL;
}

const char *colmap_check_image(const struct colmap_image *im)
{
    double n2 = 0;
    for (int i = 0; i < 4; i++)
        n2 += im->quat_wxyz[i] * im->quat_wxyz[i];
    if (!(isfinite(n2) && n2 > 1e-6))
        return "the rotation quaternion is zero or not finite";
    for (int i = 0; i < 3; i++)
        if (!isfinite(im->trans[i]))
            return "the translation is not finite";
    if (!im->name[0])
        return "the file name is empty";
    for (size_t j = 0; j < im->n_obs; j++)
        if (!isfinite(im->obs[j].x_px) || !isfinite(im->obs[j].y_px))
            return "an observation is not finite";
    return NULL;
}

const char *colmap_check_point(const struct colmap_point *p)
{
    for (int i = 0; i < 3; i++)
        if (!isfinite(p->xyz[i]))
            return "a coordinate is not finite";
    return NULL;
}
