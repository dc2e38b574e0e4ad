/* Blocks of a decoded tile: 256 neighbours and the box around them. A picture draws only the blocks
 * that may be in view. Internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_BLOCK_H
#define LOD_BLOCK_H

#include "core/gauss.h"
#include "render/render.h"

enum { BLOCK_GROUPS = 16, BLOCK_ROWS = BLOCK_GROUPS * LAYOUT_LANES };

struct block {
    double min_enu_m[3], max_enu_m[3]; /* box around the means, each widened by 3.33 sigma */
    double sigma_max_m;
};
static inline uint32_t block_count(size_t n_gaussians)
{
    return (uint32_t)((n_gaussians + BLOCK_ROWS - 1) / BLOCK_ROWS);
}

/* order [g->n] becomes the rows by size, in powers of two, and otherwise in their order, in which
 * neighbours follow each other. Without this, one large Gaussian would make the box of its block
 * large. ERR_MEM. */
enum err_code block_order(const struct gauss *g, uint32_t *order, struct err *e) ERR_USE;
/* Computes the boxes: out has block_count(g->n) elements. */
void block_measure(const struct gauss *g, struct block *out);

#endif
