/* What changed between two stores of one place: heights of the one minus those of the other as a
 * map, and figures about heights and colours. Where only one of them was surveyed nothing is said.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CHANGE_H
#define SURVEY_CHANGE_H

#include <stdbool.h>

#include "survey/map.h"

#define CHANGE_LEAST_M 0.5 /* a height that differs by more has changed, unless said otherwise */

struct change_request {
    int epsg;               /* as map_request */
    double gsd_m;           /* 0: that of the coarser of the two */
    const double *bbox_deg; /* NULL: where both were surveyed */
    double least_m;         /* 0: CHANGE_LEAST_M */
    bool align;             /* move and tilt the later onto the earlier first */
};
/* How the later lies to the earlier as a whole. */
struct change_pose {
    double east_m, north_m, up_m; /* NAN: not known, see change_report */
    double tilt_east, tilt_north; /* metres that it gets higher by a metre to the east, north; up_m
                                     is that in the middle of the map */
};
struct change_report {
    struct map_grid grid;
    uint64_t pixels; /* with a surface in both */
    double pixel_m2; /* of one, on the ground in the middle */
    double mean_m;   /* of the later minus the earlier, as all below */
    double median_m,
        spread_m;         /* to the centimetre; spread: 1.48 times the median absolute deviation */
    double changed_share; /* of the pixels: by more than least_m */
    double gained_m3, lost_m3; /* of those */
    double color;              /* root mean square difference of colours, 0 to 1 */
    /* What shift, with the slopes of the earlier, and what tilt explain the differences below 2 m
     * best (Nuth and Kaeaeb 2011). Where the median is more than half of that away from 0, up_m is
     * the median, and the others are not known. Aligned: the sum of all rounds. */
    struct change_pose pose;
    bool aligned;
    uint32_t rounds;         /* of alignment */
    struct change_pose left; /* aligned: what the figures above, which are after it, still have */
};
/* Write later minus earlier as a Cloud Optimized GeoTIFF of heights. ERR_ARG: they have no area in
 * common; ERR_DATA: the later could not be brought onto the earlier; errors of map_plan, nadir_draw
 * and geotiff.h: ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code change_write(struct nadir *earlier, struct nadir *later,
                           const struct change_request *r, const char *path,
                           struct change_report *report, struct err *e) ERR_USE;

#endif
