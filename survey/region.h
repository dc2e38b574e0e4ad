/* Finds connected regions of pixels row by row, with sums over each, in two passes of the same
 * rows. The first pass finds which labels are one region, the second gives the region of each
 * pixel. Memory holds two rows and the regions.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_REGION_H
#define SURVEY_REGION_H

#include <stdint.h>

#include "core/err.h"

enum { REGION_MAX = 1 << 24 }; /* labels */
enum {                         /* of a pixel: 0 outside, else these, negative for a loss */
       REGION_PIXEL = 1,
       REGION_SEED = 2, /* besides */
       REGION_FIRM = 4
};

struct region { /* 4-connected pixels of one sign */
    /* a lower label of the same region; its own label: the sums here are the region's */
    uint32_t of;
    uint32_t pixels, seeds, firm;
    double sum, variance; /* sum of the values; variance of their noise */
    double edge;          /* sum of the parts that edges add to their standard deviations */
    double most;          /* the value farthest from 0 */
};
struct region_map { /* {0}, region_begin; region_free */
    uint32_t width;
    int8_t *sign;        /* [width] of the row before */
    uint32_t *label;     /* [width] of the row before; 0: none */
    struct region *list; /* [n], 1 on; 0 is not used */
    uint32_t n, cap;
};
/* Begins the first pass over rows of `width` pixels; called again, begins the second pass. ERR_MEM.
 */
enum err_code region_begin(struct region_map *m, uint32_t width, struct err *e) ERR_USE;
/* One row of the first pass. kind: 0 outside; else REGION_PIXEL, with the flags that the pixel has
 * besides, times the sign of the value. sigma: standard deviation of a value. edge: the part of it
 * that edges add, as the root of a difference of squares. ERR_LIMIT: more than REGION_MAX labels;
 * ERR_MEM. */
enum err_code region_add(struct region_map *m, const int8_t *kind, const float *value,
                         const float *sigma, const float *edge, struct err *e) ERR_USE;
/* One row of the second pass, of the same kinds: the region of each pixel, as an index into list.
 * 0: none. Valid until the next call. */
const uint32_t *region_tell(struct region_map *m, const int8_t *kind);
void region_free(struct region_map *m);

#endif
