/* Parts of the ground, on which terms of the loss act differently.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_GROUND_PARTS_H
#define TRAIN_LOSS_GROUND_PARTS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* LIMITED: sizes have a smaller limit (train/loss/scale_loss.h). FLAT: Gaussians are flat
 * (train/loss/flat_loss.h). */
enum ground_part { GROUND_PART_LIMITED = 1, GROUND_PART_FLAT = 2 };
struct ground_parts {     /* borrowed */
    const uint8_t *parts; /* [ny][nx] of enum ground_part, row 0 is the southernmost */
    size_t nx, ny;
    double corner_m[2], cell_m; /* south-west corner, ENU; edge of a cell */
};
/* Whether a place (ENU, m) lies on a part of it. */
static inline bool ground_parts_has(const struct ground_parts *g, const double *mean,
                                    enum ground_part part)
{
    double column = floor((mean[0] - g->corner_m[0]) / g->cell_m),
           row = floor((mean[1] - g->corner_m[1]) / g->cell_m);
    bool known = column >= 0.0 && row >= 0.0 && column < (double)g->nx && row < (double)g->ny;
    return known && g->parts[(size_t)row * g->nx + (size_t)column] & part;
}

#endif
