/* Compares a surface model with the procedural city that it shows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_TRUTH_HEIGHTS_H
#define CLI_TRUTH_HEIGHTS_H

#include "survey/edge.h"
#include "synth/synth.h"

struct truth_heights {
    uint64_t inside, none; /* pixels in the built-up square; those without a surface */
    uint64_t level;        /* pixels with a surface and away from edges, which are scored */
    double pixel_m;
    /* height differences: median and 95 % of their size; median with sign */
    double median_m, most_m, off_m;
    /* over all pixels with a surface: volume of the model minus that of the city */
    double volume_m3;
    size_t edges, missing; /* steps at walls; see edge.h */
    struct edge_score edge;
};
/* Compares heights above the ellipsoid of the GeoTIFF cfg->map with the city of folder cfg->city.
 * Errors of synth_views_config and sheet.h. ERR_LIMIT: too many pixels. ERR_DATA: it shows nothing
 * of the city. ERR_CANCEL, ERR_MEM. */
enum err_code truth_heights(const struct synth_config *cfg, struct truth_heights *out,
                            struct err *e) ERR_USE;

#endif
