/* The surface of a store as a height field with uncertainty. Maps, contour lines, points, questions
 * about heights and comparisons use it. docs/decisions/028-surface.md gives the reasons for
 * each step.
 *
 * One ray a pixel is noisy where Gaussians are half transparent. Each pixel is therefore seen five
 * times: from straight above, and along slanted rays from four sides (lod/surface/nadir.h). The
 * five agree where the surface is, and the height is the median of those that agree. Then each
 * pixel gets the weighted median of 25 pixels around it, over about the size of a Gaussian. Pixels
 * of another colour have less weight, so edges of roofs stay where the orthophoto has them.
 *
 * The uncertainty is one standard deviation. It depends on the differences among the 25, on how
 * many of the five agree, on the size of the Gaussians and, at steps, on their height. One part is
 * common to all views and trainings: surfaces that training closed lie a little low.
 *
 * A pixel depends only on its neighbourhood, and pieces are drawn with the margin that this needs.
 * Neighbouring pieces therefore agree.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SURFACE_H
#define LOD_SURFACE_H

#include "lod/surface/nadir.h"

/* Maps [h][w] to compute; NULL: not wanted. NAN: less than half of the light from straight above is
 * stopped. */
struct surface_maps {
    float *rgb;      /* [h][w][3], 0 to 1, as in nadir_draw */
    float *height_m; /* ellipsoidal */
    float *sigma_m;  /* its standard deviation */
    /* sigma_m without the part of steps, and without the part that all views and all trainings have
     * in common: the uncertainty of a level place against others. */
    float *noise_m;
    /* sigma_m without that common part: the uncertainty of a surface against another of its kind */
    float *repeat_m;
};
/* Draws a piece. ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_MEM, ERR_LIMIT as in nadir_draw.
 */
enum err_code surface_draw(struct nadir *n, const struct nadir_piece *p,
                           const struct surface_maps *out, struct err *e) ERR_USE;

/* ---- parts, for tests ---- */

/* Pixels around a pixel: {2, 4} stands for 25 of them, at 0, 2 and 4 pixels to each side. */
struct surface_window {
    uint32_t near_px, far_px; /* near_px may equal far_px: 9 pixels */
};
/* The window for smoothing heights, if the usual Gaussian has sigma_px. */
struct surface_window surface_window(double sigma_px);
/* Smooths a height field [h][w] with colours [h][w][3]. out: weighted medians. spread_m: 1.48 times
 * the weighted median of absolute differences from them. NAN stays NAN. ERR_MEM. */
enum err_code surface_smooth(const float *height_m, const float *rgb, uint32_t w, uint32_t h,
                             struct surface_window win, float *out, float *spread_m,
                             struct err *e) ERR_USE;

#endif
