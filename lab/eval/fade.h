/* Cross-fade between levels: the tiles of a frame and their shares of opacity, while some tiles
 * replace others.
 *
 * New tiles become opaque while old ones fade
 * (docs/decisions/038-viewer-loading-and-light.md gives the reasons). There is one fade at a time.
 * Tiles wanted during a fade wait for its end, unless nothing is drawn in their place. The viewer
 * uses the same curve and rule (web/src/fade.ts). tests/vectors/fade.json tests both.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_FADE_H
#define LAB_FADE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct tree;

/* The curve: the share of opacity of new tiles when the part t of a fade has passed. Old tiles have
 * the rest. */
double fade_share(double t);

struct fade {                /* {0} is empty; free with fade_close */
    const struct tree *tree; /* borrowed */
    /* frames: length of a fade; frame: position in the current one, 0: none */
    size_t frames, frame;
    bool *above, *from, *to; /* [n_nodes], one block: scratch, tiles before, tiles after */
};
/* `frames` is the length of a fade. 0 and 1: tiles change at once. Free *out with fade_close.
 * ERR_MEM. */
enum err_code fade_open(const struct tree *t, size_t frames, struct fade *out,
                        struct err *e) ERR_USE;
void fade_close(struct fade *f);
/* Computes the next frame, whose camera wants the tiles wanted[0..n), ascending. It writes the
 * tiles to draw, ascending, and their shares of opacity, above 0. tile and weight have [n_nodes]
 * elements. Returns the number of tiles. */
size_t fade_next(struct fade *f, const uint32_t *wanted, size_t n, uint32_t *tile, float *weight);

#endif
