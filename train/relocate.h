/* Internal to train/: relocation of 3DGS-MCMC (Kheradmand et al. 2024). A Gaussian moves to the
 * place of another one, which is drawn with a chance proportional to opacity. The two then share
 * its opacity. Functions are pure; any thread may call them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RELOCATE_H
#define TRAIN_RELOCATE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { RELOCATE_MOST = 51 }; /* most Gaussians in one place, as in the published code */

/* The Gaussians that can be drawn, and with which chances. The same seed and stream draw the same.
 * Borrowed. */
struct relocate_from {
    const float *weight; /* by id, at least 0 */
    const uint32_t *ids; /* [n] */
    size_t n;
    uint64_t seed, stream;
};

/* Draws `room` times with chances proportional to weight, and adds to copies [by id] how often each
 * was drawn. Each is drawn at most RELOCATE_MOST - 1 times; further draws are not placed. *placed:
 * number of placed draws. ERR_MEM. */
enum err_code relocate_draw(const struct relocate_from *from, size_t room, uint8_t *copies,
                            size_t *placed, struct err *e) ERR_USE;

/* The opacity and size of `parts` Gaussians that replace one of opacity o and together blend as it
 * did (equation 9):
 *
 *     o' = 1 - (1 - o)^(1 / parts)
 *     sigma' / sigma = o / sum_{i=1..parts} sum_{k=0..i-1} C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1) */
struct relocate_share {
    double opacity, shrink;
};
struct relocate_share relocate_share(double opacity, unsigned parts);

#endif
