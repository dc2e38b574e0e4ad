/* The photometric loss on the device.
 *
 *     L = l1_weight * mean|x - y| + ssim_weight * (1 - mean SSIM(x, y))
 *
 * x is the rendered colour and y the photograph. Means are over h * w * 3; masked pixels are zero
 * in both and still count. SSIM has an 11x11 Gaussian window of sigma 1.5, normalised and zero
 * padded, for each channel, with C1 = 0.01^2 and C2 = 0.03^2 (Wang 2004). Partial sums are added in
 * a fixed order: the same input gives the same bits.
 *
 * A training step is: render_forward -> photometric_run(color -> grad) -> render_backward_step. It
 * reads nothing back. Call photometric_read when the value is needed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_PHOTOMETRIC_H
#define TRAIN_LOSS_PHOTOMETRIC_H

#include "core/device/dev.h"

#define PHOTOMETRIC_L1_WEIGHT 0.8f
#define PHOTOMETRIC_SSIM_WEIGHT 0.2f

/* ---- photometric.c: on the device ---- */

/* Compiled kernels and scratch buffers of one device, which grow with the picture. Only one thread
 * may use it. */
struct photometric;
/* Builds the kernels. Free *out with photometric_close. ERR_DEVICE, ERR_MEM. */
enum err_code photometric_open(struct dev *dev, struct photometric **out, struct err *e) ERR_USE;
void photometric_close(struct photometric **l);

struct photometric_input { /* all borrowed */
    cl_mem color;          /* float [3][h][w] planar: render_color_buffer */
    cl_mem target;         /* uint8 [h][w][3]: the photograph, 255 = 1.0 */
    cl_mem mask;           /* uint8 [h][w], 0 = ignore this pixel; NULL = use all */
    uint32_t width_px, height_px;
    /* usually PHOTOMETRIC_L1_WEIGHT and PHOTOMETRIC_SSIM_WEIGHT; ssim_weight 0 skips SSIM */
    float l1_weight, ssim_weight;
    bool value_only; /* no gradient: photometric_run ignores `grad` */
};
/* Enqueues the loss, and writes dL/dx to `grad`, float [3][h][w] planar (render_color_grad_buffer);
 * masked pixels get 0. It does not wait for the device. ERR_ARG: the picture is empty. ERR_MEM,
 * also if grad is NULL: render_color_grad_buffer returns NULL when the device is full. ERR_LIMIT,
 * ERR_DEVICE. */
enum err_code photometric_run(struct photometric *l, const struct photometric_input *in,
                              cl_mem grad, struct err *e) ERR_USE;

struct photometric_value {       /* means over h * w * 3 of the last photometric_run */
    double total, l1, ssim, mse; /* ssim: 1 if it was skipped */
};
/* Waits for the last photometric_run and adds its partial sums. ERR_ARG: there was none.
 * ERR_DEVICE. */
enum err_code photometric_read(struct photometric *l, struct photometric_value *out,
                               struct err *e) ERR_USE;

/* ---- photometric_ref.c: the same in double on the host ---- */

/* rgb, target [h][w][3]; mask [h][w] or NULL; grad [h][w][3] or NULL, overwritten. ERR_ARG: the
 * picture is empty. ERR_MEM. */
enum err_code photometric_ref_run(const double *rgb, const double *target, const uint8_t *mask,
                                  uint32_t width_px, uint32_t height_px, double l1_weight,
                                  double ssim_weight, double *grad, struct photometric_value *out,
                                  struct err *e) ERR_USE;

#endif
