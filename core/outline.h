/* A polygon on the ground: one ring in a plane of metres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OUTLINE_H
#define CORE_OUTLINE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

/* at [n][2]; the last corner is joined to the first, which is not repeated. ERR_DATA: fewer than 3
 * corners, no area, or edges that cross (O(n^2)); says which. */
enum err_code outline_check(const double (*at)[2], size_t n, struct err *e) ERR_USE;
bool outline_holds(const double (*at)[2], size_t n, double x, double y); /* even-odd */
double outline_area(const double (*at)[2], size_t n);                    /* positive */
double outline_length(const double (*at)[2], size_t n);                  /* of the whole ring */

#endif
