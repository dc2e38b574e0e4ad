/* Where a surface model has its edges: steps of the truth, a wall from street to roof, against
 * those of the model, along one line of pixels after the other.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_EDGE_H
#define SURVEY_EDGE_H

#include <stddef.h>

#include "core/err.h"

enum { EDGE_FINE = 8 };  /* samples of the truth a pixel */
#define EDGE_LEAST_M 3.0 /* of a step */

struct edge_list {     /* {0} is empty; edge_free */
    double *offset_px; /* [n] across the wall, positive: the model's roof reaches out */
    size_t n, cap;
    size_t missing; /* steps of which the model has none within EDGE_REACH_PX */
};
#define EDGE_REACH_PX 6
/* Add the steps of one line. height [w]: the model at the middles of pixels, NAN: none; truth, next
 * [w][EDGE_FINE]: the truth along the same line and along the one a pixel further, sample k at
 * (k + 0.5) / EDGE_FINE pixels. Walls that lie more than 60 degrees aslant to the line are passed
 * over: the lines across find them. ERR_MEM. */
enum err_code edge_line(struct edge_list *l, const float *height, const float *truth,
                        const float *next, size_t w, double pixel_m, struct err *e) ERR_USE;
void edge_free(struct edge_list *l);

struct edge_score {
    double median_px, most_px; /* of the distances; 95 % */
    double within_2_px;        /* share of the steps, missing ones counted as farther */
    double out_px;             /* median with its sign */
};
/* Sorts the list. All NAN when there is no step. ERR_MEM. */
enum err_code edge_tell(struct edge_list *l, struct edge_score *out, struct err *e) ERR_USE;

#endif
