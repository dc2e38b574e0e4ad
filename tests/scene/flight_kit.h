/* A nadir flight over flat ground, for tests of what photographs support.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_FLIGHT_KIT_H
#define TESTS_FLIGHT_KIT_H

#include "tests/kit.h"

#include <string.h>

#include "codec/scene/scene.h"

enum { SIDE = 6, POINTS = 101 }; /* photographs and points along an edge */
#define HEIGHT 60.0
#define STEP 20.0 /* between photographs */

/* 6 x 6 photographs of 80 x 60 m of ground each, and 101 x 101 points over 400 x 400 m. */
static inline void flight_kit_scene(struct scene *s)
{
    memset(s, 0, sizeof *s);
    s->origin = (struct geo_origin){7.57, 47.56, 280};
    s->n_images = SIDE * SIDE;
    s->n_points = POINTS * POINTS;
    s->images = arena_get(&s->arena, s->n_images, sizeof *s->images);
    s->points = arena_get(&s->arena, s->n_points, sizeof *s->points);
    for (size_t i = 0; i < s->n_images; i++) {
        const double at[3] = {STEP * (double)(i % SIDE) - 50, STEP * (double)(i / SIDE) - 50,
                              HEIGHT};
        kit_camera_down(at, &s->images[i].cam);
        s->images[i].split = SCENE_TRAIN;
    }
    for (size_t i = 0; i < s->n_points; i++) {
        s->points[i].enu_m[0] = 4.0 * (double)(i % POINTS) - 200;
        s->points[i].enu_m[1] = 4.0 * (double)(i / POINTS) - 200;
    }
}

#endif
