/* Coordinate reference systems: between places on earth (WGS 84) and metres of a map's projection,
 * or coordinates of surveyed places, by GDAL's interface to PROJ.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CRS_H
#define SURVEY_CRS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { CRS_ELLIPSOIDAL = 4979 }; /* stands for heights above the ellipsoid, which have no code */

struct crs; /* only one thread at a time may use it */
/* The EPSG code of the UTM zone of a place (WGS 84: 326xx north, 327xx south; zones of Norway and
 * Svalbard are irregular). North of 84 and south of 80 degrees it is that of UPS. */
int crs_utm(double lon_deg, double lat_deg);
/* Opens a projection of maps. Close *out with crs_close. ERR_ARG: there is no such code, its axes
 * are not metres in the plane, or it has heights. ERR_NOENT, ERR_INTERNAL: of gdal_load. ERR_IO:
 * PROJ's database is missing. ERR_MEM. */
enum err_code crs_open(int epsg, struct crs **out, struct err *e) ERR_USE;
/* As crs_open, for coordinates of surveyed places. They may also be longitude and latitude in
 * degrees, in this order, of any datum. ERR_ARG: neither. Other errors as of crs_open. */
enum err_code crs_open_places(int epsg, struct crs **out, struct err *e) ERR_USE;
/* Splits a system with heights: 5555 becomes 25832 and heights 5783, 4937 becomes 4258 and
 * CRS_ELLIPSOIDAL. Other codes, known or not, stay. *heights: 0, or named beside the code. ERR_ARG:
 * these are others. ERR_NOENT, ERR_INTERNAL: of gdal_load. */
enum err_code crs_split(int *epsg, int *heights, struct err *e) ERR_USE;
void crs_close(struct crs **c);
int crs_epsg(const struct crs *c);
bool crs_is_degrees(const struct crs *c); /* longitude and latitude */
/* Distance in degrees from a place to the box in which the system is used; 0: inside, or not known.
 */
double crs_outside_deg(const struct crs *c, double lon_deg, double lat_deg);
const void *crs_handle(const struct crs *c); /* OGRSpatialReferenceH, borrowed */
/* The EPSG code of heights above sea level by a model of GeographicLib ("egm96-5": 5773). 0: there
 * is none. */
int crs_vertical(const char *geoid);
/* Sets the EPSG code of heights. crs_with_heights is compound from now on. ERR_IO: PROJ does not
 * know the code. ERR_ARG: they are not metres upwards. ERR_MEM. */
enum err_code crs_set_vertical(struct crs *c, int epsg, struct err *e) ERR_USE;
/* As crs_handle, with heights if they were set. */
const void *crs_with_heights(const struct crs *c);
/* The system, with heights if they were set, as OGC's WKT 1. The caller frees it with mem_free.
 * ERR_MEM. */
enum err_code crs_wkt(const struct crs *c, char **out, struct err *e) ERR_USE;
/* Convert n places in place: x, y are longitude and latitude of WGS 84 in degrees and become those
 * of the system, or east and north in metres; or the other way. ERR_ARG names the first place that
 * the system does not cover. */
enum err_code crs_project(const struct crs *c, size_t n, double *x, double *y,
                          struct err *e) ERR_USE;
enum err_code crs_unproject(const struct crs *c, size_t n, double *x, double *y,
                            struct err *e) ERR_USE;

#endif
