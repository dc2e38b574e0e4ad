/* Internal to loss/: the SSIM map in double, for the reference loss and the metrics.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_PHOTOMETRIC_REF_H
#define LOSS_PHOTOMETRIC_REF_H

#include <stddef.h>

/* out = K in: a separable 11x11 Gaussian window with sigma 1.5, zero padded. All planes are [h][w].
 */
void photometric_ref_blur(const double *in, size_t w, size_t h, double *tmp, double *out);
/* SSIM at every pixel of one channel, zero padded. scratch has photometric_ref_scratch_planes()
 * planes [h][w]. */
void photometric_ref_ssim(const double *x, const double *y, size_t w, size_t h, double *scratch,
                          double *map);
size_t photometric_ref_scratch_planes(void);

#endif
