/* Pinhole cameras: poses from look-at, heading and JSON, projection, quaternions, resizing.
 *
 * Rotations are world -> camera with rows right, down, forward. The renderer inverts a rotation by
 * transposing it. A pose from outside is therefore made exactly orthonormal, by way of its
 * quaternion. Shepperd's method picks the largest component, so there is no cancellation.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/camera.h"

#include <jansson.h>
#include <math.h>

#include "core/base.h"

static const double ortho_tol = 1e-3; /* promised in the header */
enum { CAMERA_EDGE_MAX = 16384 };

static double camera_vec_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void camera_vec_cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* False (v untouched) when v has no direction. */
static bool camera_vec_normalize(double v[3])
{
    double len = sqrt(camera_vec_dot(v, v));
    if (!(len > 1e-12))
        return false;
    for (int i = 0; i < 3; i++)
        v[i] /= len;
    return true;
}

void camera_center(const struct camera *c, double out_enu_m[3])
{
    for (int i = 0; i < 3; i++)
        out_enu_m[i] =
            -(c->rot[i] * c->trans[0] + c->rot[3 + i] * c->trans[1] + c->rot[6 + i] * c->trans[2]);
}

/* What is shown, kept and seeded hangs on the last bits: the order of operations stays. */
void camera_ray(const struct camera *c, double x_px, double y_px, double out_enu[3])
{
    const double a = (x_px - c->cx_px) / c->fx_px, b = (y_px - c->cy_px) / c->fy_px;
    for (int k = 0; k < 3; k++)
        out_enu[k] = c->rot[k] * a + c->rot[3 + k] * b + c->rot[6 + k];
}

bool camera_project(const struct camera *c, const double enu_m[3], double near_m, double px[2],
                    double *depth_m)
{
    double t[3];
    for (int i = 0; i < 3; i++)
        t[i] = c->rot[3 * i] * enu_m[0] + c->rot[3 * i + 1] * enu_m[1] +
               c->rot[3 * i + 2] * enu_m[2] + c->trans[i];
    if (!(t[2] > near_m))
        return false;
    px[0] = c->fx_px * t[0] / t[2] + c->cx_px;
    px[1] = c->fy_px * t[1] / t[2] + c->cy_px;
    if (depth_m)
        *depth_m = t[2];
    return true;
}

bool camera_frames(const struct camera *c, const double enu_m[3], double near_m, double *depth_m)
{
    double px[2];
    return camera_project(c, enu_m, near_m, px, depth_m) && px[0] >= 0.0 && px[1] >= 0.0 &&
           px[0] < c->width_px && px[1] < c->height_px;
}

double camera_moved_px(const struct camera *a, const struct camera *b, double near_m)
{
    static const double at[5][2] = {{0.5, 0.5}, {0, 0}, {1, 0}, {0, 1}, {1, 1}};
    double most = 0.0;
    if (a->width_px != b->width_px || a->height_px != b->height_px)
        return HUGE_VAL;
    for (size_t i = 0; i < 2 * sizeof at / sizeof *at; i++) {
        const double u = at[i / 2][0] * a->width_px, v = at[i / 2][1] * a->height_px;
        const double ray[3] = {(u - a->cx_px) / a->fx_px, (v - a->cy_px) / a->fy_px, 1.0};
        const double here = i % 2 ? 0.0 : 1.0 / near_m; /* infinitely far: only turned */
        double enu[3], seen[3];
        for (size_t k = 0; k < 3; k++) {
            enu[k] = 0.0;
            for (size_t j = 0; j < 3; j++)
                enu[k] += a->rot[3 * j + k] * (ray[j] - here * a->trans[j]);
        }
        for (size_t k = 0; k < 3; k++)
            seen[k] = b->rot[3 * k] * enu[0] + b->rot[3 * k + 1] * enu[1] +
                      b->rot[3 * k + 2] * enu[2] + here * b->trans[k];
        if (!(seen[2] > 1e-3))
            return HUGE_VAL;
        most = fmax(most, hypot(b->fx_px * seen[0] / seen[2] + b->cx_px - u,
                                b->fy_px * seen[1] / seen[2] + b->cy_px - v));
    }
    return most;
}

struct camera camera_resize(const struct camera *c, uint32_t width_px, uint32_t height_px)
{
    struct camera out = *c;
    double sx = (double)width_px / c->width_px, sy = (double)height_px / c->height_px;
    out.width_px = width_px;
    out.height_px = height_px;
    out.fx_px *= sx;
    out.cx_px *= sx;
    out.fy_px *= sy;
    out.cy_px *= sy;
    return out;
}

