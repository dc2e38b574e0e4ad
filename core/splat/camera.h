/* Cameras: pinhole views for rendering, and COLMAP's lens models for photographs.
 *
 * Camera frame: x right, y down, z forward. Pixel centres lie at (column + 0.5, row + 0.5), so the
 * centre of the top-left pixel is (0.5, 0.5). cx and cy use the same origin. World frame: ENU
 * metres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_CAMERA_H
#define CORE_CAMERA_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct json_t;

struct camera {
    uint32_t width_px, height_px;
    double fx_px, fy_px, cx_px, cy_px;
    double rot[9];   /* world -> camera, row-major */
    double trans[3]; /* x_cam = rot * x_world + trans, metres */
};

struct camera_window { /* a part of a picture, in shares of its width and height, 0..1 */
    double x0, y0, x1, y1;
};

/* Centre of projection in the world frame: -rot^T trans. */
void camera_center(const struct camera *c, double out_enu_m[3]);
/* The ray through a place of the picture, world frame; its part along the forward axis is 1. */
void camera_ray(const struct camera *c, double x_px, double y_px, double out_enu[3]);
/* Projects a point of the world frame. px is the pixel, which may lie outside the picture. depth_m
 * (may be NULL) is the distance along the forward axis in metres. If the point is not farther than
 * near_m, it returns false and writes nothing. */
bool camera_project(const struct camera *c, const double enu_m[3], double near_m, double px[2],
                    double *depth_m);
/* As camera_project, but also false if the pixel is outside [0, width) x [0, height). */
bool camera_frames(const struct camera *c, const double enu_m[3], double near_m, double *depth_m);
/* How far pixels move from one view to another, px: the most of the corners and the middle of a's
 * picture, of points that are near_m or infinitely far away along a's axis. INFINITY: sizes differ,
 * or such a point is not in front of b. */
double camera_moved_px(const struct camera *a, const struct camera *b, double near_m);
/* The same view in a picture of another size. Focal lengths and principal point are scaled. */
struct camera camera_resize(const struct camera *c, uint32_t width_px, uint32_t height_px);
/* The whole pixels that a part of the picture touches: left, top, width, height; at least one pixel
 * each. */
void camera_window_px(const struct camera *c, const struct camera_window *w, uint32_t out[4]);
/* The camera that shows only this part of the picture. */
struct camera camera_crop(const struct camera *c, const struct camera_window *w);
/* A camera at `eye` that looks at `target` (ENU metres), with z up. In a vertical view north is up.
 */
struct camera camera_look_at(const double eye[3], const double target[3], double fov_y_rad,
                             uint32_t width_px, uint32_t height_px);
/* A camera with a heading (degrees clockwise from north) and a pitch (degrees above the horizon,
 * -90 looks straight down). Roll is 0. */
struct camera camera_heading(const double eye[3], double heading_deg, double pitch_deg,
                             double fov_y_rad, uint32_t width_px, uint32_t height_px);
/* Reads {"width","height","fx","fy","cx","cy","world_to_camera":[16, row-major]}. The rotation must
 * be orthonormal within 1e-3, and is then made exactly orthonormal. Sizes are 1..16384, focal
 * lengths finite and > 0. ERR_FORMAT names the key. */
enum err_code camera_from_json(const struct json_t *o, struct camera *out, struct err *e) ERR_USE;
void camera_quat_to_rot(const double quat_wxyz[4], double rot[9]); /* normalises */
void camera_rot_to_quat(const double rot[9], double quat_wxyz[4]); /* w >= 0 */

/* COLMAP's camera models. The values are COLMAP's ids. */
enum lens_model {
    LENS_SIMPLE_PINHOLE,
    LENS_PINHOLE,
    LENS_SIMPLE_RADIAL,
    LENS_RADIAL,
    LENS_OPENCV,
    LENS_OPENCV_FISHEYE,
    LENS_FULL_OPENCV,
    LENS_FOV,
    LENS_SIMPLE_RADIAL_FISHEYE,
    LENS_RADIAL_FISHEYE,
    LENS_THIN_PRISM_FISHEYE,
    LENS_COUNT
};
struct lens {
    enum lens_model model;
    uint32_t width_px, height_px;
    double params[12];
};
/* COLMAP's name of the model, such as "OPENCV". */
const char *lens_name(enum lens_model model);
size_t lens_param_count(enum lens_model model);
void lens_focal(const struct lens *l, double *fx, double *fy, double *cx, double *cy);
/* Returns whether the lens has no distortion, so that straight lines stay straight. A model whose
 * distortion coefficients are all 0 counts as such. */
bool lens_is_pinhole(const struct lens *l);
/* The same lens for a picture of another size. A model with one focal length becomes the equal
 * model with two, because a rounded size may change the aspect ratio. */
struct lens lens_resize(const struct lens *l, uint32_t width_px, uint32_t height_px);
/* Maps a direction in the camera frame, (x/z, y/z), to the distorted pixel. */
void lens_distort(const struct lens *l, double x, double y, double *u_px, double *v_px);
/* The inverse of lens_distort, by Newton's method. Returns false where the model has no inverse. */
bool lens_undistort(const struct lens *l, double u_px, double v_px, double *x, double *y);

#endif
