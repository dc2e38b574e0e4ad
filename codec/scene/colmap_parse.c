/* Checks of COLMAP records that the binary and the text reader share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/colmap_parse.h"

#include <math.h>
#include <string.h>

#include "codec/scene/colmap.h"

/* COLMAP's models beyond the eleven of core/splat/camera.h, by number from LENS_COUNT on. Fisheyes
 * without distortion are those with it, whose coefficients are 0. */
static const struct colmap_lens colmap_lenses[] = {
    {"RAD_TAN_THIN_PRISM_FISHEYE", 16, LENS_COUNT},
    {"SIMPLE_DIVISION", 4, LENS_COUNT},
    {"DIVISION", 5, LENS_COUNT},
    {"SIMPLE_FISHEYE", 3, LENS_SIMPLE_RADIAL_FISHEYE},
    {"FISHEYE", 4, LENS_OPENCV_FISHEYE},
    {"EUCM", 6, LENS_COUNT},
    {"EQUIRECTANGULAR", 2, LENS_COUNT},
};

bool colmap_lens_find(const char *name, uint32_t id, struct colmap_lens *out)
{
    const uint32_t n = LENS_COUNT + sizeof colmap_lenses / sizeof *colmap_lenses;
    for (uint32_t i = name ? 0 : id; i < n; i++) {
        if (i >= LENS_COUNT)
            *out = colmap_lenses[i - LENS_COUNT];
        else
            *out = (struct colmap_lens){lens_name((enum lens_model)i),
                                        lens_param_count((enum lens_model)i), (enum lens_model)i};
        if (!name || !strcmp(name, out->name))
            return true;
    }
    return false;
}

static const char *colmap_check_camera(const struct colmap_camera *c)
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

const char *colmap_set_lens(const struct colmap_lens *l, const double *params,
                            struct colmap_camera *c)
{
    if (l->model == LENS_COUNT) {
        c->foreign = l->name;
        return NULL;
    }
    c->lens.model = l->model;
    memcpy(c->lens.params, params, l->n_params * sizeof *params);
    return colmap_check_camera(c);
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

bool colmap_point_is_somewhere(const struct colmap_point *p)
{
    return isfinite(p->xyz[0]) && isfinite(p->xyz[1]) && isfinite(p->xyz[2]);
}
