/* A rectangle around a city, turned as its streets are: what viewers show first.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HOME_OUTLINE_H
#define SERVER_HOME_OUTLINE_H

#include "server/data/dataset.h"

enum { HOME_OUTLINE_NUMBERS = 10 };

/* The smallest rectangle around points [n][2], of those turned by multiples of five degrees: its
 * corners [4][2], in order around it. */
void home_outline_around(const double (*points)[2], size_t n, double out[8]);
/* The rectangle of the surveyed ground of d, or of the box around most Gaussians if that is
 * smaller: four corners, each east and north of the origin, then the heights between which nearly
 * all of it lies; metres.
 * False: d is empty, or memory is short. */
bool home_outline(const struct dataset *d, double out[HOME_OUTLINE_NUMBERS]);

#endif
