/* Fits the similarity that moves located points to their surveyed places. The errors of both kinds
 * of places are known, and some points may be wrong.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_SOLVE_H
#define SCENE_CONTROL_GCP_SOLVE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "scene/control/sim3.h"

struct gcp_tie {         /* a point to fit */
    double x[3], cov[9]; /* in COLMAP's frame */
    double y[3],
        var_m[2];  /* surveyed: east, north, up; variances of each horizontal axis and of height */
    double weight; /* output: 1: used, 0: not used */
};
struct gcp_solution {
    struct sim3 sim;
    double center_m[3]; /* centre of rotation and scale for the seven unknowns */
    /* normal matrix for rotation, log of scale, and shift; for the stated accuracies */
    double normal[49];
    double factor; /* ratio of errors of points to their stated accuracy; at least 1 */
};
/* Effect of leaving a point out. NAN: the others do not determine the frame. For a point that is
 * not used anyway, `turn` is the change of the frame if it were used. */
struct gcp_left {
    double residual_m[3],
        sigma_m[2]; /* fitted minus surveyed; predicted, on each horizontal axis and of height */
    double sigmas;  /* the residual in standard deviations, over all axes */
    double turn[7]; /* the change of the frame, for gcp_solve_move */
};
/* Fits. up: the ground's normal in the frame of x, which should point upwards within up_sigma
 * radians; 0: not used. robust: points that contradict most others have less weight, or none; else
 * all have full weight. *fixed false: the points do not determine a frame. ERR_MEM. */
enum err_code gcp_solve(struct gcp_tie *ties, size_t n, const double up[3], double up_sigma,
                        bool robust, struct gcp_solution *out, bool *fixed, struct err *e) ERR_USE;
void gcp_solve_leave_out(const struct gcp_solution *s, const struct gcp_tie *tie,
                         struct gcp_left *out);
/* Covariance of a place y in the fitted frame, from the frame's error alone; not scaled by
 * s->factor. */
void gcp_solve_error(const struct gcp_solution *s, const double y[3], double cov[9]);
/* How far turn [7] shifts a place y. */
void gcp_solve_move(const struct gcp_solution *s, const double turn[7], const double y[3],
                    double shift[3]);
/* The residual of a tie, fitted minus surveyed, and its covariance, which includes survey and
 * marks. */
void gcp_solve_residual(const struct sim3 *s, const struct gcp_tie *tie, double residual_m[3],
                        double cov[9]);
/* Size of a residual in standard deviations of cov, over all axes. HUGE_VAL: cov is singular. */
double gcp_solve_sigmas(const double residual_m[3], const double cov[9]);

#endif
