/* PlayCanvas' SOG, version 2: Gaussians as lossless WebP textures in a zip.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SOG_H
#define CODEC_SOG_H

#include "core/base.h"
#include "core/gauss.h"

struct codec_limits;

/* One .sog, appended to out. g: in glTF axes, means relative to its origin; sh_degree at most its
 * own. Embeddings are left out. ERR_DATA (none, or not finite), ERR_ARG, ERR_LIMIT, ERR_MEM. Any
 * thread, deterministic. */
enum err_code sog_encode(const struct gauss *g, uint32_t sh_degree, struct buf *out,
                         struct err *e) ERR_USE;
/* The same as files of a folder, meta.json among them: a chunk of a streamed SOG. ERR_IO, ERR_LIMIT
 * (path) as well. */
enum err_code sog_write(const struct gauss *g, uint32_t sh_degree, const char *dir,
                        struct err *e) ERR_USE;
/* Version 2, into glTF axes; hostile bytes are safe. gauss_free it; empty on errors. ERR_FORMAT,
 * ERR_DATA, ERR_LIMIT, ERR_MEM. */
enum err_code sog_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e) ERR_USE;
#endif
