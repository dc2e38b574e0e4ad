/* Photographs that train a cell because they show it, from wherever they were taken.
 *
 * window.h defines the share of a photograph that shows a cell. A cell takes every photograph whose
 * share is at least share_min, and training cuts the photograph to the part that shows the cell
 * (docs/decisions/008-cells.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_SHARE_H
#define SCENE_CELLS_SHARE_H

#include <stdbool.h>

#include "core/err.h"

struct partition;
struct scene;

/* Replaces the photographs of each trained cell by those that show enough of it, and sets
 * p->share_min. Photographs that the cell had by location come first. all_images: test photographs
 * too. A cell that no photograph shows enough of keeps its photographs. If there is only one cell,
 * it keeps all photographs, uncut. ERR_MEM. */
enum err_code share_photographs(const struct scene *s, double share_min, struct partition *p,
                                struct err *e) ERR_USE;

#endif
