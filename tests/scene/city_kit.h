/* A small procedural city for tests that photograph one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_CITY_KIT_H
#define TESTS_CITY_KIT_H

#include "tests/kit.h"

#include "scene/synth/synth.h"

/* Options of a city of 100 m in folder `dir`, which is not there yet. Photographs have 80 x 60
 * pixels. Texts of the options lie in `a`. */
static inline void city_kit_config(struct synth_config *c, struct arena *a, const char *dir,
                                   int photos)
{
    struct err e = {0};
    kit_ok(options_defaults(synth_options(), c, a, &e), e);
    c->output = dir;
    c->photos = photos;
    c->width_px = 80;
    c->height_px = 60;
    c->extent_m = 100;
    c->points = 1500;
    c->supersample = 1;
}

/* Whether the camera sees `x`, at least `rim_px` from the picture's edge, and where. */
static inline bool city_kit_sees(const struct camera *c, const double x[3], double rim_px,
                                 double px[2])
{
    double p[3];
    for (int a = 0; a < 3; a++)
        p[a] = c->rot[3 * a] * x[0] + c->rot[3 * a + 1] * x[1] + c->rot[3 * a + 2] * x[2] +
               c->trans[a];
    px[0] = c->fx_px * p[0] / p[2] + c->cx_px;
    px[1] = c->fy_px * p[1] / p[2] + c->cy_px;
    return p[2] > 0 && px[0] > rim_px && px[1] > rim_px && px[0] < c->width_px - rim_px &&
           px[1] < c->height_px - rim_px;
}

#endif
