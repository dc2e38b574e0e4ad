/* Covariance of poses: see pose_error.h.
 *
 * A photograph's pose is a rotation and a place. Its observations tell of it, and of the points
 * that they show, which its other photographs tell of as well. With the poses of the others held,
 * the information about one pose is the Schur complement of its points,
 *
 *   A = sum over its points of  C'C - C'X (sum over all observations of the point of X'X)^-1 X'C
 *
 * where C and X are the derivatives of an observation by the pose and by the point (Triggs et al.,
 * Bundle Adjustment - A Modern Synthesis, 2000, section 6). So a point that a second photograph
 * alone sees counts once, one at a small angle little, and one that nobody else sees not at all.
 * The standard deviation of an observation is that of the photograph's own residuals, and at least
 * half a pixel. What the covariance means is told in the picture: how far its points, and its
 * corners at their depth, may move.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/pose_error.h"

#include <math.h>
#include <string.h>

#include "core/math/cholesky.h"
#include "core/math/sort.h"

enum { POSE = 6, GRID = 3, PICTURE_EDGE_PX = 1600 };
static const double picture_px = 2, detector_px = 0.5;
static const double rayleigh_median = 1.1774;          /* of standard deviations on an axis */
static const double point_hold = 1e-9;                 /* of a point that no other one fixes */
static const double step_rel = 1e-5, far_px = 1e9;     /* of depth; behind the camera */
static const double grid_at[GRID] = {0.02, 0.5, 0.98}; /* of width and height */

struct pose_view {
    const struct colmap_image *image;
    const struct lens *lens;
    double rot[9];
};

static struct pose_view pose_view_of(const struct colmap_model *m, size_t i)
{
    const struct colmap_image *im = &m->images[i];
    struct pose_view v = {.image = im, .lens = &m->cameras[im->camera].lens};
    camera_quat_to_rot(im->quat_wxyz, v.rot);
    return v;
}

static void pose_to_camera(const struct pose_view *v, const double x[3], double out[3])
{
    for (size_t a = 0; a < 3; a++)
        out[a] = v->rot[3 * a] * x[0] + v->rot[3 * a + 1] * x[1] + v->rot[3 * a + 2] * x[2] +
                 v->image->trans[a];
}

/* Derivatives of the pixel by a point of the camera's frame. */
static void pose_pixel_by_camera(const struct lens *l, const double at[3], double out[2][3])
{
    const double h = step_rel * at[2];
    for (size_t k = 0; k < 3; k++) {
        double p[3] = {at[0], at[1], at[2]}, q[3] = {at[0], at[1], at[2]}, u[2], w[2];
        p[k] += h;
        q[k] -= h;
        lens_distort(l, p[0] / p[2], p[1] / p[2], &u[0], &u[1]);
        lens_distort(l, q[0] / q[2], q[1] / q[2], &w[0], &w[1]);
        out[0][k] = (u[0] - w[0]) / (2 * h);
        out[1][k] = (u[1] - w[1]) / (2 * h);
    }
}

/* By the point of the world. */
static void pose_pixel_by_point(const struct pose_view *v, double by_camera[2][3], double out[2][3])
{
    for (size_t r = 0; r < 2; r++)
        for (size_t k = 0; k < 3; k++)
            out[r][k] = by_camera[r][0] * v->rot[k] + by_camera[r][1] * v->rot[3 + k] +
                        by_camera[r][2] * v->rot[6 + k];
}

/* By the pose: a small rotation of the camera's frame, and a shift in units of `depth`, so that all
 * six are of one size. */
static void pose_pixel_by_pose(double by_camera[2][3], const double at[3], double depth,
                               double out[2][POSE])
{
    for (size_t r = 0; r < 2; r++) {
        const double *g = by_camera[r];
        out[r][0] = g[2] * at[1] - g[1] * at[2];
        out[r][1] = g[0] * at[2] - g[2] * at[0];
        out[r][2] = g[1] * at[0] - g[0] * at[1];
        for (size_t k = 0; k < 3; k++)
            out[r][3 + k] = g[k] * depth;
    }
}

/* Observation k, if its point lies before the camera: the point there, and the derivatives of its
 * pixel by the point in the camera's frame and in the world's. */
static bool pose_look(const struct colmap_model *m, const struct pose_view *v, size_t k,
                      double at[3], double by_camera[2][3], double by_point[2][3])
{
    const int64_t p = v->image->obs[k].point;
    if (p < 0)
        return false;
    pose_to_camera(v, m->points[p].xyz, at);
    if (!(at[2] > 0))
        return false;
    pose_pixel_by_camera(v->lens, at, by_camera);
    pose_pixel_by_point(v, by_camera, by_point);
    return true;
}

/* The information about every point, of all photographs that see it: [n_points][9]. */
static void pose_point_information(const struct colmap_model *m, double (*info)[9])
{
    memset(info, 0, m->n_points * sizeof *info);
    for (size_t i = 0; i < m->n_images; i++) {
        const struct pose_view v = pose_view_of(m, i);
        for (size_t k = 0; k < v.image->n_obs; k++) {
            double at[3], by_camera[2][3], x[2][3];
            if (!pose_look(m, &v, k, at, by_camera, x))
                continue;
            double *of = info[v.image->obs[k].point];
            for (size_t a = 0; a < 3; a++)
                for (size_t b = 0; b < 3; b++)
                    of[3 * a + b] += x[0][a] * x[0][b] + x[1][a] * x[1][b];
        }
    }
}

