/* Pixels of photographs: from a COLMAP camera to a pinhole picture of bounded size.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_INGEST_PHOTO_H
#define INGEST_INGEST_PHOTO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/camera.h"

struct codec_limits;

struct ingest_view {       /* how one camera's photographs become pinhole pictures */
    struct lens lens;      /* at the size of the photograph itself */
    struct camera pinhole; /* intrinsics of the result; pose unused */
    uint32_t mid_width_px,
        mid_height_px; /* the photograph is first shrunk to this, then undistorted */
    bool undistort;
    size_t camera; /* index in the COLMAP model; set by ingest.c */
};
/* Choose size and pinhole: longest edge at most max_edge_px; without distortion the intrinsics are
 * kept, with it the focal length is the smallest that leaves no pixel without a source. ERR_DATA:
 * no such view. */
enum err_code ingest_view_make(const struct lens *lens, uint32_t width_px, uint32_t height_px,
                               uint32_t max_edge_px, struct ingest_view *out,
                               struct err *e) ERR_USE;
/* Where an observation (pixels of the COLMAP camera `lens`) lies in the result; false when outside.
 */
bool ingest_view_map(const struct ingest_view *v, const struct lens *lens, double x_px, double y_px,
                     double *u_px, double *v_px);
/* Convert one photograph. Its bytes are copied when nothing changes and the format fits. What is
 * read: ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_DATA (its size is not the camera's); ERR_IO,
 * ERR_MEM. */
enum err_code ingest_photo_convert(const struct ingest_view *v, const char *from, const char *to,
                                   const struct codec_limits *lim, struct err *e) ERR_USE;

#endif
