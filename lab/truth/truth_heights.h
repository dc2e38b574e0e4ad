/* Compares a surface model with the procedural city that it shows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_TRUTH_HEIGHTS_H
#define LAB_TRUTH_HEIGHTS_H

#include "lab/truth/edge.h"
#include "lab/truth/surface_rays.h"
#include "scene/synth/synth.h"

/* How well the standard deviations of a map predict its errors, over pixels that have one. */
struct truth_sigma {
    size_t n;
    double median_m;     /* of the standard deviations */
    double within[3];    /* share of errors within 1, 2 and 3 standard deviations */
    double ratio_middle; /* median of error / standard deviation; 0.674 if errors are normal */
};
struct truth_heights {
    uint64_t inside, none; /* pixels in the built-up square; those without a surface */
    double pixel_m, gsd_m; /* of the map; of photographs that look straight down */
    /* pixels away from edges, near them, and all. Their thickness and light are not known. Of bare
     * earth (q->ground): pixels where it is seen, where something stands on it, and all. */
    struct surface_figures level, zone, all;
    struct truth_sigma sigma[3]; /* of the same three; n is 0 if the map has none */
    /* over all pixels with a surface: volume of the model minus that of the city */
    double volume_m3;
    size_t edges, missing; /* steps at walls; see edge.h */
    struct edge_score edge;
};
struct truth_request {
    const char *city, *map; /* its folder; a GeoTIFF */
    const char *output;     /* a GeoTIFF to write; NULL: none */
    bool ground;            /* heights are those of bare earth */
};
/* Compares heights above the ellipsoid of the map with those of the city, or with its ground (then
 * there are no walls). With q->output it writes the errors, m, as a GeoTIFF of the same pixels.
 * Errors of truth_config, sheet.h and geotiff.h.
 * ERR_LIMIT: too many pixels. ERR_DATA: it shows nothing of the city. ERR_CANCEL, ERR_MEM. */
enum err_code truth_heights(const struct truth_request *q, struct truth_heights *out,
                            struct err *e) ERR_USE;

#endif
