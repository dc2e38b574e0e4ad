/* Ground control points: places on the ground that were surveyed and marked in photographs.
 *
 * Two forms of file. OpenDroneMap's gcp_list.txt: a line that names the coordinate system, then "x
 * y z column row photograph [name]", by blanks or tabs. CSV, by commas or semicolons: a line that
 * names the columns, among them x, y, z (or easting, northing, height; or lon, lat, height), px,
 * py, image, and name; accuracy_xy and accuracy_z in metres, and accuracy_px. Numbers have decimal
 * points: a decimal comma is refused with its line.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_GCP_H
#define INGEST_GCP_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { GCP_NAME_MAX = 64, GCP_IMAGE_MAX = 256, GCP_MAX = 10000, GCP_LONLAT = 4326 };

struct gcp {
    char name[GCP_NAME_MAX];
    double at[3];   /* as the file has it; longitude, latitude, height once it was projected back */
    double file[3]; /* as the file has it */
    double sigma_m[2]; /* of the survey, an axis in plan and in height; 0: the file does not say */
    size_t line;       /* where it comes first */
    bool check;        /* kept out of the fit */
};
struct gcp_mark { /* one GCP in one photograph */
    size_t gcp;
    char image[GCP_IMAGE_MAX];
    double x_px, y_px, sigma_px; /* sigma_px 0: the file does not say */
    size_t line;
};
struct gcp_list { /* {0} is empty; gcp_free */
    struct gcp *gcps;
    size_t n, cap;
    struct gcp_mark *marks;
    size_t n_marks, cap_marks;
    int epsg;         /* of the file; 0: it does not say, or not in words known here */
    int heights_epsg; /* of "EPSG:25832+7837"; 0: it does not say */
    /* Metres of a projected system to longitude and latitude, in place: for finding out what went
     * wrong. NULL: cannot be asked. */
    enum err_code (*unproject)(int epsg, double *x, double *y, struct err *e);
};
/* ERR_NOENT, ERR_FORMAT (which line, what is expected), ERR_DATA (none, or too many), ERR_IO,
 * ERR_MEM. */
enum err_code gcp_read(const char *path, struct gcp_list *out, struct err *e) ERR_USE;
void gcp_free(struct gcp_list *l);
/* Keep these out of the fit: names, by commas. ERR_ARG: there is none of that name. */
enum err_code gcp_keep_out(struct gcp_list *l, const char *names, struct err *e) ERR_USE;

#endif
