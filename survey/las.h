/* Point clouds as LAS 1.4 (ASPRS R15), point format 7: position and 16-bit colour, with the
 * coordinate system as WKT. Points are written in one pass, in any order and number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_LAS_H
#define SURVEY_LAS_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

#define LAS_STEP_M 0.001 /* step of coordinates */

struct las_info {
    double offset_m[3];  /* near the points, which may be up to 2,147 km away from it */
    const char *wkt;     /* OGC WKT 1 */
    const char *source;  /* name of the source; cut after 31 letters */
    const char *created; /* ISO 8601; only the day is kept */
};
struct las_point {
    double at_m[3];
    float rgb[3];  /* 0 to 1 */
    uint8_t class; /* of LAS 1.4; 0 is written as 1, which is none */
};
struct las;
/* Begins a file under another name. End with las_commit or las_close. ERR_IO, ERR_LIMIT (the path
 * is too long, or the WKT has more than 64 KiB), ERR_MEM. */
enum err_code las_create(const char *path, const struct las_info *info, struct las **out,
                         struct err *e) ERR_USE;
/* Adds n points. ERR_IO. ERR_ARG: a point is too far from the offset. */
enum err_code las_add(struct las *l, const struct las_point *p, size_t n, struct err *e) ERR_USE;
/* Completes and renames the file; it closes *l in any case. ERR_IO. ERR_DATA: it has no points. */
enum err_code las_commit(struct las **l, struct err *e) ERR_USE;
void las_close(struct las **l); /* without a commit nothing is left */

#endif
