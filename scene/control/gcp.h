/* Ground control points: places on the ground that were surveyed and marked in photographs.
 *
 * gcp_read.h reads them from files.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_H
#define SCENE_CONTROL_GCP_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { GCP_NAME_MAX = 64, GCP_IMAGE_MAX = 256, GCP_MAX = 10000, GCP_LONLAT = 4326 };

/* Begins a comment in a list: names of its check points, separated by commas. */
#define GCP_CHECKS "# check points:"

struct gcp {
    char name[GCP_NAME_MAX];
    double at[3];   /* as in the file; after unprojecting longitude, latitude, height */
    double file[3]; /* as in the file */
    /* standard deviation of the survey, on each horizontal axis and of height; 0: not given */
    double sigma_m[2];
    size_t line; /* number of its first line in the file */
    bool check;  /* a check point: not used for the fit */
};
struct gcp_mark { /* one point in one photograph */
    size_t gcp;
    char image[GCP_IMAGE_MAX];
    double x_px, y_px, sigma_px; /* sigma_px 0: not in the file */
    size_t line;
};
struct gcp_list { /* {0} is empty; gcp_free */
    struct gcp *gcps;
    size_t n, cap;
    struct gcp_mark *marks;
    size_t n_marks, cap_marks;
    int epsg;         /* of the file; 0: not stated, or not understood */
    int heights_epsg; /* of "EPSG:25832+7837"; 0: not stated */
    bool degrees;     /* epsg is longitude and latitude, of any datum; by control_unproject */
    char *wkt;        /* well-known text of both systems, by control_unproject; NULL: not known */
    /* Converts coordinates of a system to longitude and latitude of WGS 84, in place. It is used to
     * find the cause of errors. NULL: not available. */
    enum err_code (*unproject)(int epsg, double *x, double *y, struct err *e);
};
void gcp_free(struct gcp_list *l);
/* Finds the point of this name, or if the name is empty, of these coordinates. If there is none
 * yet, it is added. path and line say where it was read. Errors as of gcp_add_point. */
enum err_code gcp_find(const char *path, size_t line, struct gcp_list *l, const char *name,
                       const double at[3], size_t *out, struct err *e) ERR_USE;
/* Adds a point of the file `path`, unless the list has one of that name. ERR_FORMAT: the list has
 * it at another place. ERR_DATA (too many), ERR_MEM. */
enum err_code gcp_add_point(const char *path, struct gcp_list *l, const struct gcp *g,
                            struct err *e) ERR_USE;
/* Appends a mark. ERR_MEM. */
enum err_code gcp_add_mark(struct gcp_list *l, const struct gcp_mark *m, struct err *e) ERR_USE;
/* Turns the points with these names (separated by commas) into check points. ERR_ARG: there is no
 * point of such a name. */
enum err_code gcp_keep_out(struct gcp_list *l, const char *names, struct err *e) ERR_USE;

#endif
