/* The loss on solid surfaces: light stops at one depth, the known one, and no light passes through
 * ground that photographs see.
 *
 * For a pixel, A = 1 - T, and n is the number of pixels. Where depths are known, the term is on the
 * frame's sums about them (render_moments_buffer), S and W:
 *
 *     balance = 1/n sum (A p(S / A) + SOLID_AWAY W),   p' = 4 q (1 - 4 q^2)^2 / sqrt(q^2 + e^2)
 *
 * with p(0) = 0 and e = SOLID_SOFT_SIDE. By the first part about half of the light stops before the
 * known depth and half behind it: as a median, and unlike a mean, that is hardly moved by how far
 * behind the surface something lies. So large Gaussians may lie behind small ones, which pictures
 * need. |q| is at most 1/2. Near 0 the loss is A times the distance in footprints; where all light
 * is far off to one side, it has hardly any gradient: there the pixel shows something else than the
 * map (edges, narrow courts, trees). The second part is for light far from the depth, above all
 * before it.
 *
 * In photographs without known depths, D = sum w m / A, V = sum w m^2 / A - D^2, zeta = 1 + D the
 * depth of the pixel in units of the frame's, focal the focal length in pixels, and e =
 * SOLID_SOFT_PX zeta / focal:
 *
 *     spread = 1/n sum A c/2 (r / (1 + r^2) + atan r),   r = s / c,   c = SOLID_REACH_PX,
 *              s = focal / zeta (sqrt(V + e^2) - e)
 *
 * s is how much depths differ along the ray, in footprints of a pixel. The term is A s where r is
 * small, and its slope falls with 1 / (1 + r^2)^2 (Geman and McClure 1985). At an edge two surfaces
 * share the light of a pixel. A loss with a gradient there, even a small one, lifts the ground of
 * narrow courts. V is the distortion of a ray in 2DGS (Huang et al. 2024; first in Mip-NeRF 360,
 * Barron et al. 2022), without the factor A^2.
 *
 *     light  = 1/n sum of h(T) over the supported pixels; light_known: those of known depth
 * h = T^2 / (2 t) below t = SOLID_LIGHT_T, T - t/2 above: closed ground has hardly any gradient
 *
 * A in front of p and of spread, and focal / zeta, are constants in the gradient: else a Gaussian
 * would lower the loss by moving away from the camera. W has no such factor: light far away also
 * becomes fainter.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_SOLID_H
#define TRAIN_LOSS_SOLID_H

#include <stdint.h>

#include "render/render.h"

#define SOLID_AWAY 3.0       /* weight of what is away beside balance */
#define SOLID_SOFT_SIDE 0.05 /* the gradient of a smaller imbalance goes to 0 */
#define SOLID_SOFT_PX 0.25   /* the gradient of smaller spreads goes to 0 */
#define SOLID_REACH_PX 4.0   /* the gradient of larger spreads goes to 0 */
#define SOLID_LIGHT_T 0.03   /* the gradient of less light falls with it */
#define SOLID_COVER_MIN 0.1  /* least A of a pixel with balance or spread */

struct solid_input {
    uint32_t width_px, height_px;
    double focal_px; /* fx */
    /* weights; spread: of balance, too; light_known: where depth is known */
    double spread, light, light_known;
    const uint8_t *supported; /* [h][w], not 0: light counts; NULL: nowhere; borrowed */
    const float *known;       /* render_options.known of the frame; borrowed */
};
struct solid_value {
    double spread, light, light_known; /* the terms without weights */
};
struct solid; /* compiled kernels and buffers */
/* Builds the kernel. Free *out with solid_close. ERR_DEVICE, ERR_MEM. */
enum err_code solid_open(struct dev *dev, struct solid **out, struct err *e) ERR_USE;
void solid_close(struct solid **s);
/* Hands `supported` over without waiting. Call it before the frame is drawn: then it must stay as
 * it is only until render_forward returns. Waits if it fails. ERR_MEM, ERR_DEVICE. */
enum err_code solid_hand_over(struct solid *s, const struct solid_input *in, struct err *e) ERR_USE;
/* Enqueues, with what was handed over: writes the gradient of the sums along the rays
 * (render_moments_grad_buffer) for the renderer's last frame, which must have this size and sums
 * about `known`. ERR_ARG: there is no such frame. ERR_MEM, ERR_DEVICE. */
enum err_code solid_run(struct solid *s, struct render *r, const struct solid_input *in,
                        struct err *e) ERR_USE;

/* Reference in double on the host. sums [h][w][3]: both sums along the ray, T. held: the sums from
 * which the fixed factors are computed. It equals sums, except for finite differences. */
struct solid_value solid_ref_value(const struct solid_input *in, const double *sums,
                                   const double *held);
/* Writes grad [h][w][3] of spread * weight + ... */
void solid_ref_grad(const struct solid_input *in, const double *sums, double *grad);
#endif
