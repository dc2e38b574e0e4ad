/* Fits COLMAP's frame to metres, east-north-up, by GPS positions of which some are wrong.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GEOREF_H
#define SCENE_CONTROL_GEOREF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "scene/control/sim3.h"

struct georef_photo {         /* photographs in the order of file names */
    double center[3], rot[9]; /* in COLMAP's frame; rot is world -> camera */
    bool has_gps;
    double gps_enu_m[3];
    double sigma_m[2];    /* its accuracy, on each horizontal axis and of height; 0: not known */
    uint32_t flight_hint; /* number of the flight by time or folder, from 0 */
};
struct georef_config {
    double inlier_m;         /* distance of inliers in the random draws, usually 8 */
    double ground_normal[3]; /* unit vector in COLMAP's frame, either sign; 0 0 0 = unknown */
    double normal_sigma;     /* its uncertainty in radians; 0: that of ground, about 0.2 */
    uint64_t seed;
};
struct georef_result { /* {0} is empty; georef_free */
    struct sim3 sim;   /* COLMAP -> ENU */
    struct sim3_fit fit;
    double tau_m; /* photographs farther than this from their GPS position were dropped; 6 to 64 */
    int rounds;
    bool collinear; /* the flight line is straight: the roll follows from level cameras */
    size_t n_gps, n_dropped, n_flights;
    /* offset of GPS heights relative to flight 0, the largest */
    double flight_offset_m[SIM3_GROUPS_MAX];
    double *residual_m; /* [n] after flight offsets; NaN without GPS */
    bool *dropped;      /* [n] */
    uint32_t *flight;   /* [n] */
};
/* Fits. Free *out with georef_free. ERR_DATA: fewer than three usable positions, or all cameras are
 * at one place; the message says which. ERR_MEM. */
enum err_code georef_fit(const struct georef_photo *photos, size_t n,
                         const struct georef_config *cfg, struct georef_result *out,
                         struct err *e) ERR_USE;
/* Without GPS: rotates COLMAP's frame upright, scales it, and puts the mean camera above the
 * origin. ERR_DATA: there is no such frame. ERR_MEM. */
enum err_code georef_upright(const struct georef_photo *photos, size_t n,
                             const double ground_normal[3], double normal_sigma, double scale,
                             struct sim3 *out, struct err *e) ERR_USE;
void georef_free(struct georef_result *r);

#endif
