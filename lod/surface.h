/* The surface of a store as a height field with an uncertainty: what maps, contour lines, points,
 * questions about heights and comparisons are made of. docs/decisions/061-one-surface.md says what
 * each step was chosen for.
 *
 * One ray a pixel is noisy where Gaussians are half transparent. So each pixel is seen five times,
 * from straight above and along slanted rays from four sides (lod/nadir.h), which agree where the
 * surface is. Of those that do, the median counts. Then each pixel takes the weighted median of 25
 * around it, over about the size of a Gaussian; pixels of another colour weigh less, so edges of
 * roofs stay where the orthophoto has them.
 *
 * The uncertainty is one standard deviation. It comes from how the 25 differ, from how many of the
 * five agree, from the size of the Gaussians and, at steps, from their height.
 *
 * A pixel depends on its neighbourhood alone, and pieces are drawn with the margin that it needs:
 * pieces side by side agree.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SURFACE_H
#define LOD_SURFACE_H

#include "lod/nadir.h"

/* All [h][w], to be filled; NULL: not wanted. NAN where no light is stopped at a surface: less than
 * half of it, from straight above. */
struct surface_maps {
    float *rgb;      /* [h][w][3], 0 to 1, of nadir_draw */
    float *height_m; /* ellipsoidal */
    float *sigma_m;  /* its standard deviation */
    float *noise_m;  /* the same without what steps add: how well the height of a level place is
                        known, wherever the edges are */
};
/* Errors of nadir_draw: ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_MEM, ERR_LIMIT. */
enum err_code surface_draw(struct nadir *n, const struct nadir_piece *p,
                           const struct surface_maps *out, struct err *e) ERR_USE;

/* ---- the parts, for tests ---- */

/* Pixels around a pixel: {0, 2, 4} stands for 25 of them, at 0, 2 and 4 pixels to each side. */
struct surface_window {
    uint32_t near_px, far_px; /* near may equal far: 9 pixels */
};
/* The window over which heights are taken together, where the usual Gaussian has sigma_px. */
struct surface_window surface_window(double sigma_px);
/* Of one height field [h][w] with colours [h][w][3]: weighted medians and how the pixels around
 * differ from them (1.48 times the weighted median of absolute differences). NAN stays NAN.
 * ERR_MEM. */
enum err_code surface_smooth(const float *height_m, const float *rgb, uint32_t w, uint32_t h,
                             struct surface_window win, float *out, float *spread_m,
                             struct err *e) ERR_USE;

#endif
