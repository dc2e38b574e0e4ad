/* The photometric loss on the device, and image metrics on the host.
 *
 *   L = l1_weight * mean|x - y| + ssim_weight * (1 - mean SSIM(x, y))
 *
 * x is the rendered colour, y the photograph, means over h * w * 3 (masked pixels are zero in both
 * and still count). SSIM: 11x11 Gaussian window of sigma 1.5, normalised, zero padded, per channel,
 * C1 = 0.01^2, C2 = 0.03^2 (Wang 2004). Partial sums are added in a fixed order: same input, same
 * bits.
 *
 * A training step is: render_forward -> loss_run(color -> grad) -> render_backward_step, with no
 * reading back; loss_read when a number is wanted.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_H
#define TRAIN_LOSS_H

#include "core/dev.h"

#define LOSS_L1_WEIGHT 0.8f
#define LOSS_SSIM_WEIGHT 0.2f

/* ---- loss.c: on the device ---- */

struct loss; /* compiled kernels and scratch buffers of one device, growing with the picture; one
                caller */
enum err_code loss_open(struct dev *dev, struct loss **out, struct err *e) ERR_USE;
void loss_close(struct loss **l);

struct loss_input { /* all borrowed */
    cl_mem color;   /* float [3][h][w] planar: render_color_buffer */
    cl_mem target;  /* uint8 [h][w][3]: the photograph, 255 = 1.0 */
    cl_mem mask;    /* uint8 [h][w], 0 = ignore this pixel; NULL = use all */
    uint32_t width_px, height_px;
    float l1_weight,
        ssim_weight; /* LOSS_L1_WEIGHT, LOSS_SSIM_WEIGHT; ssim_weight 0 skips that work */
    bool value_only; /* no gradient: `grad` of loss_run is not looked at */
};
/* Enqueue: write dL/dx into `grad`, float [3][h][w] planar (render_color_grad_buffer); 0 where
 * masked. Does not wait for the device. ERR_ARG for an empty picture, ERR_MEM (also when grad is
 * NULL, which is how render_color_grad_buffer tells that the device is full), ERR_LIMIT,
 * ERR_DEVICE. */
enum err_code loss_run(struct loss *l, const struct loss_input *in, cl_mem grad,
                       struct err *e) ERR_USE;

struct loss_value {              /* means over h * w * 3 of the last loss_run */
    double total, l1, ssim, mse; /* ssim: 1 when it was skipped */
};
/* Wait for the last loss_run and add up its partial sums. ERR_ARG when there was none. */
enum err_code loss_read(struct loss *l, struct loss_value *out, struct err *e) ERR_USE;

/* ---- loss_ref.c: the same in double on the host ---- */

/* rgb, target: [h][w][3]; mask [h][w] or NULL; grad [h][w][3] or NULL, written. */
enum err_code loss_ref_run(const double *rgb, const double *target, const uint8_t *mask,
                           uint32_t width_px, uint32_t height_px, double l1_weight,
                           double ssim_weight, double *grad, struct loss_value *out,
                           struct err *e) ERR_USE;

/* ---- metric.c: what an evaluation reports, in double ---- */

enum metric_window {
    METRIC_TRAINING, /* zero padded, every pixel has a window: what the loss uses */
    METRIC_VALID,    /* only windows that lie inside the picture: what evaluations usually report */
};
/* All clamp `rgb` [h][w][3] to 0..1 and compare it with `target` uint8 [h][w][3]; mask [h][w] or
 * NULL zeroes pixels in both. PSNR in dB for range 1, +infinity for equal pictures. SSIM is the
 * mean over pixels and channels; METRIC_VALID needs at least 11 x 11 pixels (ERR_ARG). */
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

#endif
