/* The frame of a .ply of Gaussians, as its comments state it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_INFO_H
#define CODEC_PLY_INFO_H

#include <stdbool.h>

#include "core/geo/geo.h"
#include "core/geo/heights.h"

/* The comment "axes ENU" or "axes glTF". NONE: a file that was read has no such comment; a file to
 * write is in ENU. UNKNOWN: write no comment. */
enum ply_axes { PLY_AXES_NONE, PLY_AXES_ENU, PLY_AXES_GLTF, PLY_AXES_UNKNOWN };
struct ply_info {
    bool has_origin; /* comment "citysplat origin lon lat h" */
    struct geo_origin origin;
    enum ply_axes axes;
    /* comment "citysplat heights sea-exif": what the origin's height counts from */
    char heights[HEIGHTS_MAX];
};

#endif
