/* SPZ files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SPZ_H
#define CODEC_SPZ_H

#include "core/base.h"

struct codec_limits;
struct quant;

/* .spz, versions 2, 3, 4 read; 3 and 4 written. */
enum err_code spz_encode(const struct quant *q, int version, struct buf *out,
                         struct err *e) ERR_USE;
enum err_code spz_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct quant *out, struct err *e) ERR_USE;
#endif
