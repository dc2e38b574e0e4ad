/* The partition as a file, plan.json, and as a picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_CELL_PLAN_H
#define SCENE_CELLS_CELL_PLAN_H

#include "core/err.h"

struct partition;
struct scene;

/* Writes plan.json. Photographs are listed by name, so the file stays valid when ingest runs again.
 * ERR_IO, ERR_MEM. */
enum err_code cell_plan_write(const char *path, const struct scene *s, const struct partition *p,
                              struct err *e) ERR_USE;
/* Reads plan.json and matches photographs to the scene by name. Free *out with partition_free.
 * ERR_FORMAT: it is no plan, or it has other photographs. ERR_NOENT, ERR_IO, ERR_MEM. */
enum err_code cell_plan_read(const char *path, const struct scene *s, struct partition *out,
                             struct err *e) ERR_USE;
/* Writes an SVG: cells with their counts, cameras with their direction of view, a sample of the
 * points. ERR_IO, ERR_MEM. */
enum err_code cell_plan_svg(const char *path, const struct scene *s, const struct partition *p,
                            struct err *e) ERR_USE;
#endif
