/* What the training of cells came to.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RESULT_H
#define TRAIN_RESULT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "train/config.h"
#include "train/timing.h"

struct train_cell_result {
    char id[32];
    bool was_done; /* it was complete before: the rest is what done.json says */
    uint32_t n_levels;
    size_t n_gaussians[TRAIN_LEVELS_MAX];
    double psnr_db[TRAIN_LEVELS_MAX],
        ssim[TRAIN_LEVELS_MAX];   /* test photographs at training size; NaN = none */
    double seconds;               /* of all processes that worked on it */
    struct timing_seconds timing; /* of this process: what came before --resume is not in it */
};
struct train_result { /* {0} is empty; train_result_free */
    struct train_cell_result *cells;
    size_t n_cells;
    double seconds;
    size_t peak_bytes;
};

#endif
