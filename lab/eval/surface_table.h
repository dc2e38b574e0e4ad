/* Statistics of rays through a surface, as rows of a table and of JSON (lab/EVALUATION.md,
 * "Surfaces").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_SURFACE_TABLE_H
#define LAB_SURFACE_TABLE_H

#include "cli/train/eval_city.h"
#include "lab/truth/surface_rays.h"

struct json_t;

struct surface_table {
    const char *what, *rays; /* the drawing; the kind of rays */
    double gsd_m;
    bool edges;          /* rays know whether they are near edges */
    bool kinds;          /* rays know classes */
    bool truth;          /* rays know where the surface should be */
    struct json_t *rows; /* a JSON array; each row appends an object */
};
/* Prints the line above the tables of a drawing. */
void surface_table_head(const struct eval_drawing *d, double gsd_m);
/* Prints all groups of rays that are not empty. ERR_MEM. */
enum err_code surface_table_print(const struct surface_table *t, const struct surface_rays *s,
                                  struct err *e) ERR_USE;
/* Prints a number, or "-" if nothing was measured. */
void surface_table_cell(int width, int digits, double v);
/* Appends {"what", "views_of"} and these results, whose reference it takes over. ERR_MEM. */
enum err_code surface_table_row(struct json_t *rows, const char *what, const char *of,
                                struct json_t *figures, struct err *e) ERR_USE;

#endif
