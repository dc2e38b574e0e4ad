/* Cross-fade between levels: which tiles a frame is drawn from while others take the place of some,
 * and with how much of their opacity.
 *
 * What comes rises as what goes falls (docs/decisions/052-cross-fade.md says why not one after the
 * other). One fade at a time: what is wanted meanwhile waits for its end, except tiles that nothing
 * stands for. The viewer fades by the same curve and rule (web/src/fade.ts);
 * tests/vectors/fade.json holds both to them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_FADE_H
#define LOD_FADE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct tree;

/* The curve: the share of its opacity that what comes has after the part t of a fade; what goes has
 * the rest. */
double fade_share(double t);

struct fade {                /* {0} is empty */
    const struct tree *tree; /* borrowed */
    size_t frames, frame;    /* of a fade; of the one under way, 0: none is */
    bool *above, *from, *to; /* [n_nodes], one block: scratch, what was there, what is to be */
};
/* frames: how many a fade takes; 0 and 1: tiles change at once. fade_close it. ERR_MEM. */
enum err_code fade_open(const struct tree *t, size_t frames, struct fade *out,
                        struct err *e) ERR_USE;
void fade_close(struct fade *f);
/* The next frame, whose camera wants tiles wanted[0..n), ascending: the tiles to draw it from,
 * ascending, and their shares of opacity, above 0. tile, weight: [n_nodes] each. */
size_t fade_next(struct fade *f, const uint32_t *wanted, size_t n, uint32_t *tile, float *weight);

#endif
