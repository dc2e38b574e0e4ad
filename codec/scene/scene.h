/* Scenes: scene.json and points.bin. Ingest writes them and training reads them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SCENE_H
#define CODEC_SCENE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/scene/scene_image.h"
#include "core/geo/geo.h"
#include "core/geo/heights.h"

struct scene_point {
    double enu_m[3];
    uint8_t rgb[3];
    float error_px;
    uint32_t track_length;
};
struct scene { /* {0} is empty */
    struct geo_origin origin;
    double scale, rot[9], trans[3]; /* COLMAP -> ENU: y = scale * rot * x + trans */
    char heights[HEIGHTS_MAX];      /* reference of heights: core/geo/heights.h */
    /* fitted offset of GPS altitudes, stored separately, see docs/architecture.md */
    double vertical_offset_m;
    struct scene_image *images;
    size_t n_images;
    struct scene_point *points;
    size_t n_points;
    struct scene_track {
        uint32_t point, image;
        float x_px, y_px;
    } * tracks; /* sorted by image; pixels of the undistorted and resized image */
    size_t n_tracks;
    char *attribution; /* may be NULL */
    char dir[FILE_PATH_MAX];
    struct arena arena;
};
/* Read and write scene.json and points.bin of a scene folder. Free the scene with scene_free. Only
 * one thread may use a scene. ERR_NOENT, ERR_FORMAT names file and key, ERR_DATA, ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code scene_read(const char *dir, struct scene *out, struct err *e) ERR_USE;
enum err_code scene_write(const char *dir, const struct scene *s, struct err *e) ERR_USE;
void scene_free(struct scene *s);
/* Index of an image's first track, or of the first of a later image: tracks are sorted by image. */
size_t scene_first_track(const struct scene *s, uint32_t image);
#endif
