/* The surveyed ground of a scene: the convex hull of the places where its photographs were taken.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_CAMERA_HULL_H
#define CELLS_CAMERA_HULL_H

#include "core/err.h"

struct scene;

struct camera_hull {     /* {0} is empty; free with camera_hull_free */
    double (*corner)[2]; /* ENU metres, counter-clockwise */
    size_t n;
};
/* Computes the hull of all photographs of the scene. A hull with one or two corners is a place or a
 * line. Free *out with camera_hull_free. ERR_DATA: there are no photographs. ERR_MEM. */
enum err_code camera_hull_of(const struct scene *s, struct camera_hull *out, struct err *e) ERR_USE;
void camera_hull_free(struct camera_hull *g);
/* Horizontal distance to the hull in metres, 0 inside. */
double camera_hull_distance(const struct camera_hull *g, double x_m, double y_m);

#endif
