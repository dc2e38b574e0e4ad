/* SPZ files of Gaussians. Functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SPZ_H
#define CODEC_SPZ_H

#include "core/base.h"

struct codec_limits;
struct quant;

/* Appends a .spz of version 3 or 4 to `out`. ERR_ARG (version), ERR_LIMIT, ERR_MEM. */
enum err_code spz_encode(const struct quant *q, int version, struct buf *out,
                         struct err *e) ERR_USE;
/* Reads versions 1 to 4 into glTF axes. Hostile bytes are safe. Free *out with quant_free; it is
 * empty on errors. ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code spz_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct quant *out, struct err *e) ERR_USE;
#endif
