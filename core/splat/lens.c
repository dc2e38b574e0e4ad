/* COLMAP's eleven lens models: distortion in closed form, its inverse by Newton's method.
 *
 * Every model warps a plane and then applies focal length and principal point. For fisheye models
 * it is the equidistant plane (direction times angle), for the others the perspective one (x/z,
 * y/z). Each warp is smooth in its plane, so one Newton iteration with a numeric Jacobian serves
 * all models. It goes out from the principal point in a few steps, and the Jacobian must stay
 * positive. A pixel beyond the radius where a distortion polynomial folds back has no unique
 * inverse and is refused. Source: COLMAP, src/colmap/sensor/models.h (formulas and order of
 * parameters).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/splat/camera.h"

struct model_info {
    const char *name;
    unsigned n_params;
    bool one_focal; /* f, cx, cy, ... instead of fx, fy, cx, cy, ... */
    bool fisheye;
};

static const struct model_info infos[LENS_COUNT] = {
    [LENS_SIMPLE_PINHOLE] = {"SIMPLE_PINHOLE", 3, true, false},
    [LENS_PINHOLE] = {"PINHOLE", 4, false, false},
    [LENS_SIMPLE_RADIAL] = {"SIMPLE_RADIAL", 4, true, false},
    [LENS_RADIAL] = {"RADIAL", 5, true, false},
    [LENS_OPENCV] = {"OPENCV", 8, false, false},
    [LENS_OPENCV_FISHEYE] = {"OPENCV_FISHEYE", 8, false, true},
    [LENS_FULL_OPENCV] = {"FULL_OPENCV", 12, false, false},
    [LENS_FOV] = {"FOV", 5, false, false},
    [LENS_SIMPLE_RADIAL_FISHEYE] = {"SIMPLE_RADIAL_FISHEYE", 4, true, true},
    [LENS_RADIAL_FISHEYE] = {"RADIAL_FISHEYE", 5, true, true},
    [LENS_THIN_PRISM_FISHEYE] = {"THIN_PRISM_FISHEYE", 12, false, true},
};

enum { NEWTON_STEPS = 6, NEWTON_MAX = 30, NEWTON_HALVINGS = 12 };
static const double newton_tol_px = 1e-9;

const char *lens_name(enum lens_model model)
{
    return (unsigned)model < LENS_COUNT ? infos[model].name : "unknown";
}

size_t lens_param_count(enum lens_model model)
{
    return (unsigned)model < LENS_COUNT ? infos[model].n_params : 0;
}

void lens_focal(const struct lens *l, double *fx, double *fy, double *cx, double *cy)
{
    const double *p = l->params;
    bool one = infos[l->model].one_focal;
    *fx = p[0];
    *fy = one ? p[0] : p[1];
    *cx = one ? p[1] : p[2];
    *cy = one ? p[2] : p[3];
}

bool lens_is_pinhole(const struct lens *l)
{
    if (infos[l->model].fisheye || l->model == LENS_FOV)
        return false;
    for (size_t i = infos[l->model].one_focal ? 3 : 4; i < infos[l->model].n_params; i++)
        if (l->params[i] != 0)
            return false;
    return true;
}

struct lens lens_resize(const struct lens *l, uint32_t width_px, uint32_t height_px)
{
    static const enum lens_model with_two[LENS_COUNT] = {
        [LENS_SIMPLE_PINHOLE] = LENS_PINHOLE,
        [LENS_SIMPLE_RADIAL] = LENS_OPENCV,
        [LENS_RADIAL] = LENS_OPENCV,
        [LENS_SIMPLE_RADIAL_FISHEYE] = LENS_OPENCV_FISHEYE,
        [LENS_RADIAL_FISHEYE] = LENS_OPENCV_FISHEYE,
    };
    struct lens out = *l;
    double sx = (double)width_px / l->width_px, sy = (double)height_px / l->height_px, fx, fy, cx,
           cy;
    lens_focal(l, &fx, &fy, &cx, &cy);
    if (infos[l->model].one_focal) {
        memset(out.params, 0, sizeof out.params);
        out.model = with_two[l->model];
        for (size_t i = 3; i < infos[l->model].n_params;
             i++) /* k1, k2 stay the first two coefficients */
            out.params[i + 1] = l->params[i];
    }
    out.width_px = width_px;
    out.height_px = height_px;
    out.params[0] = fx * sx;
    out.params[1] = fy * sy;
    out.params[2] = cx * sx;
    out.params[3] = cy * sy;
    return out;
}

/* Brown's model with up to four radial terms over three, two tangential ones. */
static void lens_warp_brown(const double *k, const double *k_den, double p1, double p2, double a,
                            double b, double *u, double *v)
{
    double r2 = a * a + b * b;
    double num = 1 + r2 * (k[0] + r2 * (k[1] + r2 * (k[2] + r2 * k[3])));
    double den = 1 + r2 * (k_den[0] + r2 * (k_den[1] + r2 * k_den[2]));
    double radial = num / den;
    *u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a);
    *v = b * radial + 2 * p2 * a * b + p1 * (r2 + 2 * b * b);
}

/* Devernay and Faugeras' field-of-view model. */
static double lens_fov_factor(double omega, double r2)
{
    if (omega * omega < 1e-4)
        return omega * omega * r2 / 3 - omega * omega / 12 + 1;
    double t = tan(omega / 2);
    if (r2 < 1e-8)
        return -2 * t * (4 * r2 * t * t - 3) / (3 * omega);
    double r = sqrt(r2);
    return atan(r * 2 * t) / (r * omega);
}

