/* Inside of train/: where Gaussians go in 3DGS-MCMC (Kheradmand et al. 2024): onto others, drawn in
 * proportion to opacity, which share what they are with those that come. Pure: any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RELOCATE_H
#define TRAIN_RELOCATE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { RELOCATE_MOST = 51 }; /* Gaussians that share a place, as in the published code */

/* Draw `room` times from ids [n], with chances in proportion to weight [by id]; copies [by id] is
 * raised by how often each came. At most RELOCATE_MOST - 1 each: what is beyond is not placed.
 * *placed: how many were. The same for the same seed and stream. ERR_MEM. */
enum err_code relocate_draw(const float *weight, const uint32_t *ids, size_t n, size_t room,
                            uint64_t seed, uint64_t stream, uint8_t *copies, size_t *placed,
                            struct err *e) ERR_USE;

/* `parts` Gaussians in the place of one of opacity o that together blend as it did (equation 9):
 *   o' = 1 - (1 - o)^(1 / parts),
 *   sigma' / sigma = o / sum_{i=1..parts} sum_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1). */
struct relocate_share {
    double opacity, shrink;
};
struct relocate_share relocate_share(double opacity, unsigned parts);

#endif
