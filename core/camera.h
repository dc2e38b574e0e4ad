/* Cameras: pinhole views for rendering, and COLMAP's lens models for photographs.
 *
 * Camera frame: x right, y down, z forward. Pixel centres at (column + 0.5, row + 0.5), the centre
 * of the top-left pixel is (0.5, 0.5); cx, cy use the same origin. World frame: ENU metres.
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

/* Centre of projection in the world frame: -rot^T trans. */
void camera_center(const struct camera *c, double out_enu_m[3]);
/* Where a point of the world frame is drawn: a pixel, in the picture or not, and its distance along
 * the forward axis in metres (depth_m may be NULL). False, and nothing written, when it is not
 * farther than near_m. */
bool camera_project(const struct camera *c, const double enu_m[3], double near_m, double px[2],
                    double *depth_m);
/* Is it drawn in the picture, [0, width) x [0, height)? */
bool camera_frames(const struct camera *c, const double enu_m[3], double near_m, double *depth_m);
/* Same view, other picture size: pixel centres are at +0.5, so focal lengths and principal point
 * scale. */
struct camera camera_resize(const struct camera *c, uint32_t width_px, uint32_t height_px);
/* A camera at eye looking at target (ENU metres), z up; a vertical view takes north as its up. */
struct camera camera_look_at(const double eye[3], const double target[3], double fov_y_rad,
                             uint32_t width_px, uint32_t height_px);
/* heading: degrees clockwise from north; pitch: degrees above the horizon (-90 = straight down);
 * roll 0. */
struct camera camera_heading(const double eye[3], double heading_deg, double pitch_deg,
                             double fov_y_rad, uint32_t width_px, uint32_t height_px);
/* {"width","height","fx","fy","cx","cy","world_to_camera":[16, row-major]}; ERR_FORMAT names the
 * key. The rotation must be orthonormal within 1e-3 (it is re-orthonormalised), sizes 1..16384,
 * focals finite > 0. */
enum err_code camera_from_json(const struct json_t *o, struct camera *out, struct err *e) ERR_USE;
void camera_quat_to_rot(const double quat_wxyz[4], double rot[9]); /* normalises */
void camera_rot_to_quat(const double rot[9], double quat_wxyz[4]); /* w >= 0 */

/* COLMAP camera models, by their COLMAP ids. */
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
/* COLMAP's names, "OPENCV". ERR_FORMAT: no such model. */
const char *lens_name(enum lens_model model);
enum err_code lens_from_name(const char *name, enum lens_model *out, struct err *e) ERR_USE;
size_t lens_param_count(enum lens_model model);
void lens_focal(const struct lens *l, double *fx, double *fy, double *cx, double *cy);
/* Does it map straight lines to straight lines (no distortion, or one whose coefficients are all
 * 0)? */
bool lens_is_pinhole(const struct lens *l);
/* The same lens for a picture of another size. Models with one focal length come back as their
 * equal with two, since a rounded size need not keep the aspect ratio. */
struct lens lens_resize(const struct lens *l, uint32_t width_px, uint32_t height_px);
/* Normalised camera-plane direction (x/z, y/z) -> distorted pixel. */
void lens_distort(const struct lens *l, double x, double y, double *u_px, double *v_px);
/* Its inverse by Newton iteration; false where the model cannot be inverted there. */
bool lens_undistort(const struct lens *l, double u_px, double v_px, double *x, double *y);

#endif
