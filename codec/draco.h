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

/* .drc: sequential point cloud of integer attributes. `tile` is text for the metadata; out is
 * appended to, the caller frees. ERR_MEM, ERR_INTERNAL (the library failed). Any thread. */
enum err_code draco_encode(const struct quant *q, const char *tile, struct buf *out,
                           struct err *e) ERR_USE;
/* Hostile bytes are safe: checked first (draco_check). quant_free it; empty on errors. ERR_FORMAT,
 * ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code draco_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct quant *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