/* Warp of the model's own plane: (a, b) -> pixels over focal length. */
static void lens_warp(const struct lens *l, double a, double b, double *u, double *v)
{
    static const double none[4] = {0};
    const double *p = l->params;
    *u = a;
    *v = b;
    switch (l->model) {
    case LENS_SIMPLE_RADIAL:
    case LENS_SIMPLE_RADIAL_FISHEYE:
        lens_warp_brown((double[4]){p[3]}, none, 0, 0, a, b, u, v);
        break;
    case LENS_RADIAL:
    case LENS_RADIAL_FISHEYE:
        lens_warp_brown((double[4]){p[3], p[4]}, none, 0, 0, a, b, u, v);
        break;
    case LENS_OPENCV:
        lens_warp_brown((double[4]){p[4], p[5]}, none, p[6], p[7], a, b, u, v);
        break;
    case LENS_OPENCV_FISHEYE:
        lens_warp_brown((double[4]){p[4], p[5], p[6], p[7]}, none, 0, 0, a, b, u, v);
        break;
    case LENS_FULL_OPENCV:
        lens_warp_brown((double[4]){p[4], p[5], p[8]}, p + 9, p[6], p[7], a, b, u, v);
        break;
    case LENS_FOV: {
        double f = lens_fov_factor(p[4], a * a + b * b);
        *u = a * f;
        *v = b * f;
        break;
    }
    case LENS_THIN_PRISM_FISHEYE: {
        double r2 = a * a + b * b;
        lens_warp_brown((double[4]){p[4], p[5], p[8], p[9]}, none, p[6], p[7], a, b, u, v);
        *u += p[10] * r2;
        *v += p[11] * r2;
        break;
    }
    default:
        break;
    }
}

void lens_distort(const struct lens *l, double x, double y, double *u_px, double *v_px)
{
    double fx, fy, cx, cy, u, v;
    lens_focal(l, &fx, &fy, &cx, &cy);
    if (infos[l->model].fisheye) {
        double r = sqrt(x * x + y * y);
        double s = r > 1e-12 ? atan(r) / r : 1;
        x *= s;
        y *= s;
    }
    lens_warp(l, x, y, &u, &v);
    *u_px = fx * u + cx;
    *v_px = fy * v + cy;
}

/* Central differences; false where the warp is not locally one-to-one and orientation-preserving.
 */
static bool lens_warp_jacobian(const struct lens *l, double a, double b, double j[4])
{
    double h = 1e-6, up, vp, un, vn;
    lens_warp(l, a + h, b, &up, &vp);
    lens_warp(l, a - h, b, &un, &vn);
    j[0] = (up - un) / (2 * h);
    j[2] = (vp - vn) / (2 * h);
    lens_warp(l, a, b + h, &up, &vp);
    lens_warp(l, a, b - h, &un, &vn);
    j[1] = (up - un) / (2 * h);
    j[3] = (vp - vn) / (2 * h);
    return j[0] * j[3] - j[1] * j[2] > 1e-6;
}

/* Newton with step halving from (a, b) towards the warp value (u, v). */
static bool lens_warp_solve(const struct lens *l, double u, double v, double tol, double *a,
                            double *b)
{
    double un, vn;
    lens_warp(l, *a, *b, &un, &vn);
    double err2 = (un - u) * (un - u) + (vn - v) * (vn - v);
    for (int i = 0; i < NEWTON_MAX && err2 > tol * tol; i++) {
        double j[4];
        if (!lens_warp_jacobian(l, *a, *b, j))
            return false;
        double det = j[0] * j[3] - j[1] * j[2];
        double da = (j[3] * (u - un) - j[1] * (v - vn)) / det;
        double db = (j[0] * (v - vn) - j[2] * (u - un)) / det;
        int half = 0;
        for (; half < NEWTON_HALVINGS; half++, da *= 0.5, db *= 0.5) {
            double ut, vt;
            lens_warp(l, *a + da, *b + db, &ut, &vt);
            double trial = (ut - u) * (ut - u) + (vt - v) * (vt - v);
            if (trial < err2) {
                *a += da;
                *b += db;
                un = ut;
                vn = vt;
                err2 = trial;
                break;
            }
        }
        if (half == NEWTON_HALVINGS)
            break; /* at rounding level, or stuck: the test below tells */
    }
    double j[4];
    return err2 <= 1e4 * tol * tol && lens_warp_jacobian(l, *a, *b, j);
}

bool lens_undistort(const struct lens *l, double u_px, double v_px, double *x, double *y)
{
    double fx, fy, cx, cy;
    lens_focal(l, &fx, &fy, &cx, &cy);
    double u = (u_px - cx) / fx, v = (v_px - cy) / fy, a = 0, b = 0;
    if (!isfinite(u) || !isfinite(v))
        return false;
    for (int i = 1; i <= NEWTON_STEPS; i++) {
        double t = (double)i / NEWTON_STEPS;
        /* Earlier steps only have to stay on the right branch. */
        double tol = (i < NEWTON_STEPS ? 1e-3 : newton_tol_px) / fmax(fabs(fx), fabs(fy));
        if (!lens_warp_solve(l, t * u, t * v, tol, &a, &b))
            return false;
    }
    if (infos[l->model].fisheye) {
        double theta = sqrt(a * a + b * b);
        if (theta >= 0.5 * M_PI - 1e-6)
            return false;
        double s = theta > 1e-12 ? tan(theta) / theta : 1;
        a *= s;
        b *= s;
    }
    *x = a;
    *y = b;
    return true;
}
