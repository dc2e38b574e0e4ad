/* Finds changes among the differences between two surfaces: regions in which enough pixels differ
 * by more than their uncertainty allows, their volumes with an uncertainty, and their outlines.
 *
 * The standard deviation of a difference combines two parts: that of both surfaces at the pixel,
 * and CHANGED_AROUND times the median of that in the neighbourhood. Near uncertain ground, errors
 * are larger than a pixel's own standard deviation says. Pixels that differ by more than
 * CHANGED_SIGMAS standard deviations are seeds. A region has the pixels of one sign that are
 * connected to seeds and differ by more than the least difference and CHANGED_GROW standard
 * deviations of a level place. The rim of a new house thus belongs to its region although edges are
 * uncertain. A region counts if its volume exceeds CHANGED_SIGMAS standard deviations, and if at
 * least CHANGED_MOST of its pixels differ by more than CHANGED_FIRM of those of a level place:
 * where few photographs look, one pixel in forty is wrong by three standard deviations.
 * docs/decisions/029-changes.md has the reasons.
 *
 * Errors of neighbouring pixels are alike. The size of a patch of such pixels is measured on ground
 * that did not change; a volume's variance is that of its pixels times the pixels of a patch
 * (Rolstad, Haug and Denby 2009, doi:10.3189/002214309788608950). Edges of a region err alike all
 * around it, so their parts of the standard deviations are summed before they are squared.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_CHANGED_H
#define SURVEY_CHANGED_H

#include "survey/geotiff.h"

#define CHANGED_SIGMAS 3.0
#define CHANGED_GROW 2.0
#define CHANGED_AROUND 2.5
#define CHANGED_FIRM 4.0
#define CHANGED_MOST 0.5

struct changed_request {
    const char *path;     /* temporary files are made beside it */
    const char *polygons; /* file of outlines (survey/layer.h); NULL: none */
    const char *about;    /* what was compared, for that file */
    double least_m;       /* a pixel that differs by less has not changed */
    double least_m2;      /* seeds of a region cover at least this ground */
    double sigma_m;       /* size of the usual Gaussian */
};
struct changed_report {
    uint64_t pixels;           /* that changed */
    double gained_m3, lost_m3; /* volumes of these pixels */
    /* half of the interval that holds the true volumes in 95 % of cases */
    double gained_95_m3, lost_95_m3;
    uint32_t regions;
    /* radius of a patch of errors that are alike; NAN: no ground to measure it */
    double correlation_m;
};
struct changed;
/* info: of the map. polygons is checked. ERR_ARG, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code changed_begin(const struct changed_request *r, const struct geotiff_info *info,
                            struct changed **out, struct err *e) ERR_USE;
/* A piece of the map. pair [h][w][2]: difference and its standard deviation, as they are written to
 * the map, GEOTIFF_NODATA outside; noise_m [h][w]: the standard deviation without the part of
 * edges. ERR_IO. */
enum err_code changed_add(struct changed *c, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                          const float *pair, const float *noise_m, struct err *e) ERR_USE;
/* map: all pieces were written to it. pixel_m2: of one, on the ground. ERR_LIMIT: too many pieces
 * differ; ERR_CANCEL, ERR_IO, ERR_MEM. */
enum err_code changed_tell(struct changed *c, struct geotiff *map, double pixel_m2,
                           struct changed_report *out, struct err *e) ERR_USE;
void changed_close(struct changed **c);

#endif
