/* Figures of rays through a surface as rows of a table and of JSON (docs/evaluation.md,
 * "Surfaces").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_SURFACE_TABLE_H
#define CLI_SURFACE_TABLE_H

#include "train/surface_rays.h"

struct json_t;

struct surface_table {
    const char *what, *rays; /* what was drawn; which rays these are */
    double gsd_m;
    bool edges;          /* they know edges, */
    bool kinds;          /* classes, */
    bool truth;          /* and where the surface should be */
    struct json_t *rows; /* a JSON array that gets an object a row */
};
/* Print all groups of the rays that are not empty. ERR_MEM. */
enum err_code surface_table_print(const struct surface_table *t, const struct surface_rays *s,
                                  struct err *e) ERR_USE;
/* A number, or "-" where there was nothing to measure. */
void surface_table_cell(int width, int digits, double v);
/* Adds {"what", "views_of"} and these figures, whose reference is taken over. ERR_MEM. */
enum err_code surface_table_row(struct json_t *rows, const char *what, const char *of,
                                struct json_t *figures, struct err *e) ERR_USE;

#endif
