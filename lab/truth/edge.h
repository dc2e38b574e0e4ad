/* The accuracy of edges in a surface model. Steps of the truth, walls from street to roof, are
 * compared with those of the model along lines of pixels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_EDGE_H
#define LAB_EDGE_H

#include <stddef.h>

#include "core/err.h"

enum { EDGE_FINE = 8 };  /* samples of the truth in a pixel */
#define EDGE_LEAST_M 3.0 /* smallest step */

struct edge_list {     /* {0} is empty; edge_free */
    double *offset_px; /* [n] across the wall; positive: the model's roof is too large */
    size_t n, cap;
    size_t missing; /* steps for which the model has none within EDGE_REACH_PX */
};
#define EDGE_REACH_PX 6
/* Adds the steps of one line. height [w]: the model at the middles of pixels, NAN: none. truth,
 * next [w][EDGE_FINE]: the truth along this line and the next one, with sample k at (k + 0.5) /
 * EDGE_FINE pixels. Walls that deviate by more than 60 degrees from perpendicular to the line are
 * skipped; lines in the other direction find them. ERR_MEM. */
enum err_code edge_line(struct edge_list *l, const float *height, const float *truth,
                        const float *next, size_t w, double pixel_m, struct err *e) ERR_USE;
void edge_free(struct edge_list *l);

struct edge_score {
    double median_px, most_px; /* of the distances: median and 95 % */
    double within_2_px;        /* share of the steps; missing ones count as farther */
    double out_px;             /* median with sign */
};
/* Computes the score, and sorts the list. Without steps all is NAN. ERR_MEM. */
enum err_code edge_tell(struct edge_list *l, struct edge_score *out, struct err *e) ERR_USE;

#endif
