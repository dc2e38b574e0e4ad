/* Internal to train/loss/: the map of structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004)
 * of the metrics, in double on all cores. photometric_ref.c has the same map with its derivatives.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_SSIM_H
#define TRAIN_LOSS_SSIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct ssim_input {
    const float *rgb;      /* [h][w][3], used clamped to 0..1; NaN counts as 0 */
    const uint8_t *target; /* [h][w][3] */
    const uint8_t *mask;   /* [h][w], 0: unused pixel; NULL: all are used */
    bool within; /* what both pictures show at unused pixels: the target's colour, else black */
    size_t width_px, height_px;
};
/* map [3][h][w] = SSIM at every pixel of every channel, by a window of 11 x 11, zero padded. The
 * same bits for any number of threads. ERR_MEM. */
enum err_code ssim_map(const struct ssim_input *in, double *map, struct err *e) ERR_USE;

#endif
