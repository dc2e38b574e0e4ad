/* Image metrics on the host, in double.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_METRIC_H
#define LOSS_METRIC_H

#include <stdint.h>

#include "core/err.h"

enum metric_window {
    METRIC_TRAINING, /* zero padded, every pixel has a window: what the loss uses */
    METRIC_VALID,    /* only windows that lie inside the picture: what evaluations usually report */
};
/* All clamp `rgb` [h][w][3] to 0..1 and compare it with `target` uint8 [h][w][3]; mask [h][w]
 * (NULL: use all) is 0 where a pixel is not used. PSNR in dB for range 1, of the mean over the used
 * pixels, +infinity where they are equal; ERR_DATA where there are none. SSIM and GMSD see black in
 * both pictures where the mask is 0 and are means over all pixels, as in the loss. SSIM is the mean
 * over pixels and channels; METRIC_VALID needs at least 11 x 11 pixels (ERR_ARG). */
enum err_code metric_psnr(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out_db,
                          struct err *e) ERR_USE;
enum err_code metric_ssim(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, enum metric_window window,
                          double *out, struct err *e) ERR_USE;
/* Gradient Magnitude Similarity Deviation of the grey levels (Xue 2014): a perceptual metric that
 * needs no weights; 0 for equal pictures, lower is better. At least 4 x 4 pixels (ERR_ARG). */
enum err_code metric_gmsd(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out,
                          struct err *e) ERR_USE;
/* PSNR, SSIM and GMSD of the pixels of a mask alone [h][w]: others take the target's colour in both
 * pictures, so what is drawn there counts nothing, and means are over used pixels (GMSD: over means
 * of 2 x 2 of them). ERR_ARG below 4 x 4 pixels, ERR_DATA when the mask is empty. */
struct metric_scores {
    double psnr_db, ssim, gmsd;
};
enum err_code metric_within(const float *rgb, const uint8_t *target, const uint8_t *mask,
                            uint32_t width_px, uint32_t height_px, struct metric_scores *out,
                            struct err *e) ERR_USE;
#endif
