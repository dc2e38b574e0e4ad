/* What a .ply of Gaussians says in its comments about the frame that it is in.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_INFO_H
#define CODEC_PLY_INFO_H

#include <stdbool.h>

#include "core/geo.h"

/* Comment "axes ENU" or "axes glTF". NONE: read, it said nothing; written, it is ENU as every
 * struct gauss is by default. UNKNOWN: write no comment. */
enum ply_axes { PLY_AXES_NONE, PLY_AXES_ENU, PLY_AXES_GLTF, PLY_AXES_UNKNOWN };
struct ply_info {
    bool has_origin; /* comment "citysplat origin lon lat h" */
    struct geo_origin origin;
    enum ply_axes axes;
};

#endif
