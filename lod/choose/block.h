/* Blocks of a decoded tile: 256 neighbours and the box around them. A picture draws only the blocks
 * that may be in view. Internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_BLOCK_H
#define LOD_BLOCK_H

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

/* Sorts n rows by size, in powers of two. Rows of one power keep their order, in which neighbours
 * follow each other. Without this, one large Gaussian would make the box of its block large.
 * size_log [n]: the logarithm of each row's largest sigma. place [n] becomes the new number of each
 * row. */
void block_places(const float *size_log, size_t n, uint32_t *place);
/* Computes the box of a block from its n rows, as they are drawn: whole groups about the origin. */
void block_measure(const float *groups, uint32_t planes, size_t n, const double origin_enu_m[3],
                   struct block *out);

#endif
