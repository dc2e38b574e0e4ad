/* Similarity transforms y = scale R x + trans: in closed form from point pairs, and refined with
 * all that is known about a drone survey.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_SIM3_H
#define SCENE_CONTROL_SIM3_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { SIM3_GROUPS_MAX = 8 };

struct sim3 {
    double scale, rot[9], trans[3];
};
void sim3_apply(const struct sim3 *s, const double x[3], double y[3]);
/* Rotates by d[0..2] and scales by exp(d[3]) about center (in the frame of y), then shifts by
 * d[4..6]. */
void sim3_step(struct sim3 *s, const double d[7], const double center[3]);

/* Eigenvalues (ascending) and eigenvectors (rows of `vectors`, unit) of a symmetric n x n matrix, n
 * <= 4. */
void sim3_eigen(const double *matrix, size_t n, double *values, double *vectors);

/* Least squares over the pairs index[0..n) (NULL: all) of x and y. up_x is a unit vector that
 * should become +z. It decides the roll if the pairs are collinear, and has little weight
 * otherwise. Returns false if the pairs coincide. */
bool sim3_from_pairs(const double (*x)[3], const double (*y)[3], const uint32_t *index, size_t n,
                     const double up_x[3], struct sim3 *out);

struct sim3_problem {              /* all borrowed */
    const double (*x)[3], (*y)[3]; /* [n] camera centres, GPS positions in ENU */
    const double (
        *right)[3]; /* [n] x axes of the cameras in the frame of x; level except for the roll */
    /* [n] horizontal and vertical errors relative to the median pair; NULL: all are equal */
    const double (*ratio)[2];
    const bool *use;       /* [n] pairs that may be used */
    const uint32_t *group; /* [n] flight, 0 .. n_groups-1; each has its own height offset */
    size_t n, n_groups;
    /* radians by which the cameras are out of level, in the frame where they are most level */
    double level_sigma;
    double normal[3];    /* ground normal in the frame of x, upwards; 0 0 0 = unknown */
    double normal_sigma; /* its uncertainty in radians; 0: that of ground, about 0.2 */
    double cut_m;        /* pairs farther apart have no weight */
};
struct sim3_fit {
    struct sim3 sim;
    double offset_m[SIM3_GROUPS_MAX]; /* y_z = ... + offset of the flight; flight 0 has 0 */
    /* robust standard deviation, of each horizontal axis and of heights; 0 = not known yet */
    double sigma_h_m, sigma_v_m;
    double share_h,
        share_v; /* share of positions that are independent, because drifting errors repeat */
    /* of several fits of one problem, that with the smallest objective is most likely */
    double objective;
    double scale_rel, tilt_rad, heading_rad, place_m; /* standard errors */
};
/* Gauss-Newton with iteratively reweighted residuals (Huber, then cut), from fit->sim and
 * fit->offset_m. ERR_DATA: the normal equations are singular. */
enum err_code sim3_refine(const struct sim3_problem *p, struct sim3_fit *fit,
                          struct err *e) ERR_USE;
/* Distance of pair i under the fit. If heights are more than twice as uncertain as places, the
 * height part is reduced accordingly. */
double sim3_residual(const struct sim3_problem *p, const struct sim3_fit *fit, size_t i);
/* As sim3_from_pairs, with up_x taken as exact. Rotation about it, scale and shift follow from the
 * horizontal parts of the pairs, the height from their median. scratch has n doubles. */
bool sim3_from_plan(const double (*x)[3], const double (*y)[3], const uint32_t *index, size_t n,
                    const double up_x[3], double *scratch, struct sim3 *out);

#endif