/* Residuals and depths of a photograph's observations; the number of points. */
static size_t pose_residuals(const struct colmap_model *m, const struct pose_view *v, double *px,
                             double *depth, size_t *n_depths)
{
    size_t n = 0;
    *n_depths = 0;
    for (size_t k = 0; k < v->image->n_obs; k++) {
        const struct colmap_observation *o = &v->image->obs[k];
        double at[3], u, w;
        if (o->point < 0)
            continue;
        pose_to_camera(v, m->points[o->point].xyz, at);
        px[n] = far_px;
        if (at[2] > 0) {
            lens_distort(v->lens, at[0] / at[2], at[1] / at[2], &u, &w);
            px[n] = fmin(hypot(u - o->x_px, w - o->y_px), far_px);
            depth[(*n_depths)++] = at[2];
        }
        n++;
    }
    return n;
}

/* Adds what an observation tells of the pose when its point is unknown but for all that see it. */
static void pose_add(double by_pose[2][POSE], double x[2][3], const double info[9],
                     double a[POSE][POSE])
{
    double l[9], y[2][3], weight[2][2];
    memcpy(l, info, sizeof l);
    for (size_t k = 0; k < 3; k++) /* along a ray that no other one crosses it may be anywhere */
        l[4 * k] += point_hold * (info[0] + info[4] + info[8]);
    if (!cholesky_factor(l, 3, 3))
        return;
    for (size_t r = 0; r < 2; r++)
        cholesky_solve(l, 3, 3, x[r], y[r]);
    for (size_t r = 0; r < 2; r++)
        for (size_t q = 0; q < 2; q++)
            weight[r][q] = (r == q) - x[r][0] * y[q][0] - x[r][1] * y[q][1] - x[r][2] * y[q][2];
    for (size_t i = 0; i < POSE; i++)
        for (size_t j = 0; j < POSE; j++)
            for (size_t r = 0; r < 2; r++)
                for (size_t q = 0; q < 2; q++)
                    a[i][j] += by_pose[r][i] * weight[r][q] * by_pose[q][j];
}

/* Root mean square over the picture of the standard deviation of a pixel, by the factor of A. */
static double pose_spread_px(const struct lens *l, double depth, double a[POSE][POSE])
{
    double sum = 0, n = 0;
    for (size_t y = 0; y < GRID; y++)
        for (size_t x = 0; x < GRID; x++) {
            double at[3] = {0, 0, depth}, by_camera[2][3], by_pose[2][POSE], move[POSE];
            if (!lens_undistort(l, grid_at[x] * l->width_px, grid_at[y] * l->height_px, &at[0],
                                &at[1]))
                continue; /* beyond what the lens shows */
            at[0] *= depth;
            at[1] *= depth;
            pose_pixel_by_camera(l, at, by_camera);
            pose_pixel_by_pose(by_camera, at, depth, by_pose);
            for (size_t r = 0; r < 2; r++) {
                cholesky_solve(&a[0][0], POSE, POSE, by_pose[r], move);
                for (size_t k = 0; k < POSE; k++)
                    sum += by_pose[r][k] * move[k];
            }
            n++;
        }
    return n > 0 ? sqrt(sum / n) : (double)INFINITY;
}

/* px, depth [n_obs] are scratch. */
static struct pose_error pose_error_of(const struct colmap_model *m, size_t i, double (*info)[9],
                                       double *px, double *depth)
{
    const struct pose_view v = pose_view_of(m, i);
    double a[POSE][POSE] = {{0}};
    size_t n_depths;
    struct pose_error out = {.picture_px = (double)INFINITY};
    out.n_points = pose_residuals(m, &v, px, depth, &n_depths);
    out.reprojection_px = sort_median(px, out.n_points);
    if (2 * out.n_points <= POSE || !n_depths)
        return out;
    double middle = sort_median(depth, n_depths), n = (double)out.n_points,
           /* the pose was fitted to these points: what they miss is told by fewer of them */
        sigma = fmax(detector_px, out.reprojection_px / rayleigh_median * sqrt(n / (n - POSE / 2)));
    for (size_t k = 0; k < v.image->n_obs; k++) {
        double at[3], by_camera[2][3], by_pose[2][POSE], x[2][3];
        if (!pose_look(m, &v, k, at, by_camera, x))
            continue;
        pose_pixel_by_pose(by_camera, at, middle, by_pose);
        pose_add(by_pose, x, info[v.image->obs[k].point], a);
    }
    if (cholesky_factor(&a[0][0], POSE, POSE))
        out.picture_px = sigma * pose_spread_px(v.lens, middle, a);
    return out;
}

enum err_code pose_error_find(const struct colmap_model *m, struct pose_error *out, struct err *e)
{
    size_t most = 1;
    for (size_t i = 0; i < m->n_images; i++)
        most = m->images[i].n_obs > most ? m->images[i].n_obs : most;
    double(*info)[9] = mem_array(m->n_points, sizeof *info), *px = mem_array(most, sizeof *px),
    *depth = mem_array(most, sizeof *depth);
    enum err_code rc = info && px && depth ? ERR_OK : err_set(e, ERR_MEM, "ingest: out of memory");
    if (!rc)
        pose_point_information(m, info);
    for (size_t i = 0; !rc && i < m->n_images; i++)
        out[i] = pose_error_of(m, i, info, px, depth);
    mem_free(info);
    mem_free(px);
    mem_free(depth);
    return rc;
}

double pose_error_most_px(const struct lens *l)
{
    double edge = fmax(l->width_px, l->height_px);
    return picture_px * fmax(1, edge / PICTURE_EDGE_PX);
}
