/* Measuring the surface of a store: along a line, within a polygon, from eye to eye.
 *
 * Heights are ellipsoidal, in metres. Lengths and areas in the plan are those of the plane that
 * touches the Earth where it is measured, at the height of the store's origin: 1 cm off in a
 * kilometre.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_MEASURE_H
#define LOD_MEASURE_H

#include "lod/probe.h"

enum { MEASURE_CORNERS_MAX = 256, MEASURE_SAMPLES_MAX = 2000 };
#define MEASURE_PIXELS_MAX 4e6
#define MEASURE_CLEAR_M 1.0 /* before the place that is looked at nothing is in the way */

#define MEASURE_REACH_M 1e5 /* of the places of a line or a polygon from the first */

/* Places [count][2] in the plane of a frame about the first, to at [count][2], metres. ERR_DATA:
 * one is too far from the first; ERR_ARG: no place on Earth. */
enum err_code measure_plan(const struct nadir *n, const double (*lonlat)[2], size_t count,
                           struct geo_origin *frame, double (*at)[2], struct err *e) ERR_USE;

struct measure_sample {
    double distance_m, lon_deg, lat_deg;
    struct probe probe;
};
/* Samples every step_m (0: a pixel; longer where that makes too many) along a line of places
 * [n][2], its corners among them. *out: mem_free it. length_m: in the plan. ERR_DATA: fewer than 2
 * places, too many samples, says from which step on it fits; errors of measure_plan and probe_many:
 * ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code measure_profile(struct nadir *n, const double (*lonlat)[2], size_t count,
                              double step_m, struct measure_sample **out, size_t *n_out,
                              double *length_m, struct err *e) ERR_USE;

struct measure_area {
    double area_m2, perimeter_m;        /* in the plan */
    double known_m2;                    /* of it with a surface; what follows is of this part */
    double surface_m2;                  /* of the surface itself, steps and slopes counted */
    double base_m;                      /* of the base in the middle of the corners */
    double above_m3, below_m3;          /* between surface and base */
    double mean_m, lowest_m, highest_m; /* of the surface; NAN: none */
    double pixel_m;
};
/* Within a polygon [n][2]. base_m: height of a level base; NAN: the plane through the surface along
 * the rim, least squares. gsd_m 0: a fourth of the usual Gaussian, or what makes 250,000 pixels.
 * ERR_DATA: no simple polygon, too many pixels, no surface along the rim; errors of measure_plan
 * and nadir_draw: ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code measure_polygon(struct nadir *n, const double (*lonlat)[2], size_t count,
                              double base_m, double gsd_m, struct measure_area *out,
                              struct err *e) ERR_USE;

struct measure_sight {
    double distance_m;
    double light;      /* share that arrives */
    bool visible;      /* at least half of it */
    double blocked_m;  /* distance to what is in the way; NAN when visible, as is */
    double blocked[3]; /* its longitude, latitude, height */
};
/* Is `to` seen from `from`: longitude, latitude, height. What is less than MEASURE_CLEAR_M before
 * it is taken for part of it. ERR_DATA: the places are less than 2 m or more than 50 km apart;
 * errors of nadir_look: ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code measure_sight(struct nadir *n, const double from[3], const double to[3],
                            struct measure_sight *out, struct err *e) ERR_USE;

#endif
