/* .splat files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SPLAT_H
#define CODEC_SPLAT_H

#include "core/splat/gauss.h"

struct codec_limits;

/* Reads antimatter15's .splat. It has no header, so only its size can be checked. The SH degree is
 * 0 and the frame is not known. Free *out with gauss_free; it is empty on errors. Unusable
 * rows are left out. ERR_FORMAT, ERR_DATA, ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code splat_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct gauss *out, struct err *e) ERR_USE;
#endif
