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

/* Appends a .drc to `out`: a sequential point cloud with integer attributes. `tile` is a text for
 * the metadata. The caller frees `out`. ERR_MEM, ERR_INTERNAL (the library failed). Any thread. */
enum err_code draco_encode(const struct quant *q, const char *tile, struct buf *out,
                           struct err *e) ERR_USE;
/* Reads a .drc. Hostile bytes are safe, because draco_check looks at them first. Free *out with
 * quant_free; it is empty on errors. ERR_FORMAT, ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code draco_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct quant *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
