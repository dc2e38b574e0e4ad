/* The loss on solid surfaces has two terms. spread is small where all light of a ray comes from
 * about one depth: from the known depth, if the pixel has one. light is small where no light passes
 * through ground that photographs see.
 *
 * For a pixel, A = 1 - T, D = sum w m / A and V = sum w m^2 / A - D^2 (render_moments_buffer). zeta
 * = 1 + D is its depth in units of the frame's depth. focal is the focal length in pixels, e =
 * SOLID_SOFT_PX zeta / focal, and n the number of pixels. In a photograph with known depths z =
 * SOLID_FREE_PX zeta / focal, else 0.
 *
 *     spread = 1/n sum A c/2 (r / (1 + r^2) + atan r),   r = s / c,   c = SOLID_REACH_PX,
 *              s = focal / zeta (sqrt(b^2 + u^2 + e^2) - e),   u = max(sqrt V - z, 0);
 *              b = zeta - zeta* where a depth zeta* is known, else 0; of a photograph with known
 *              depths, over pixels of known depth alone
 *     light  = 1/n sum of h(T) over the supported pixels; light_known: those of known depth
 * h = T^2 / (2 t) below t = SOLID_LIGHT_T, T - t/2 above: closed ground has hardly any gradient
 *
 * s is how far off the depth is, and how much depths differ along the ray, in footprints of a
 * pixel. A layer as thick as a footprint, half of one to both sides, is free where its depth is
 * known: in a thinner one the view decides which Gaussian is in front, and pictures lose. The terms
 * are A s where r is small, and their slopes fall with 1 / (1 + r^2)^2 (Geman and McClure 1985), so
 * large values have hardly any gradient. At an edge two surfaces share the light of a pixel. A loss
 * with a gradient there, even a small one, lifts the ground of narrow courts. A and focal / zeta
 * are constants in the gradient: else a Gaussian would lower the loss by moving away from the
 * camera.
 *
 * V is the distortion of a ray in 2DGS (Huang et al. 2024; first in Mip-NeRF 360, Barron et al.
 * 2022), without the factor A^2.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_SOLID_H
#define TRAIN_LOSS_SOLID_H

#include <stdint.h>

#include "render/render.h"

#define SOLID_FREE_PX 0.5   /* a standard deviation about a known depth without a loss */
#define SOLID_SOFT_PX 0.25  /* the gradient of smaller spreads goes to 0 */
#define SOLID_REACH_PX 4.0  /* the gradient of larger spreads goes to 0 */
#define SOLID_LIGHT_T 0.03  /* the gradient of less light falls with it */
#define SOLID_COVER_MIN 0.1 /* least A of a pixel with a spread */

struct solid_input {
    uint32_t width_px, height_px;
    double focal_px;                   /* fx */
    double spread, light, light_known; /* weights; light_known: where depth is known */
    const uint8_t *supported;          /* [h][w], not 0: light counts; NULL: nowhere; borrowed */
    /* [h][w] known_zeta / zeta*; at most 0: not known; NULL: nowhere; borrowed */
    const float *known;
    double known_zeta;
};
struct solid_value {
    double spread, light, light_known; /* the terms without weights */
};
struct solid; /* compiled kernels and buffers */
/* Builds the kernel. Free *out with solid_close. ERR_DEVICE, ERR_MEM. */
enum err_code solid_open(struct dev *dev, struct solid **out, struct err *e) ERR_USE;
void solid_close(struct solid **s);
/* Hands `supported` and `known` over without waiting. Call it before the frame is drawn: then they
 * must stay as they are only until render_forward returns. Waits if it fails. ERR_MEM,
 * ERR_DEVICE. */
enum err_code solid_hand_over(struct solid *s, const struct solid_input *in, struct err *e) ERR_USE;
/* Enqueues, with what was handed over: writes the renderer's gradient of the moments
 * (render_moments_grad_buffer) for its last frame, which must have moments and this size. ERR_ARG:
 * there is no such frame. ERR_MEM, ERR_DEVICE. */
enum err_code solid_run(struct solid *s, struct render *r, const struct solid_input *in,
                        struct err *e) ERR_USE;

/* Reference in double on the host. moments [h][w][3]: sum w m, sum w m^2, T. held: the moments from
 * which the fixed factors are computed. It equals moments, except for finite differences. */
struct solid_value solid_ref_value(const struct solid_input *in, const double *moments,
                                   const double *held);
/* Writes grad [h][w][3] of spread * weight + ... */
void solid_ref_grad(const struct solid_input *in, const double *moments, double *grad);
#endif
