/* The path of a camera: positions from the query of a prefetch list, as cameras with a time each.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COURSE_H
#define SERVER_COURSE_H

#include "core/camera.h"
#include "core/geo.h"
#include "lod/view.h"
#include "server/target.h"

enum { COURSE_POSES_MAX = 64, COURSE_CAMERAS_MAX = 64, COURSE_TEXT_MAX = 2048 };
struct course { /* {0}: none */
    /* number of positions; with one position and a speed the camera flies straight ahead */
    size_t n;
    struct view_pose pose[COURSE_POSES_MAX];
    uint32_t width_px, height_px;
    double error_px;  /* largest acceptable error of a tile, as 3D Tiles clients measure it */
    double speed_m_s; /* 0: the camera does not move */
    double horizon_s; /* 0: to the end of the path */
    char path[COURSE_TEXT_MAX]; /* as in the request, percent-decoded */
};
/* Reads the path of a target and fills in defaults. Without a path n is 0. ERR_FORMAT: the path is
 * malformed. ERR_DATA: impossible numbers. */
enum err_code course_read(const struct target_course *t, struct course *out, struct err *e) ERR_USE;
/* Computes cameras along the path in the frame of the origin: cam [*n] and at_s [*n], with room for
 * COURSE_CAMERAS_MAX. The first is at 0 s. ERR_ARG. */
enum err_code course_cameras(const struct course *c, const struct geo_origin *origin,
                             struct camera *cam, double *at_s, size_t *n, struct err *e) ERR_USE;

#endif
