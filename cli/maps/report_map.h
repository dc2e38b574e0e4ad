/* Maps of a survey report as SVG: coverage by photographs, resolution, and residuals of positions.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_REPORT_MAP_H
#define CLI_REPORT_MAP_H

#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "scene/cells/footprint.h"

enum {
    REPORT_VIEWS = 6 /* classes of coverage: 0, 1, 2, 3 to 4, 5 to 9, 10 and more photographs */
};

/* values for each cell of the footprint's grid; free with report_ground_free */
struct report_ground {
    const struct footprint *footprint; /* borrowed */
    float *gsd_m; /* [ny][nx] of the nearest photograph that shows the cell; NAN: none */
    /* quantiles of 5, 50 and 95 % over the cells inside; NAN: none */
    double gsd_m_low, gsd_m_median, gsd_m_high;
    double share[REPORT_VIEWS]; /* share of the ground inside by class of coverage */
    double area_m2;
    double box_m[4]; /* ENU: west, south, east, north of what photographs show and of the cameras */
};
/* Computes these values. ERR_MEM. */
enum err_code report_ground_of(const struct scene *s, const struct footprint *f,
                               struct report_ground *out, struct err *e) ERR_USE;
void report_ground_free(struct report_ground *g);

/* Appends a picture as <img> with the PNG or JPEG in the text itself. ERR_MEM, ERR_INTERNAL. */
enum err_code report_map_image(const struct image *img, const char *format, const char *style,
                               struct buf *out, struct err *e) ERR_USE;
/* Append maps, north up, with legend and scale. report_map_coverage: coverage, with the cameras.
 * report_map_gsd: ground sampling distance. report_map_residuals: positions against GPS, as arrows
 * drawn longer than they are. ERR_MEM, ERR_INTERNAL. */
enum err_code report_map_coverage(const struct scene *s, const struct report_ground *g,
                                  struct buf *out, struct err *e) ERR_USE;
enum err_code report_map_gsd(const struct scene *s, const struct report_ground *g, struct buf *out,
                             struct err *e) ERR_USE;
enum err_code report_map_residuals(const struct scene *s, const struct report_ground *g,
                                   struct buf *out, struct err *e) ERR_USE;
/* Draws heights [h][w] (m) as colours with shading. NAN, and heights below `none`, are white.
 * range_m gets the 2 % and 98 % quantiles of the heights. ERR_MEM, ERR_ARG. */
enum err_code report_map_relief(const float *height_m, uint32_t w, uint32_t h, double pixel_m,
                                float none, struct image *out, double range_m[2],
                                struct err *e) ERR_USE;
/* Appends a legend of the colours of heights. */
void report_map_relief_legend(double low_m, double high_m, struct buf *out);

#endif
