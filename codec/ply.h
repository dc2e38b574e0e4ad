/* INRIA .ply files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_H
#define CODEC_PLY_H

#include <stddef.h>

#include "codec/ply_info.h"
#include "core/err.h"

struct buf;
struct codec_limits;
struct gauss;

/* INRIA .ply, and on import SuperSplat's compressed one. Import finds properties by name, any
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
#endif
