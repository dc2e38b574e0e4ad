/* Pixels of photographs: from a COLMAP camera to a pinhole picture of limited size.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_INGEST_PHOTO_H
#define SCENE_INGEST_INGEST_PHOTO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/splat/camera.h"

struct codec_limits;

struct ingest_view {       /* conversion of one camera's photographs to pinhole pictures */
    struct lens lens;      /* at the size of the photograph */
    struct camera pinhole; /* intrinsics of the result; the pose is not used */
    uint32_t mid_width_px,
        mid_height_px; /* the photograph is first reduced to this size, then undistorted */
    bool undistort;
    size_t camera; /* index in the COLMAP model; set by ingest.c */
};
/* Chooses size and pinhole. The longest edge is at most max_edge_px. Without distortion the
 * intrinsics are kept. With distortion the focal length is the smallest for which every pixel has a
 * source. ERR_DATA: there is no such view. */
enum err_code ingest_view_make(const struct lens *lens, uint32_t width_px, uint32_t height_px,
                               uint32_t max_edge_px, struct ingest_view *out,
                               struct err *e) ERR_USE;
/* Maps an observation (pixels of the COLMAP camera `lens`) to the result. Returns false if it is
 * outside. */
bool ingest_view_map(const struct ingest_view *v, const struct lens *lens, double x_px, double y_px,
                     double *u_px, double *v_px);
/* The largest sample of a dark photograph: 14 bits in samples of 16 reach this much of 255. Of a
 * white one hardly a sample is below 255, as where floats count to 255. */
enum ingest_light { INGEST_LIGHT_USUAL, INGEST_LIGHT_DARK, INGEST_LIGHT_WHITE };
enum { INGEST_DARK_MOST = 64 };
/* Converts one photograph. If nothing changes and the format fits, its bytes are copied. *light:
 * how bright it is. ERR_NOENT, ERR_FORMAT, ERR_LIMIT: the photograph cannot be read. ERR_DATA: its
 * size is not the camera's. ERR_IO, ERR_MEM. */
enum err_code ingest_photo_convert(const struct ingest_view *v, const char *from, const char *to,
                                   const struct codec_limits *lim, enum ingest_light *light,
                                   struct err *e) ERR_USE;

#endif