/* First whole pixel and number of pixels of a share of `n` pixels. */
static void camera_window_axis(double from, double to, uint32_t n, uint32_t *first, uint32_t *count)
{
    double a = fmin(fmax(floor(from * n), 0.0), n - 1.0), b = fmin(fmax(ceil(to * n), a + 1.0), n);
    *first = (uint32_t)a;
    *count = (uint32_t)(b - a);
}

void camera_window_px(const struct camera *c, const struct camera_window *w, uint32_t out[4])
{
    camera_window_axis(w->x0, w->x1, c->width_px, &out[0], &out[2]);
    camera_window_axis(w->y0, w->y1, c->height_px, &out[1], &out[3]);
}

struct camera camera_crop(const struct camera *c, const struct camera_window *w)
{
    struct camera out = *c;
    uint32_t px[4];
    camera_window_px(c, w, px);
    out.width_px = px[2];
    out.height_px = px[3];
    out.cx_px -= px[0];
    out.cy_px -= px[1];
    return out;
}

/* A camera at eye with the given unit right and forward axes. */
static struct camera camera_place(const double eye[3], const double right[3],
                                  const double forward[3], double fov_y_rad, uint32_t width_px,
                                  uint32_t height_px)
{
    struct camera c = {.width_px = width_px, .height_px = height_px};
    double down[3];
    camera_vec_cross(forward, right, down);
    c.fy_px = 0.5 * height_px / tan(0.5 * fov_y_rad);
    c.fx_px = c.fy_px;
    c.cx_px = 0.5 * width_px;
    c.cy_px = 0.5 * height_px;
    for (int i = 0; i < 3; i++) {
        c.rot[i] = right[i];
        c.rot[3 + i] = down[i];
        c.rot[6 + i] = forward[i];
    }
    for (int i = 0; i < 3; i++)
        c.trans[i] = -camera_vec_dot(c.rot + 3 * i, eye);
    return c;
}

struct camera camera_look_at(const double eye[3], const double target[3], double fov_y_rad,
                             uint32_t width_px, uint32_t height_px)
{
    static const double up[3] = {0, 0, 1}, north[3] = {0, 1, 0};
    double forward[3] = {target[0] - eye[0], target[1] - eye[1], target[2] - eye[2]};
    if (!camera_vec_normalize(forward))
        forward[2] = -1; /* eye on target: look down */
    double right[3];
    camera_vec_cross(forward, up, right);
    if (right[0] * right[0] + right[1] * right[1] < 1e-18)
        camera_vec_cross(forward, north, right);
    camera_vec_normalize(right);
    return camera_place(eye, right, forward, fov_y_rad, width_px, height_px);
}

struct camera camera_heading(const double eye[3], double heading_deg, double pitch_deg,
                             double fov_y_rad, uint32_t width_px, uint32_t height_px)
{
    double h = heading_deg * (M_PI / 180), p = pitch_deg * (M_PI / 180);
    double right[3] = {cos(h), -sin(h), 0};
    double forward[3] = {sin(h) * cos(p), cos(h) * cos(p), sin(p)};
    return camera_place(eye, right, forward, fov_y_rad, width_px, height_px);
}

void camera_quat_to_rot(const double quat_wxyz[4], double rot[9])
{
    double n = sqrt(quat_wxyz[0] * quat_wxyz[0] + quat_wxyz[1] * quat_wxyz[1] +
                    quat_wxyz[2] * quat_wxyz[2] + quat_wxyz[3] * quat_wxyz[3]);
    double w = 1, x = 0, y = 0, z = 0;
    if (n > 0) {
        w = quat_wxyz[0] / n;
        x = quat_wxyz[1] / n;
        y = quat_wxyz[2] / n;
        z = quat_wxyz[3] / n;
    }
    rot[0] = 1 - 2 * (y * y + z * z);
    rot[1] = 2 * (x * y - w * z);
    rot[2] = 2 * (x * z + w * y);
    rot[3] = 2 * (x * y + w * z);
    rot[4] = 1 - 2 * (x * x + z * z);
    rot[5] = 2 * (y * z - w * x);
    rot[6] = 2 * (x * z - w * y);
    rot[7] = 2 * (y * z + w * x);
    rot[8] = 1 - 2 * (x * x + y * y);
}

