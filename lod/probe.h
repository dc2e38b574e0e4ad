/* The surface at single places: height and colour of what is seen from straight above.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PROBE_H
#define LOD_PROBE_H

#include "lod/nadir.h"

struct probe {
    bool surveyed, found; /* the place lies in the survey; there is a surface */
    double height_m;      /* ellipsoidal; NAN without a surface */
    /* Lowest and highest surface within a pixel to each side: how far the height depends on where
     * exactly the place is. */
    double height_min_m, height_max_m;
    float rgb[3];    /* 0 to 1 */
    struct key tile; /* the finest tile there; valid when surveyed */
    uint8_t level;
    double pixel_m; /* the surface was drawn with */
};
/* gsd_m 0: about as fine as the Gaussians are. Errors of nadir_draw; ERR_ARG: no place on Earth. */
enum err_code probe_at(struct nadir *n, double lon_deg, double lat_deg, double gsd_m,
                       struct probe *out, struct err *e) ERR_USE;
/* Many places at once: those that lie near each other share a picture, so a place that is not the
 * first of its picture gets the pixel nearest to it. lonlat: [count][2]. Errors as probe_at:
 * ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code probe_many(struct nadir *n, const double (*lonlat)[2], size_t count, double gsd_m,
                         struct probe *out, struct err *e) ERR_USE;

#endif
