/* Grids of geoid heights in NOAA's format .gtx, which PROJ and GDAL use. Debian's package proj-data
 * has one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_GTX_H
#define CORE_GTX_H

#include <stdbool.h>

#include "core/err.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gtx;
/* Reads a whole grid, so that any thread may use it. Close *out with gtx_close. ERR_NOENT, ERR_IO,
 * ERR_LIMIT, ERR_FORMAT (not such a grid; the message says what is wrong), ERR_MEM. */
enum err_code gtx_open(const char *path, struct gtx **out, struct err *e) ERR_USE;
void gtx_close(struct gtx **g);
/* Height of the geoid above the ellipsoid in metres, bilinear. NAN: outside the grid. */
double gtx_above(const struct gtx *g, double lon_deg, double lat_deg);
/* Finds a grid of PROJ (PROJ_DATA, PROJ_LIB, /usr/share/proj). Returns false if there is none. */
bool gtx_find(const char *name, char path[4096]);

#ifdef __cplusplus
}
#endif
#endif
