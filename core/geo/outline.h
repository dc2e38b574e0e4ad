/* A polygon on the ground: one ring, in metres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OUTLINE_H
#define CORE_OUTLINE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

/* Checks a polygon at [n][2]. The first corner is not repeated at the end. ERR_DATA says what is
 * wrong: fewer than 3 corners, no area, or edges that cross. Takes O(n^2). */
enum err_code outline_check(const double (*at)[2], size_t n, struct err *e) ERR_USE;
/* whether the point is inside, even-odd rule */
bool outline_holds(const double (*at)[2], size_t n, double x, double y);
bool outline_is_clockwise(const double (*at)[2], size_t n); /* with x to the right, y up */
double outline_area(const double (*at)[2], size_t n);       /* m2, positive */
double outline_length(const double (*at)[2], size_t n);     /* of the whole ring, m */

#endif
