/* Measures the surface of a store: along a line, inside a polygon, along a line of sight.
 *
 * Heights are ellipsoidal, in metres. Horizontal lengths and areas are in a plane that touches the
 * earth at the place of measurement, at the height of the store's origin. The error is 1 cm in a
 * kilometre.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_MEASURE_H
#define LOD_MEASURE_H

#include "lod/surface/probe.h"

enum { MEASURE_CORNERS_MAX = 256, MEASURE_SAMPLES_MAX = 2000 };
#define MEASURE_PIXELS_MAX 4e6
#define MEASURE_CLEAR_M 1.0 /* obstacles nearer to the target than this count as part of it */

#define MEASURE_REACH_M 1e5 /* largest distance of places from the first one */

/* Converts places lonlat [count][2] to at [count][2], metres in the plane of a frame about the
 * first place. ERR_DATA: one is too far from the first. ERR_ARG: not a place on earth. */
enum err_code measure_plan(const struct nadir *n, const double (*lonlat)[2], size_t count,
                           struct geo_origin *frame, double (*at)[2], struct err *e) ERR_USE;

struct measure_sample {
    double distance_m, lon_deg, lat_deg;
    struct probe probe;
};
/* Samples the surface every step_m along a line of places [count][2], and at its corners. step_m 0:
 * a pixel, or longer if there would be too many samples. gsd_m is the pixel size; 0: about the size
 * of the Gaussians, or the step if that is less, down to a fourth of it. Free *out with mem_free.
 * length_m is horizontal. ERR_DATA: fewer than 2 places, or too many samples; the message says
 * which step is possible. ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM as in
 * measure_plan and probe_many. */
enum err_code measure_profile(struct nadir *n, const double (*lonlat)[2], size_t count,
                              double step_m, double gsd_m, struct measure_sample **out,
                              size_t *n_out, double *length_m, struct err *e) ERR_USE;

/* Computes how much a profile climbs and falls in all, in m. A rise or fall counts if it exceeds
 * three standard deviations of its two ends (noise_m of surface_maps), so noise of level ground
 * adds little. Samples without a surface are skipped. */
void measure_climb(const struct measure_sample *s, size_t n, double *climb_m, double *fall_m);

struct measure_area {
    double area_m2, perimeter_m; /* horizontal */
    double known_m2;             /* area with a surface; the rest is for that part alone */
    double surface_m2;           /* area of the surface itself, with steps and slopes */
    double base_m;               /* height of the base in the middle of the corners */
    double above_m3, below_m3;   /* volumes between surface and base */
    /* Uncertainty of the volumes. Edges of steep faces are blurred by half a pixel and a part of a
     * Gaussian; the plane of a rim is known as well as heights along the rim fit it. */
    double error_m3;
    double mean_m, lowest_m, highest_m; /* heights of the surface; NAN: none */
    double pixel_m;
};
/* Measures inside a polygon [count][2]. base_m: height of a level base; NAN: the plane through the
 * surface along the rim, by least squares. gsd_m is the pixel size. 0: a fourth of the usual size
 * of a Gaussian; for a large polygon more, up to that size. ERR_DATA: the polygon is not simple,
 * has too many pixels, or no surface along its rim. ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT,
 * ERR_LIMIT, ERR_MEM as in measure_plan and nadir_draw. */
enum err_code measure_polygon(struct nadir *n, const double (*lonlat)[2], size_t count,
                              double base_m, double gsd_m, struct measure_area *out,
                              struct err *e) ERR_USE;

struct measure_sight {
    double distance_m;
    double light;      /* share of light that arrives */
    bool visible;      /* at least half of the light arrives */
    double blocked_m;  /* distance to the obstacle; NAN if visible, and so is `blocked` */
    double blocked[3]; /* its longitude, latitude, height */
};
/* Computes whether `to` is visible from `from`: longitude, latitude, height. Obstacles within
 * MEASURE_CLEAR_M of `to` count as part of it. ERR_DATA: the places are less than 2 m or more than
 * 50 km apart. ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM as in nadir_look. */
enum err_code measure_sight(struct nadir *n, const double from[3], const double to[3],
                            struct measure_sight *out, struct err *e) ERR_USE;

#endif
