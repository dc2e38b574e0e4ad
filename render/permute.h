/* Rows of Gaussians in the device layout, [groups][planes][16], put into another order.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_PERMUTE_H
#define RENDER_PERMUTE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/layout.h"

/* In a source: the row is a copy, not that Gaussian itself. */
#define PERMUTE_NEW UINT32_C(0x80000000)

struct permutation {
    const uint32_t *source; /* [n] the old row that each new one is made of, PERMUTE_NEW or not */
    size_t n, n_old;        /* both below 2^31 */
    uint32_t planes;
};
/* to's row d = from's row source[d]; 0 where that is PERMUTE_NEW and `zero_new`. Lanes after the
 * last row become 0. `to` may be `from`, if it has room for the larger number of rows: all that is
 * needed besides are PERMUTE_SPARE bytes a Gaussian, whatever the number of planes. Works on all
 * cores. ERR_MEM. */
enum { PERMUTE_SPARE = 16 };
/* See above: ERR_MEM. */
enum err_code permute_move(const struct permutation *r, bool zero_new, const float *from, float *to,
                           struct err *e) ERR_USE;
/* Index of plane 0 of a row. */
static inline size_t permute_at(size_t row, uint32_t planes)
{
    return row / LAYOUT_LANES * planes * LAYOUT_LANES + row % LAYOUT_LANES;
}
/* Floats of an array of n rows. */
static inline size_t permute_floats(size_t n, uint32_t planes)
{
    return (n + LAYOUT_LANES - 1) / LAYOUT_LANES * planes * LAYOUT_LANES;
}

#endif
