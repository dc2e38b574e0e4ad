/* The similarity that puts located points where they were surveyed, with errors of both known, some
 * of the points wrong.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_GCP_SOLVE_H
#define INGEST_GCP_SOLVE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "ingest/sim3.h"

struct gcp_tie {         /* a point to fit to */
    double x[3], cov[9]; /* in COLMAP's frame */
    double y[3],
        var_m[2];  /* surveyed, east north up; variances of an axis in plan, of the height */
    double weight; /* out: 1 counts, 0 does not */
};
struct gcp_solution {
    struct sim3 sim;
    double center_m[3]; /* about which the seven unknowns turn and stretch */
    double normal[49];  /* normal matrix of turn, log of scale, shift; in units of what was said */
    double factor;      /* times that points err more than was said; at least 1 */
};
/* What leaving a point out says; NAN: the others do not fix the frame. Of a point that does not
 * count anyway: how the frame would go if it did. */
struct gcp_left {
    double residual_m[3],
        sigma_m[2]; /* fitted minus surveyed; predicted, an axis in plan, height */
    double sigmas;  /* the residual in standard deviations, all axes */
    double turn[7]; /* how the frame goes then: for gcp_solve_move */
};
/* up: the ground's normal in the frame of x, which should turn upwards to up_sigma radians; 0: it
 * does not count. robust: points that contradict most of the others count less, or not; else all
 * do. False: the points do not fix a frame. ERR_MEM. */
enum err_code gcp_solve(struct gcp_tie *ties, size_t n, const double up[3], double up_sigma,
                        bool robust, struct gcp_solution *out, bool *fixed, struct err *e) ERR_USE;
void gcp_solve_leave_out(const struct gcp_solution *s, const struct gcp_tie *tie,
                         struct gcp_left *out);
/* Covariance of the frame at a place y of it, without the factor. */
void gcp_solve_error(const struct gcp_solution *s, const double y[3], double cov[9]);
/* Where a place y goes by turn[7]: the shift. */
void gcp_solve_move(const struct gcp_solution *s, const double turn[7], const double y[3],
                    double shift[3]);
/* Of a tie under the solution: its residual, fitted minus surveyed, and the covariance of both. */
void gcp_solve_residual(const struct sim3 *s, const struct gcp_tie *tie, double residual_m[3],
                        double cov[9]);
/* Residual in standard deviations of cov, all axes. HUGE_VAL: cov is singular. */
double gcp_solve_sigmas(const double residual_m[3], const double cov[9]);

#endif
