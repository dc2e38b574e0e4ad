/* A surface model of known depths alone, without training: the depths of all photographs by
 * `citysplat stereo`, combined on a map. It takes minutes instead of a training. A trained surface
 * is measured against it.
 *
 * A pixel of the map gathers all heights that fall into it. On a wall they are of many floors, and
 * a map shows the topmost surface. A layer is the heights within two pixels' size of each other. It
 * is dense if it has at least two heights, and at least a third as many as the fullest layer of the
 * pixel. The pixel's height is the median of its highest dense layer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_DEPTH_HEIGHTS_H
#define SURVEY_DEPTH_HEIGHTS_H

#include "survey/map.h"

struct depth_heights_request {
    const char *scene; /* folder that `citysplat ingest` made */
    const char
        *depth;   /* folder of maps NAME.npy, inverse depth in 1/m; NULL: depth/ of the scene */
    int epsg;     /* 0: the UTM zone of the middle */
    double gsd_m; /* 0: the median footprint of the maps' pixels, to two digits */
    const double *bbox_deg;    /* west, south, east, north; NULL: what is known */
    const struct geoid *geoid; /* reference of heights; NULL: that of the scene */
    size_t most_samples; /* in memory at a time, 32 bytes each, and 16 of pixels; 0: 8 million */
};
/* Writes a GEOTIFF_SURFACE: heights and their scatter (1.48 MAD of the layer) in metres, nodata
 * where no layer is dense. It is written beside `path` and renamed. words says what heights count
 * from. ERR_NOENT: no scene, or no depth maps in it; the message says how to make them. ERR_ARG:
 * the area is empty or too large, or the geoid does not go with the scene's heights. ERR_FORMAT,
 * ERR_IO, ERR_MEM, ERR_CANCEL. */
enum err_code depth_heights_write(const struct depth_heights_request *r, const char *path,
                                  struct map_report *out, char words[100], struct err *e) ERR_USE;

#endif
