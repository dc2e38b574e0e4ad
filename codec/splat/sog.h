/* PlayCanvas' SOG, version 2: Gaussians as lossless WebP textures in a zip. Functions are
 * deterministic and may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SOG_H
#define CODEC_SOG_H

#include "core/base.h"
#include "core/splat/gauss.h"

struct codec_limits;

/* Appends a .sog to `out`. g is in glTF axes, with means relative to its origin. sh_degree is at
 * most that of g. Embeddings are left out. ERR_DATA (no Gaussians, or a value is not finite),
 * ERR_ARG, ERR_LIMIT, ERR_MEM. */
enum err_code sog_encode(const struct gauss *g, uint32_t sh_degree, struct buf *out,
                         struct err *e) ERR_USE;
/* Reads versions 1 and 2 into glTF axes. Hostile bytes are safe. Unusable rows are left out. Free
 * *out with gauss_free; it is empty on errors. ERR_FORMAT, ERR_DATA, ERR_LIMIT, ERR_MEM. */
enum err_code sog_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e) ERR_USE;
/* As sog_decode, from a folder: `path` is that of its meta.json. Also ERR_NOENT, ERR_IO. */
enum err_code sog_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct err *e) ERR_USE;
#endif
