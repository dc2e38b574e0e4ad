/* Pictures drawn finer than they are shown, and filtered down: supersample.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_SUPERSAMPLE_H
#define RENDER_SUPERSAMPLE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { SUPERSAMPLE_MOST = 4 };

/* out [height_px][width_px], `stride` floats apart, of plane [factor height_px][factor width_px]: a
 * Gaussian of variance kernel_px2 (factor^2 - 1) fine pixels, which with the kernel that the fine
 * picture was drawn with makes kernel_px2 of the small one's pixels. Weights at the border are of
 * what is inside. factor 2..SUPERSAMPLE_MOST, kernel_px2 at most 0.5. Parallel; same bits for any
 * number of threads. ERR_MEM. */
enum err_code supersample_reduce(const float *plane, uint32_t width_px, uint32_t height_px,
                                 uint32_t factor, double kernel_px2, float *out, size_t stride,
                                 struct err *e) ERR_USE;

#endif
