/* The surface at single places: height and colour as seen from straight above.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PROBE_H
#define LOD_PROBE_H

#include "lod/surface/surface.h"

struct probe {
    bool surveyed, found; /* surveyed: the place is in the survey; found: there is a surface */
    double height_m;      /* ellipsoidal; NAN: no surface */
    double sigma_m;       /* its standard deviation */
    double noise_m;       /* standard deviation of a level place: see surface_maps */
    /* lowest and highest surface within one pixel on each side: they show how much the exact place
     * matters */
    double height_min_m, height_max_m;
    float rgb[3];    /* 0 to 1 */
    struct key tile; /* the finest tile there; valid if surveyed */
    uint8_t level;
    double pixel_m; /* size of a pixel of the drawing */
};
/* Probes many places, lonlat [count][2]. gsd_m is the pixel size; 0: about the size of the
 * Gaussians. Places near each other share a picture, which is centred on the first of them; the
 * others get their nearest pixel. ERR_ARG: not a place on earth. ERR_CANCEL, ERR_DEVICE,
 * ERR_FORMAT, ERR_LIMIT, ERR_MEM as in nadir_draw. */
enum err_code probe_many(struct nadir *n, const double (*lonlat)[2], size_t count, double gsd_m,
                         struct probe *out, struct err *e) ERR_USE;

#endif
