/* COLMAP models: the files cameras, images and points3D, as .bin or .txt.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_COLMAP_H
#define CODEC_COLMAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/splat/camera.h"

struct colmap_camera {
    uint32_t id;
    struct lens lens;
    const char *foreign; /* name of a model that is not read; NULL: `lens` is valid */
};
struct colmap_observation {
    double x_px, y_px;
    int64_t point; /* index into colmap_model.points, -1 = none */
};
struct colmap_image {
    uint32_t id;
    double quat_wxyz[4], trans[3]; /* world -> camera */
    size_t camera;                 /* index into cameras */
    char *name;
    struct colmap_observation *obs;
    size_t n_obs;
};
struct colmap_track_element {
    uint32_t image; /* index into images */
    uint32_t obs;   /* index into that image's obs */
};
struct colmap_point {
    uint64_t id;
    double xyz[3];
    uint8_t rgb[3];
    double error_px;
    size_t track, n_track; /* slice of colmap_model.tracks */
};
/* {0} is empty. Records are sorted by id. References are checked indices, not ids. */
struct colmap_model {
    struct colmap_camera *cameras;
    size_t n_cameras;
    struct colmap_image *images;
    size_t n_images;
    struct colmap_point *points;
    size_t n_points;
    struct colmap_track_element *tracks;
    size_t n_tracks;
    struct arena arena;      /* owns everything above */
    char dir[FILE_PATH_MAX]; /* set by colmap_read: folder of the files */
    /* number of models found, and of photographs in the second largest */
    size_t n_models, n_second;
};
/* Reads a model from a folder, or from its sparse/ or sparse/0/. Each of the three files may be
 * .bin (preferred) or .txt. Errors of points that are negative or not finite are computed from the
 * observations. If there are none, tracks, poses and lenses give them; tracks or points of
 * observations that are not there are made from each other. Free it with colmap_free.
 * ERR_NOENT names the files that are missing. ERR_FORMAT names file and record ("images.bin: image
 * 17 of 75: truncated"), or a photograph whose camera model is not read. ERR_IO, ERR_LIMIT,
 * ERR_MEM. */
enum err_code colmap_read(const char *dir, struct colmap_model *out, struct err *e) ERR_USE;
/* Writes cameras.bin, images.bin and points3D.bin into a folder that exists. ERR_IO, ERR_LIMIT,
 * ERR_MEM. */
enum err_code colmap_write_bin(const char *dir, const struct colmap_model *m,
                               struct err *e) ERR_USE;
void colmap_free(struct colmap_model *m);
#endif
