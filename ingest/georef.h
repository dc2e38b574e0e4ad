/* COLMAP's frame into metres, east-north-up, from GPS positions some of which are wrong.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_GEOREF_H
#define INGEST_GEOREF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "ingest/sim3.h"

struct georef_photo {         /* in order of file names */
    double center[3], rot[9]; /* in COLMAP's frame; rot is world -> camera */
    bool has_gps;
    double gps_enu_m[3];
    uint32_t flight_hint; /* flights told apart by time or folder, 0 .. */
};
struct georef_config {
    double inlier_m;             /* 8: of the random draws */
    double tau_min_m, tau_max_m; /* 6, 64: bounds of the rejection distance */
    double ground_normal[3];     /* unit, in COLMAP's frame, either sign; 0 0 0 = unknown */
    double normal_sigma;         /* radians that it may be off; 0: as ground is, about 0.2 */
    uint64_t seed;
};
struct georef_result { /* {0} is empty; georef_free */
    struct sim3 sim;   /* COLMAP -> ENU */
    struct sim3_fit fit;
    double tau_m; /* photographs farther than this from their GPS position were dropped */
    int rounds;
    bool collinear; /* the flight line is straight: its roll comes from the cameras being level */
    size_t n_gps, n_dropped, n_flights;
    double flight_offset_m[SIM3_GROUPS_MAX]; /* of the GPS heights, relative to flight 0, the
                                                      largest */
    double *residual_m;                      /* [n] after flight offsets; NaN without GPS */
    bool *dropped;                           /* [n] */
    uint32_t *flight;                        /* [n] */
};
/* ERR_DATA: fewer than three usable positions, or all cameras at one place; the message says which.
 */
enum err_code georef_fit(const struct georef_photo *photos, size_t n,
                         const struct georef_config *cfg, struct georef_result *out,
                         struct err *e) ERR_USE;
/* Without GPS: COLMAP's frame turned upright and scaled, the mean camera over the origin's east and
 * north. ERR_DATA: no such frame. */
enum err_code georef_upright(const struct georef_photo *photos, size_t n,
                             const double ground_normal[3], double normal_sigma, double scale,
                             struct sim3 *out, struct err *e) ERR_USE;
void georef_free(struct georef_result *r);

#endif
