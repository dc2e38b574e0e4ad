/* Vector files by GDAL: one layer of lines or polygons, as GeoJSON in longitude and latitude or as
 * a GeoPackage in a projection. The file is written under another name and renamed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_LAYER_H
#define SURVEY_LAYER_H

#include "core/base.h"
#include "survey/crs.h"

enum { LAYER_FIELDS_MAX = 12 };

struct layer_info {
    const char *name;         /* of the layer */
    const char *about;        /* one line */
    const struct crs *crs;    /* of the places that are added */
    bool polygons;            /* else lines */
    const char *const *field; /* names of real numbers */
    size_t n_fields;          /* up to LAYER_FIELDS_MAX */
};
struct layer;
/* Checks whether the name says the kind of file. ERR_ARG: it must end in .geojson, .json or .gpkg.
 */
enum err_code layer_check(const char *path, struct err *e) ERR_USE;
/* Begins the file. ERR_ARG, ERR_IO, ERR_LIMIT (a path too long), ERR_MEM. */
enum err_code layer_create(const char *path, const struct layer_info *info, struct layer **out,
                           struct err *e) ERR_USE;
/* Adds a line of n places in the projection; x and y are overwritten. ERR_IO. ERR_ARG as in
 * crs_unproject. */
enum err_code layer_add_line(struct layer *l, int n, double *x, double *y, const double *value,
                             struct err *e) ERR_USE;
/* Adds a polygon of rings, the first around the others, each of count[i] places and closed. x and y
 * are overwritten. ERR_IO. ERR_ARG as in crs_unproject. */
enum err_code layer_add_polygon(struct layer *l, size_t rings, const int *count, double *x,
                                double *y, const double *value, struct err *e) ERR_USE;
/* Completes the file; it closes *l in any case. ERR_IO. */
enum err_code layer_commit(struct layer **l, struct err *e) ERR_USE;
void layer_close(struct layer **l); /* without a commit: nothing is left behind */

#endif
