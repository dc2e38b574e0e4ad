/* Maps of a survey report, as SVG: what the photographs cover, how finely, and where positions
 * disagree.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_REPORT_MAP_H
#define CLI_REPORT_MAP_H

#include "cells/footprint.h"
#include "codec/image.h"
#include "codec/scene.h"

enum {
    REPORT_VIEWS = 6 /* classes of coverage: 0, 1, 2, 3 to 4, 5 to 9, 10 and more photographs */
};

struct report_ground {                 /* per cell of the footprint's grid; report_ground_free */
    const struct footprint *footprint; /* borrowed */
    float *gsd_m;                      /* [ny][nx] of the nearest photograph that shows it; NAN */
    double gsd_m_low, gsd_m_median, gsd_m_high; /* 5, 50 and 95 % of what is inside; NAN: none */
    double share[REPORT_VIEWS];                 /* of the ground inside by class of coverage */
    double area_m2;
    double
        box_m[4]; /* ENU: west, south, east, north of what photographs show, and of the cameras */
};
/* ERR_MEM. */
enum err_code report_ground_of(const struct scene *s, const struct footprint *f,
                               struct report_ground *out, struct err *e) ERR_USE;
void report_ground_free(struct report_ground *g);

/* Append a picture as <img>, PNG or JPEG inside of the text. ERR_MEM, ERR_INTERNAL. */
enum err_code report_map_image(const struct image *img, const char *format, const char *style,
                               struct buf *out, struct err *e) ERR_USE;
/* Append maps, north up, with legend and scale: coverage with the cameras; ground sampling
 * distance; positions against GPS, arrows `times` as long as they are. ERR_MEM, ERR_INTERNAL. */
enum err_code report_map_coverage(const struct scene *s, const struct report_ground *g,
                                  struct buf *out, struct err *e) ERR_USE;
enum err_code report_map_gsd(const struct scene *s, const struct report_ground *g, struct buf *out,
                             struct err *e) ERR_USE;
enum err_code report_map_residuals(const struct scene *s, const struct report_ground *g,
                                   struct buf *out, struct err *e) ERR_USE;
/* Colours of heights with shade, from heights [h][w], m; NAN and what is below `none` is white.
 * range: 2 and 98 % of them. ERR_MEM, ERR_ARG. */
enum err_code report_map_relief(const float *height_m, uint32_t w, uint32_t h, double pixel_m,
                                float none, struct image *out, double range_m[2],
                                struct err *e) ERR_USE;
/* Append a legend of the relief's colours. */
void report_map_relief_legend(double low_m, double high_m, struct buf *out);

#endif
