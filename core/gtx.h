/* Grids of geoid heights as PROJ and GDAL have them: NOAA's .gtx. Debian's proj-data has one.
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
/* Read whole, so that any thread may ask; gtx_close it. ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_FORMAT
 * (no such grid: what is wrong), ERR_MEM. */
enum err_code gtx_open(const char *path, struct gtx **out, struct err *e) ERR_USE;
void gtx_close(struct gtx **g);
/* Metres that the geoid lies above the ellipsoid, bilinear; NAN outside of the grid. */
double gtx_above(const struct gtx *g, double lon_deg, double lat_deg);
/* The path of a grid of PROJ's (PROJ_DATA, PROJ_LIB, /usr/share/proj). False: there is none. */
bool gtx_find(const char *name, char path[4096]);

#ifdef __cplusplus
}
#endif
#endif
