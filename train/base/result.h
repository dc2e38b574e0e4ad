/* Results of training.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RESULT_H
#define TRAIN_RESULT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "train/base/config.h"
#include "train/base/timing.h"

struct train_cell_result {
    char id[32];
    bool was_done; /* it was complete before; the other members come from done.json */
    uint32_t n_levels;
    size_t n_gaussians[TRAIN_LEVELS_MAX];
    double psnr_db[TRAIN_LEVELS_MAX],
        ssim[TRAIN_LEVELS_MAX];   /* of test photographs at training size; NaN = none */
    size_t n_test;                /* test photographs behind these scores; 0 where was_done */
    double seconds;               /* of all processes that worked on the cell */
    struct timing_seconds timing; /* of this process alone, without the time before --resume */
};
struct train_result { /* {0} is empty; free with train_result_free */
    struct train_cell_result *cells;
    size_t n_cells;
    double seconds;
    size_t peak_bytes;
};

#endif
