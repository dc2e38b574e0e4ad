/* .splat files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SPLAT_H
#define CODEC_SPLAT_H

#include "core/gauss.h"

struct codec_limits;

/* antimatter15's .splat: no header, so nothing but its size tells. SH degree 0, frame unknown.
 * gauss_free it; empty on errors. ERR_FORMAT, ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code splat_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct gauss *out, struct err *e) ERR_USE;
#endif
