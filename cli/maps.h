/* What the commands that make maps share: the area, the run, the line at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_MAPS_H
#define CLI_MAPS_H

#include "survey/map.h"

struct maps_options {
    const char *store, *output, *bbox, *ceiling, *appearance, *device; /* NULL: not given */
    int epsg;
    double gsd_m;
};
/* Make the map and print one line. ERR_ARG names the option; else as map_write. */
enum err_code maps_make(enum geotiff_kind kind, const struct maps_options *o,
                        struct err *e) ERR_USE;
/* A number of this option, NAN when text is NULL. ERR_ARG. */
enum err_code maps_number(const char *option, const char *text, double *out, struct err *e) ERR_USE;
/* west,south,east,north of --bbox. ERR_ARG. */
enum err_code maps_bbox(const char *text, double out[4], struct err *e) ERR_USE;

#endif
