/* Reorders rows of Gaussians in the device layout, [groups][planes][16]. Values are only copied, so
 * they may be other words of 32 bits than floats.
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

/* Flag of a source: the new row is a copy, not the Gaussian itself. */
#define PERMUTE_NEW UINT32_C(0x80000000)

struct permutation {
    const uint32_t *source; /* [n] old row of each new row, with or without PERMUTE_NEW */
    size_t n, n_old;        /* both below 2^31 */
    uint32_t planes;
};
/* Row d of `to` becomes row source[d] of `from`. If source[d] has PERMUTE_NEW and `zero_new` is
 * set, row d becomes 0. Lanes after the last row become 0. `to` may be `from` if it has room for
 * the larger number of rows; the work then needs only PERMUTE_SPARE more bytes a Gaussian, for any
 * number of planes. It uses all cores. ERR_MEM. */
enum { PERMUTE_SPARE = 32 };
/* See above: ERR_MEM. */
enum err_code permute_move(const struct permutation *r, bool zero_new, const float *from, float *to,
                           struct err *e) ERR_USE;

#endif