void camera_rot_to_quat(const double rot[9], double quat_wxyz[4])
{
    double q[4];
    double sum[4] = {1 + rot[0] + rot[4] + rot[8], 1 + rot[0] - rot[4] - rot[8],
                     1 - rot[0] + rot[4] - rot[8], 1 - rot[0] - rot[4] + rot[8]};
    int best = 0;
    for (int i = 1; i < 4; i++)
        if (sum[i] > sum[best])
            best = i;
    double s = 0.5 / sqrt(sum[best]); /* sum[best] >= 1 for a rotation */
    q[best] = 0.5 * sqrt(sum[best]);
    if (best == 0) {
        q[1] = (rot[7] - rot[5]) * s;
        q[2] = (rot[2] - rot[6]) * s;
        q[3] = (rot[3] - rot[1]) * s;
    } else if (best == 1) {
        q[0] = (rot[7] - rot[5]) * s;
        q[2] = (rot[1] + rot[3]) * s;
        q[3] = (rot[2] + rot[6]) * s;
    } else if (best == 2) {
        q[0] = (rot[2] - rot[6]) * s;
        q[1] = (rot[1] + rot[3]) * s;
        q[3] = (rot[5] + rot[7]) * s;
    } else {
        q[0] = (rot[3] - rot[1]) * s;
        q[1] = (rot[2] + rot[6]) * s;
        q[2] = (rot[5] + rot[7]) * s;
    }
    double n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double sign = q[0] < 0 ? -1 / n : 1 / n;
    for (int i = 0; i < 4; i++)
        quat_wxyz[i] = q[i] * sign;
}

static enum err_code camera_json_edge(const struct json_t *o, const char *key, uint32_t *out,
                                      struct err *e)
{
    double v;
    enum err_code rc = jsonc_num(o, key, &v, e);
    if (rc)
        return rc;
    if (!(v >= 1 && v <= CAMERA_EDGE_MAX) || v != floor(v))
        return err_set(e, ERR_FORMAT, "camera: %s: expected a whole number of pixels from 1 to %d",
                       key, CAMERA_EDGE_MAX);
    *out = (uint32_t)v;
    return ERR_OK;
}

/* Rotation and translation from a row-major 4x4. */
static enum err_code camera_pose_from_matrix(const double m[16], struct camera *out, struct err *e)
{
    double rot[9];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            rot[3 * i + j] = m[4 * i + j];
        out->trans[i] = m[4 * i + 3];
    }
    bool finite = true;
    for (int i = 0; i < 16; i++)
        finite = finite && isfinite(m[i]);
    if (!finite)
        return err_set(e, ERR_FORMAT, "camera: world_to_camera: a number is not finite");
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            if (!(fabs(camera_vec_dot(rot + 3 * i, rot + 3 * j) - (i == j)) <= ortho_tol))
                return err_set(e, ERR_FORMAT,
                               "camera: world_to_camera: rows %d and %d of the rotation are not "
                               "orthonormal (row-major [R|t; 0 0 0 1], no scale)",
                               i, j);
    double cross[3];
    camera_vec_cross(rot, rot + 3, cross);
    if (!(camera_vec_dot(cross, rot + 6) > 0))
        return err_set(e, ERR_FORMAT,
                       "camera: world_to_camera: the rotation is a mirror image "
                       "(axes are x right, y down, z forward)");
    double row3[4] = {0, 0, 0, 1};
    for (int i = 0; i < 4; i++)
        if (!(fabs(m[12 + i] - row3[i]) <= ortho_tol))
            return err_set(e, ERR_FORMAT,
                           "camera: world_to_camera: last row must be 0 0 0 1 "
                           "(the matrix is row-major)");
    double quat[4];
    camera_rot_to_quat(rot, quat);
    camera_quat_to_rot(quat, out->rot);
    return ERR_OK;
}

enum err_code camera_from_json(const struct json_t *o, struct camera *out, struct err *e)
{
    struct camera c = {0};
    static const char *const keys[4] = {"fx", "fy", "cx", "cy"};
    double *values[4] = {&c.fx_px, &c.fy_px, &c.cx_px, &c.cy_px};
    double m[16];
    enum err_code rc = camera_json_edge(o, "width", &c.width_px, e);
    if (!rc)
        rc = camera_json_edge(o, "height", &c.height_px, e);
    for (int i = 0; i < 4 && !rc; i++) {
        rc = jsonc_num(o, keys[i], values[i], e);
        if (!rc && (!isfinite(*values[i]) || (i < 2 && !(*values[i] > 0))))
            rc = err_set(e, ERR_FORMAT, "camera: %s: expected a finite%s number of pixels", keys[i],
                         i < 2 ? " positive" : "");
    }
    if (!rc)
        rc = jsonc_nums(o, "world_to_camera", 16, m, e);
    if (!rc)
        rc = camera_pose_from_matrix(m, &c, e);
    if (!rc)
        *out = c;
    return rc;
}
