/* plan.json: the partition as a file, and as a picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_CELL_PLAN_H
#define CELLS_CELL_PLAN_H

#include "core/err.h"

struct partition;
struct scene;

/* Write plan.json; photographs go in by name, so that the file outlives another ingest. ERR_IO,
 * ERR_MEM. */
enum err_code cell_plan_write(const char *path, const struct scene *s, const struct partition *p,
                              struct err *e) ERR_USE;
/* Read it; photographs are matched to the scene by name. partition_free it. ERR_FORMAT: not a plan,
 * or one of other photographs; ERR_NOENT, ERR_IO, ERR_MEM. */
enum err_code cell_plan_read(const char *path, const struct scene *s, struct partition *out,
                             struct err *e) ERR_USE;
/* SVG: cells with their counts, cameras with their direction of view, a sample of the points.
 * ERR_IO, ERR_MEM. */
enum err_code cell_plan_svg(const char *path, const struct scene *s, const struct partition *p,
                            struct err *e) ERR_USE;
#endif
