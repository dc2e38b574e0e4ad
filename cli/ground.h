/* The surveyed ground of a scene: the convex hull of where its photographs were taken.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_GROUND_H
#define CLI_GROUND_H

#include "codec/codec.h"

struct ground {          /* {0} is empty; ground_free */
    double (*corner)[2]; /* ENU metres, counter-clockwise */
    size_t n;
};
enum err_code ground_of(const struct scene *s, struct ground *out, struct err *e) ERR_USE;
void ground_free(struct ground *g);
/* Metres to the hull, 0 inside. */
double ground_distance(const struct ground *g, double x_m, double y_m);

#endif
