/* Draco files of Gaussians (draco_shim.cc).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_DRACO_H
#define CODEC_DRACO_H

#include "core/base.h"

struct codec_limits;
struct quant;

#ifdef __cplusplus
extern "C" {
#endif

/* .drc: sequential point cloud of integer attributes (draco_shim.cc). `tile` is text for the
 * metadata. */
enum err_code draco_encode(const struct quant *q, const char *tile, struct buf *out,
                           struct err *e) ERR_USE;
enum err_code draco_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct quant *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
