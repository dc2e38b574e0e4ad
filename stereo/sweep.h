/* Depth of a photograph from its neighbours, by a sweep of horizontal planes.
 *
 * In a city most surfaces are level, or stand on level ground: a height is the label that
 * neighbouring pixels share. For every plane at height z_p = low_m + p step_m the neighbours are
 * drawn as the reference would see them if all lay in that plane (Collins 1996). The pixel x of the
 * reference, homogeneous, falls on
 *
 *     y ~ -(K_k (R_k c + t_k) m^T + (z_p - c_z) K_k R_k M) x,   M = R^T K^-1,   m^T = its third row
 *
 * of neighbour k; c is the reference's centre. Windows are compared by normalised correlation of
 * grey values, which light and exposure do not change; NOISE is added to both variances, so that
 * windows without texture correlate with nothing. A pixel of a window counts by how like the middle
 * it is (Yoon and Kweon 2006), because another grey is often another surface:
 *
 *     w = (1 + (a - a_middle)^2 / LIKE^2)^-2
 *
 * The cost of a plane is 1 minus the mean of the best correlations (Kang, Szeliski and Chai 2001),
 * so that a surface may be hidden from some of the neighbours.
 *
 * Costs are summed along paths in four directions (semi-global matching, Hirschmueller 2008): a
 * change by one plane costs SWEEP_STEP_COST, and one by more a jump, which is cheaper across edges
 * of the picture. A parabola through the sums about the least gives parts of a plane.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STEREO_SWEEP_H
#define STEREO_SWEEP_H

#include <stddef.h>
#include <stdint.h>

#include "core/camera.h"
#include "core/err.h"

struct dev;

enum {
    SWEEP_NEAR_MAX = 8,
    SWEEP_PLANES_MAX = 192,
    SWEEP_RADIUS = 3,      /* of windows, px: every other pixel, as on a chessboard */
    SWEEP_COST_MOST = 200, /* where nothing correlates */
    SWEEP_STEP_COST = 8,
    SWEEP_JUMP_LOW = 30,
    SWEEP_JUMP_HIGH = 120
};
#define SWEEP_NOISE 4e-5 /* variance of grey values that is not texture */
#define SWEEP_LIKE 0.1   /* difference of grey values at which a pixel counts a quarter */
#define SWEEP_EDGE 25.0  /* a change of grey by 1 / SWEEP_EDGE halves what a jump may save */

struct sweep_view {
    struct camera cam;
    const uint8_t *grey; /* [h][w]; borrowed */
};
struct sweep_input {
    struct sweep_view ref, near[SWEEP_NEAR_MAX];
    size_t n_near;
    double low_m, step_m; /* height of the first plane, distance of planes; ENU metres */
    uint32_t planes;      /* 2 to SWEEP_PLANES_MAX */
};
struct sweep; /* compiled kernels and buffers */
/* Builds the kernels for sweeps of at most `planes` planes. Free *out with sweep_close. ERR_ARG,
 * ERR_DEVICE, ERR_MEM. */
enum err_code sweep_open(struct dev *dev, uint32_t planes, struct sweep **out,
                         struct err *e) ERR_USE;
void sweep_close(struct sweep **s);
/* Writes the plane of every pixel, in parts, [h][w], and the correlation there, 0 to 1. It waits.
 * ERR_ARG (no neighbour, or the number of planes), ERR_MEM, ERR_DEVICE. */
enum err_code sweep_run(struct sweep *s, const struct sweep_input *in, float *plane, float *score,
                        struct err *e) ERR_USE;
/* The map from pixels of the reference to those of neighbour k by the plane at height z_m,
 * row-major. Its third coordinate is above 0 for rays that go down and places before both. */
void sweep_homography(const struct sweep_input *in, size_t k, double z_m, double out[9]);

/* Reference in double on the host. cost [h][w][planes]. ERR_MEM. */
void sweep_ref_cost(const struct sweep_input *in, double *cost);
enum err_code sweep_ref_run(const struct sweep_input *in, double *plane, double *score,
                            struct err *e) ERR_USE;
#endif
