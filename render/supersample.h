/* Filters pictures that were drawn at a higher resolution down to their size: supersample.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_SUPERSAMPLE_H
#define RENDER_SUPERSAMPLE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { SUPERSAMPLE_MOST = 4, SUPERSAMPLE_PLANES = 4 };

/* Makes a picture of n planes [n][factor height_px][factor width_px]: out [height_px][width_px][n].
 * With factor 1 values are copied. Otherwise the filter is a Gaussian with a variance of kernel_px2
 * (factor^2 - 1) fine pixels. Together with the kernel that the fine picture was drawn with, the
 * variance is kernel_px2 square pixels of the small picture. At the border, weights outside are
 * left out and the rest is scaled to 1. factor is 1..SUPERSAMPLE_MOST, n 1..SUPERSAMPLE_PLANES,
 * kernel_px2 at most 0.5. It runs in parallel; the bits do not depend on the number of threads.
 * ERR_MEM. */
enum err_code supersample_reduce(const float *planes, size_t n, uint32_t width_px,
                                 uint32_t height_px, uint32_t factor, double kernel_px2, float *out,
                                 struct err *e) ERR_USE;

#endif
