/* plan.json: the partition as a file, and as a picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_CELL_PLAN_H
#define CELLS_CELL_PLAN_H

#include "core/err.h"

struct partition;
struct scene;

enum err_code cell_plan_write(const char *path, const struct scene *s, const struct partition *p,
                              struct err *e) ERR_USE;
/* Photographs are matched to the scene by name. ERR_FORMAT when they do not fit. */
enum err_code cell_plan_read(const char *path, const struct scene *s, struct partition *out,
                             struct err *e) ERR_USE;
/* SVG: cells with their counts, cameras with their direction of view, a sample of the points. */
enum err_code cell_plan_svg(const char *path, const struct scene *s, const struct partition *p,
                            struct err *e) ERR_USE;
#endif
