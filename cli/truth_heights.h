/* A surface model against the procedural city that it is of.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_TRUTH_HEIGHTS_H
#define CLI_TRUTH_HEIGHTS_H

#include "survey/edge.h"
#include "synth/synth.h"

struct truth_heights {
    uint64_t inside, none; /* pixels of the built-up square; without a surface */
    uint64_t level;        /* of the others, those away from edges, which are scored */
    double pixel_m;
    double median_m, most_m, off_m; /* of their distances: median, 95 %; median with its sign */
    double volume_m3;               /* of all with a surface: the model's minus the city's */
    size_t edges, missing;          /* steps of walls; see edge.h */
    struct edge_score edge;
};
/* Heights of the GeoTIFF cfg->map, above the ellipsoid, against the city of folder cfg->city.
 * Errors of synth_views_config and sheet.h; ERR_LIMIT: too many pixels; ERR_DATA: nothing of the
 * city is in it; ERR_CANCEL, ERR_MEM. */
enum err_code truth_heights(const struct synth_config *cfg, struct truth_heights *out,
                            struct err *e) ERR_USE;

#endif
