/* A procedural city as a map shows it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_SYNTH_MAP_H
#define LAB_SYNTH_MAP_H

#include "scene/synth/synth.h"

/* Draws the city without vehicles from straight above, with parallel rays, as an orthophoto should
 * show it. corner_enu_m: ENU of the corners, top left, top right, bottom left, bottom right; pixels
 * are evenly spaced between. A pixel is the mean of supersample^2 rays, and the picture is then
 * blurred. It uses all cores. Free *out with image_free, also after ERR_MEM. */
enum err_code synth_map_draw(const struct synth_city *c, const double corner_enu_m[4][2],
                             const uint32_t size_px[2], int supersample, double blur_px,
                             struct image *out, struct err *e) ERR_USE;

#endif
