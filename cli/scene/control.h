/* Converts ground control points of a file to longitude and latitude, for all commands that read
 * them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_CONTROL_H
#define CLI_CONTROL_H

#include "scene/control/gcp.h"

struct crs;

/* Converts the points by PROJ. epsg: --gcp-epsg; 0: as the file says. path is for messages.
 * ERR_ARG: the system is not known, or a point has no place in it. ERR_NOENT, ERR_INTERNAL,
 * ERR_MEM. */
enum err_code control_unproject(const char *path, int epsg, struct gcp_list *l,
                                struct err *e) ERR_USE;
/* As crs_unproject of one surveyed place. ERR_ARG also: x and y look like longitude and latitude,
 * and the system counts metres. */
enum err_code control_unproject_place(const struct crs *crs, double *x, double *y,
                                      struct err *e) ERR_USE;

#endif
