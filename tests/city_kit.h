/* A small procedural city for tests that photograph one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_CITY_KIT_H
#define TESTS_CITY_KIT_H

#include "tests/kit.h"

#include "synth/synth.h"

/* Options of a city of 100 m in folder `dir`, which is not there yet: photographs of 80 x 60 pixels.
 * Texts of the options lie in `a`. */
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

#endif
