/* Changes between two stores of one place: a map of the heights of one minus those of the other,
 * and statistics of heights and colours. Ground that only one of them surveyed is left out.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CHANGE_H
#define SURVEY_CHANGE_H

#include <stdbool.h>

#include "survey/changed.h"
#include "survey/map.h"

#define CHANGE_LEAST_SIGMA2 4.0 /* smallest ground of a change, in squares of the usual Gaussian */
#define CHANGE_LEAST_M 0.5      /* default of least_m */

struct change_request {
    int epsg;               /* as in map_request */
    double gsd_m;           /* 0: that of the coarser store */
    const double *bbox_deg; /* NULL: where both were surveyed */
    double least_m;         /* a height that differs by more has changed; 0: CHANGE_LEAST_M */
    const char *polygons;   /* file of what changed, see survey/layer.h; NULL: none */
    bool align;             /* first move and tilt the later store onto the earlier one */
};
/* Shift and tilt of the later store against the earlier one. */
struct change_pose {
    double east_m, north_m, up_m; /* NAN: not known, see change_report */
    /* rise in metres per metre to the east and north; up_m is the shift at the middle of the map */
    double tilt_east, tilt_north;
};
struct change_report {
    struct map_grid grid;
    uint64_t pixels; /* number of pixels with a surface in both */
    double pixel_m2; /* area of a pixel on the ground in the middle */
    double mean_m;   /* later minus earlier, as are all members below */
    double median_m,
        spread_m;         /* to the centimetre; spread: 1.48 times the median absolute deviation */
    double differs_share; /* share of pixels that differ by more than least_m */
    struct changed_report changed; /* changes beyond the uncertainty of both */
    double color;                  /* root mean square difference of colours, 0 to 1 */
    /* The shift and tilt that best explain the differences below 2 m, by the slopes of the earlier
     * store (Nuth and Kaeaeb 2011). If median_m is above 1 m or below -1 m, too few differences are
     * below 2 m: up_m is the median, and the others are not known. After alignment: the sum of all
     * rounds. */
    struct change_pose pose;
    bool aligned;
    uint32_t rounds;         /* rounds of alignment */
    struct change_pose left; /* after alignment: shift and tilt that remain */
};
/* Writes the heights of the later store minus those of the earlier one, as a Cloud Optimized
 * GeoTIFF. ERR_ARG: they have no area in common. ERR_DATA: the later store could not be aligned.
 * ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM as in map_plan, nadir_draw and
 * geotiff.h. */
enum err_code change_write(struct nadir *earlier, struct nadir *later,
                           const struct change_request *r, const char *path,
                           struct change_report *report, struct err *e) ERR_USE;

#endif
