/* Point clouds as LAS 1.4 (ASPRS R15), point format 7: place and 16-bit colour, coordinate system
 * as WKT. Written in one go, in any order, of any number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_LAS_H
#define SURVEY_LAS_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

#define LAS_STEP_M 0.001 /* of coordinates */

struct las_info {
    double offset_m[3];  /* near the points: they reach 2,147 km to each side of it */
    const char *wkt;     /* OGC WKT 1 */
    const char *source;  /* what it was made of; cut after 31 letters */
    const char *created; /* ISO 8601, of which the day is kept */
};
struct las_point {
    double at_m[3];
    float rgb[3]; /* 0 to 1 */
};
struct las;
/* Written beside path until las_commit. ERR_IO, ERR_LIMIT (a path too long, a WKT of more than
 * 64 KiB), ERR_MEM. */
enum err_code las_create(const char *path, const struct las_info *info, struct las **out,
                         struct err *e) ERR_USE;
/* ERR_IO; ERR_ARG: a place beyond what the offset reaches. */
enum err_code las_add(struct las *l, const struct las_point *p, size_t n, struct err *e) ERR_USE;
uint64_t las_count(const struct las *l);
/* Make the file; closes in any case. ERR_IO; ERR_DATA: it has no points. */
enum err_code las_commit(struct las **l, struct err *e) ERR_USE;
void las_close(struct las **l); /* without a commit: nothing is left behind */

#endif
