/* Photographs that train a cell because they show it, from wherever they were taken.
 *
 * A photograph's share of a cell is what window.h says. A cell takes the photographs of which it
 * has at least a share of share_min, and training cuts each to the part that shows the cell
 * (docs/decisions/085-cut-photographs.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_SHARE_H
#define CELLS_SHARE_H

#include <stdbool.h>

#include "core/err.h"

struct partition;
struct scene;

/* Gives each trained cell of a partition these photographs instead of those it has, and sets
 * p->share_min. First come those that it had by location. all_images: test photographs too. A cell
 * of which no photograph shows enough keeps what it has. One cell alone keeps all, whole. ERR_MEM.
 */
enum err_code share_photographs(const struct scene *s, double share_min, bool all_images,
                                struct partition *p, struct err *e) ERR_USE;

#endif
