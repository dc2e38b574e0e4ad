/* Scenes: what ingest makes and training reads, scene.json and points.bin.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SCENE_H
#define CODEC_SCENE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/camera.h"
#include "core/geo.h"

enum scene_split { SCENE_TRAIN, SCENE_TEST };
struct scene_image {
    char *name;        /* file in images/, borrowed from the scene's arena */
    struct camera cam; /* undistorted pinhole, world = ENU metres */
    enum scene_split split;
    uint32_t group;       /* appearance group; one per photograph by default */
    double gps_enu_m[3];  /* NaN when there is none */
    double residual_m;    /* after registration; NaN when there is no GPS */
    float exposure_ev[3]; /* core/exposure.h: stops against the mean of all; 0: not known */
    char time[20];        /* of the photograph as its camera says it, 2024-06-01T10:00:00, or "" */
};
struct scene_point {
    double enu_m[3];
    uint8_t rgb[3];
    float error_px;
    uint32_t track_length;
};
struct scene { /* {0} is empty */
    struct geo_origin origin;
    double scale, rot[9], trans[3]; /* COLMAP -> ENU: y = scale * rot * x + trans */
    double vertical_offset_m; /* fitted GPS altitude offset kept apart, see docs/conventions.md */
    struct scene_image *images;
    size_t n_images;
    struct scene_point *points;
    size_t n_points;
    struct scene_track {
        uint32_t point, image;
        float x_px, y_px;
    } * tracks; /* sorted by image; image pixels after undistortion and resize */
    size_t n_tracks;
    char *attribution; /* may be NULL */
    char dir[FILE_PATH_MAX];
    struct arena arena;
};
/* scene.json + points.bin of a scene folder. scene_free it. ERR_NOENT, ERR_FORMAT names file and
 * key, ERR_DATA, ERR_IO, ERR_LIMIT, ERR_MEM. One thread a scene. */
enum err_code scene_read(const char *dir, struct scene *out, struct err *e) ERR_USE;
enum err_code scene_write(const char *dir, const struct scene *s, struct err *e) ERR_USE;
void scene_free(struct scene *s);
/* EXIF's "2024:06:01 10:00:00" as a scene keeps it; "" for anything else. */
void scene_time(const char *exif, char out[20]);
#endif
