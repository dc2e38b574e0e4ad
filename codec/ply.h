/* INRIA .ply files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_H
#define CODEC_PLY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/gauss.h"
#include "core/geo.h"

struct codec_limits;

/* INRIA .ply, and on import SuperSplat's compressed one. Import finds properties by name, any
 * scalar type, skips unknown ones; SH degree from the number of f_rest. Comments "citysplat origin
 * lon lat h" are read and written (origin may be NULL; on read has_origin tells). Means are read
 * into float32 about origin_enu_m = 0 unless the file carries doubles. */
enum ply_axes { PLY_AXES_NONE, PLY_AXES_ENU, PLY_AXES_GLTF, PLY_AXES_UNKNOWN };
struct ply_info {
    bool has_origin;
    struct geo_origin origin;
    enum ply_axes
        axes; /* comment "axes ENU" or "axes glTF"; NONE: read, it said nothing; written, it is ENU
               * as every struct gauss is by default; UNKNOWN: write no comment */
};
enum err_code ply_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct ply_info *info, struct err *e) ERR_USE;
enum err_code ply_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct ply_info *info, struct err *e) ERR_USE;
enum err_code ply_encode(const struct gauss *g, const struct ply_info *info, struct buf *out,
                         struct err *e) ERR_USE;
#endif
