/* Image metrics on the host, in double.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_METRIC_H
#define TRAIN_LOSS_METRIC_H

#include <stdint.h>

#include "core/err.h"

enum metric_window {
    METRIC_TRAINING, /* zero padded, a window at every pixel, as in the loss */
    METRIC_VALID,    /* only windows inside the picture, as evaluations usually report */
};
/* Metrics of rgb [h][w][3], clamped to 0..1, against target uint8 [h][w][3]. mask [h][w] (NULL: use
 * all) is 0 at unused pixels. PSNR is in dB for range 1, from the mean over used pixels; equal
 * pictures have +infinity. ERR_DATA: no pixel is used. SSIM and GMSD see black in both pictures at
 * unused pixels, and are means over all pixels, as in the loss. SSIM is the mean over pixels and
 * channels. METRIC_VALID needs at least 11 x 11 pixels (ERR_ARG). ERR_MEM. */
enum err_code metric_psnr(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out_db,
                          struct err *e) ERR_USE;
enum err_code metric_ssim(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, enum metric_window window,
                          double *out, struct err *e) ERR_USE;
/* SSIM by both windows from one map; *valid is NAN where the picture is too small for it. ERR_ARG:
 * the picture is empty. ERR_MEM. */
enum err_code metric_ssim_both(const float *rgb, const uint8_t *target, const uint8_t *mask,
                               uint32_t width_px, uint32_t height_px, double *training,
                               double *valid, struct err *e) ERR_USE;
/* Gradient Magnitude Similarity Deviation of the grey levels (Xue 2014), a perceptual metric
 * without weights. Lower is better; equal pictures have 0. ERR_ARG: less than 4 x 4 pixels.
 * ERR_MEM. */
enum err_code metric_gmsd(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out,
                          struct err *e) ERR_USE;
/* PSNR, SSIM and GMSD of the masked part [h][w] alone. Elsewhere both pictures get the target's
 * colour, so drawings there do not count. Means are over used pixels; for GMSD over means of 2 x 2
 * of them. ERR_ARG: less than 4 x 4 pixels. ERR_DATA: the mask is empty. ERR_MEM. */
struct metric_scores {
    double psnr_db, ssim, gmsd;
};
enum err_code metric_within(const float *rgb, const uint8_t *target, const uint8_t *mask,
                            uint32_t width_px, uint32_t height_px, struct metric_scores *out,
                            struct err *e) ERR_USE;
#endif
