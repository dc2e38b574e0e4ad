/* Inside of train/: relocation of 3DGS-MCMC (Kheradmand et al. 2024). A Gaussian that moves goes to
 * the place of another one, drawn in proportion to opacity, and the two share its opacity. Pure:
 * any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RELOCATE_H
#define TRAIN_RELOCATE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { RELOCATE_MOST = 51 }; /* Gaussians that share a place, as in the published code */

/* Who can be drawn, and the chance of each; the same seed and stream draw the same. Borrowed. */
struct relocate_from {
    const float *weight; /* by id, at least 0 */
    const uint32_t *ids; /* [n] */
    size_t n;
    uint64_t seed, stream;
};

/* Draw `room` times with chances in proportion to weight; copies [by id] is raised by how often
 * each came. At most RELOCATE_MOST - 1 each: what is beyond is not placed. *placed: how many were.
 * ERR_MEM. */
enum err_code relocate_draw(const struct relocate_from *from, size_t room, uint8_t *copies,
                            size_t *placed, struct err *e) ERR_USE;

/* `parts` Gaussians in the place of one of opacity o that together blend as it did (equation 9):
 *   o' = 1 - (1 - o)^(1 / parts),
 *   sigma' / sigma = o / sum_{i=1..parts} sum_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1). */
struct relocate_share {
    double opacity, shrink;
};
struct relocate_share relocate_share(double opacity, unsigned parts);

#endif
