/* INRIA .ply files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_H
#define CODEC_PLY_H

#include <stddef.h>
#include <stdint.h>

#include "codec/ply_info.h"
#include "core/err.h"

struct buf;
struct codec_limits;
struct gauss;

/* INRIA .ply, and SuperSplat's compressed one. Import finds properties by name, any
 * scalar type, skips unknown ones; SH degree from the number of f_rest. Comments "citysplat origin
 * lon lat h" are read and written (origin may be NULL; on read has_origin tells). Means are read
 * into float32 about origin_enu_m = 0 unless the file carries doubles. gauss_free it; empty on
 * errors. info may be NULL. ERR_NOENT, ERR_IO (of ply_read), ERR_FORMAT names line or property,
 * ERR_DATA, ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code ply_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct ply_info *info, struct err *e) ERR_USE;
enum err_code ply_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct ply_info *info, struct err *e) ERR_USE;
/* Appended to out. ERR_MEM. */
enum err_code ply_encode(const struct gauss *g, const struct ply_info *info, struct buf *out,
                         struct err *e) ERR_USE;
/* SuperSplat's compressed one, of bands up to sh_degree; embeddings are left out. Rows stay in
 * their order, which should be that of space (gauss_hilbert_order): 256 share a box. Appended to
 * out. ERR_DATA (not finite), ERR_ARG (sh_degree above g's), ERR_MEM. */
enum err_code ply_packed_encode(const struct gauss *g, uint32_t sh_degree,
                                const struct ply_info *info, struct buf *out,
                                struct err *e) ERR_USE;
#endif
