/* Map projections: places on Earth to and from the metres of a projected coordinate reference
 * system, by GDAL's interface to PROJ.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CRS_H
#define SURVEY_CRS_H

#include <stddef.h>

#include "core/err.h"

struct crs; /* one thread at a time */
/* The EPSG code of the UTM zone that holds a place (WGS 84: 326xx north, 327xx south; those of
 * Norway and Svalbard are irregular), of UPS north of 84 and south of 80 degrees. */
int crs_utm(double lon_deg, double lat_deg);
/* ERR_ARG: no such code, or one whose axes are not metres in the plane. */
enum err_code crs_open(int epsg, struct crs **out, struct err *e) ERR_USE;
void crs_close(struct crs **c);
int crs_epsg(const struct crs *c);
/* Degrees between a place and the box that the system is used in; 0: inside, or not known. */
double crs_outside_deg(const struct crs *c, double lon_deg, double lat_deg);
const void *crs_handle(const struct crs *c); /* OGRSpatialReferenceH, borrowed */
/* The EPSG code of heights above sea level by a model of GeographicLib ("egm96-5" is 5773); 0:
 * there is none. */
int crs_vertical(const char *geoid);
/* Heights are those of this code: crs_with_heights is compound from now on. ERR_IO: PROJ does not
 * know the code; ERR_MEM. */
enum err_code crs_set_vertical(struct crs *c, int epsg, struct err *e) ERR_USE;
/* As crs_handle, with its heights where they were set. */
const void *crs_with_heights(const struct crs *c);
/* The same as OGC's WKT 1. mem_free it. ERR_MEM. */
enum err_code crs_wkt(const struct crs *c, char **out, struct err *e) ERR_USE;
/* In place: x, y hold longitude and latitude in degrees and get east and north in metres, or the
 * other way round. ERR_ARG names the first place that the projection does not reach. */
enum err_code crs_project(const struct crs *c, size_t n, double *x, double *y,
                          struct err *e) ERR_USE;
enum err_code crs_unproject(const struct crs *c, size_t n, double *x, double *y,
                            struct err *e) ERR_USE;

#endif
