/* Depth of a photograph from its neighbours, by sweeps of horizontal and of upright planes.
 *
 * In a city most surfaces are level, or stand on level ground, so the labels are heights:
 * neighbouring pixels share them. For every plane at height z_p = low_m + p step_m the neighbours
 * are drawn as the reference would see them if everything lay in that plane (Collins 1996). The
 * pixel x of the reference, homogeneous, falls on
 *
 *     y ~ (K_k (R_k c + t_k) n^T M + (s - n^T c) K_k R_k M) x,   M = R^T K^-1
 *
 * of neighbour k, for a plane n^T X = s whose normal points away from the eye: n = (0, 0, -1), s =
 * -z_p. c is the reference's centre. Windows are compared by normalised correlation of grey values,
 * which light and exposure do not change; NOISE is added to both variances, so that windows without
 * texture correlate with nothing. A pixel of a window has a larger weight the more it resembles the
 * middle (Yoon and Kweon 2006), because another grey is often another surface:
 *
 *     w = (1 + (a - a_middle)^2 / LIKE^2)^-2
 *
 * The cost of a plane is 1 minus the mean of the best correlations (Kang, Szeliski and Chai 2001),
 * so that a surface may be hidden from some of the neighbours.
 *
 * A window on a wall is not level. So windows are compared in upright planes too (Gallup et al.
 * 2007, sweeps in several directions), which face the reference: in a tile of pixels n is the
 * horizontal part of the ray through its middle, and plane q goes through that ray at height z_p, p
 * = SWEEP_WALL_EVERY q, q from -SWEEP_WALL_MORE on. With d = M x and rho = n^T d / d_z, a pixel at
 * height z lies in plane
 *
 *     q = (c_z - low + (z - c_z) rho / rho_middle) / step / SWEEP_WALL_EVERY
 *
 * between two planes, whose costs are interpolated. The cost of a height is the lesser of those of
 * the level and the upright plane, after SWEEP_WALL_COST is added to the upright one.
 *
 * Costs are summed along paths in four directions (semi-global matching, Hirschmueller 2008): a
 * change by one plane costs SWEEP_STEP_COST, and a larger change costs a jump, which is cheaper
 * across edges of the picture. A parabola through the sums about the least gives fractions of a
 * plane.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_STEREO_SWEEP_H
#define SCENE_STEREO_SWEEP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/splat/camera.h"

struct dev;

enum {
    SWEEP_NEAR_MAX = 8,
    SWEEP_PLANES_MAX = 192,
    SWEEP_RADIUS = 3,      /* of windows, px: every other pixel, as on a chessboard */
    SWEEP_COST_MOST = 200, /* where nothing correlates */
    SWEEP_STEP_COST = 8,
    SWEEP_JUMP_LOW = 30,
    SWEEP_JUMP_HIGH = 120,
    SWEEP_TILE_W = 64, /* px */
    SWEEP_TILE_H = 32,
    SWEEP_WALL_EVERY = 2, /* level planes from one upright plane to the next */
    SWEEP_WALL_MORE = 12, /* upright planes below and above the heights */
    SWEEP_WALL_COST = 4
};
#define SWEEP_NOISE 4e-5 /* variance of grey values that is not texture */
#define SWEEP_LIKE 0.1   /* a pixel that differs this much in grey has a quarter of the weight */
#define SWEEP_DOWN 0.05  /* rays that fall less than this a unit forward get no height */
#define SWEEP_WALL_SLOPE 0.2 /* rays that go less than this sideways a unit down show no walls */
#define SWEEP_EDGE 25.0 /* a grey step of 1 / SWEEP_EDGE halves a jump's cost above its least */

struct sweep_view {
    struct camera cam;
    const uint8_t *grey; /* [h][w]; borrowed */
};
struct sweep_input {
    struct sweep_view ref, near[SWEEP_NEAR_MAX];
    size_t n_near;
    double low_m, step_m; /* height of the first plane, distance of planes; ENU metres */
    uint32_t planes;      /* 2 to SWEEP_PLANES_MAX */
    bool walls;           /* upright planes too */
};
struct sweep_plane { /* normal^T X = at_m; the normal points away from the eye */
    double normal[3], at_m;
};
struct sweep; /* compiled kernels and buffers */
/* Builds the kernels for sweeps of at most `planes` planes. Free *out with sweep_close. ERR_ARG,
 * ERR_DEVICE, ERR_MEM. */
enum err_code sweep_open(struct dev *dev, uint32_t planes, struct sweep **out,
                         struct err *e) ERR_USE;
void sweep_close(struct sweep **s);
/* Writes the plane of every pixel, with fractions, [h][w], and the correlation there, 0 to 1. It
 * waits. ERR_ARG (no neighbour, or the number of planes), ERR_MEM, ERR_DEVICE. */
enum err_code sweep_run(struct sweep *s, const struct sweep_input *in, float *plane, float *score,
                        struct err *e) ERR_USE;
/* The map from pixels of the reference to those of neighbour k by a plane, row-major. The third
 * coordinate of the result is above 0 if the ray goes along the normal and the place lies in front
 * of both cameras. */
void sweep_homography(const struct sweep_input *in, size_t k, const struct sweep_plane *plane,
                      double out[9]);
struct sweep_plane sweep_level(double z_m);
/* A ray of the reference through (x, y) px: M x. */
void sweep_ray(const struct sweep_input *in, double x, double y, double out[3]);
/* The upright planes of a tile of pixels. */
struct sweep_wall {
    double direction[2], rho; /* of its middle */
    int first, end;           /* planes that its pixels need */
};
/* x0, y0: the tile's first pixel. False: it sees no walls. */
bool sweep_wall(const struct sweep_input *in, uint32_t x0, uint32_t y0, struct sweep_wall *out);
struct sweep_plane sweep_upright(const struct sweep_input *in, const struct sweep_wall *w, int q);
/* Number of upright planes, of all tiles. */
static inline size_t sweep_upright_planes(const struct sweep_input *in)
{
    return in->planes / SWEEP_WALL_EVERY + 1 + 2 * (size_t)SWEEP_WALL_MORE;
}

/* Reference in double on the host. ERR_MEM. */
enum err_code sweep_ref_run(const struct sweep_input *in, double *plane, double *score,
                            struct err *e) ERR_USE;
#endif
