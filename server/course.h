/* Where a camera goes: the positions of a prefetch list's query as cameras, each with the time at
 * which it is there.
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
    size_t n;   /* positions; one may still move: straight ahead */
    struct view_pose pose[COURSE_POSES_MAX];
    uint32_t width_px, height_px;
    double error_px;            /* of a tile that is fine enough, as 3D Tiles clients measure it */
    double speed_m_s;           /* 0: it stands */
    double horizon_s;           /* 0: to the end of the path */
    char path[COURSE_TEXT_MAX]; /* as it was asked for, percent-decoded */
};
/* What a target says, with what it leaves unsaid. No course (n = 0) without a path. ERR_FORMAT: the
 * path cannot be read. ERR_DATA: impossible numbers. */
enum err_code course_read(const struct target_course *t, struct course *out, struct err *e) ERR_USE;
/* The camera along its way, in the frame of the origin: cam[*n] and at_s[*n], with room for
 * COURSE_CAMERAS_MAX, the first at 0 s. ERR_ARG. */
enum err_code course_cameras(const struct course *c, const struct geo_origin *origin,
                             struct camera *cam, double *at_s, size_t *n, struct err *e) ERR_USE;

#endif
