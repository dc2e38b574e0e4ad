/* What each kernel of a frame and of a training step has to do at least, and how long a device
 * takes for that: bytes over its memory bandwidth or multiply-adds over its rate of them, whichever
 * is longer. Results: lab/studies/roofline.md (two cores), lab/studies/gpu.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_ROOFLINE_H
#define LAB_ROOFLINE_H

#include <stdbool.h>
#include <stddef.h>

/* Bytes of one moment of Adam: there are two for each parameter. */
#define ROOFLINE_MOMENT_BYTES 2.0

/* The work of one step, or the mean of several. Harmonics are of degree 3. */
struct roofline_work {
    bool gpu;       /* shape of the kernels: VW 1 */
    double n;       /* Gaussians of the frame; in the frustum those of the groups listed */
    double all;     /* Gaussians of the model */
    double owed;    /* of n, those that other steps are owed to (render/defer.h) */
    double visible; /* V */
    double grouped; /* Gaussians in groups of 16 of which at least one is visible */
    double lists;   /* I: intersections of a splat and a tile, entries of the tiles' lists */
    double entries; /* of these, those that blending came to; VW 16 alone, as the next two */
    double drawn;   /* of these, those that drew into at least one block of 4 x 4 pixels */
    double blocks;  /* these blocks */
    double pixels;  /* P */
    double tiles;   /* T */
};

struct roofline_need {
    double bytes;         /* that must cross the memory bus once */
    double multiply_adds; /* see roofline.c */
    bool frame;           /* of a frame, not of a step alone */
    bool alone;           /* one work-item: other cores have nothing to do */
};
/* False: no formula for this kernel in this shape. */
bool roofline_need(const char *kernel, const struct roofline_work *w, struct roofline_need *out);
/* Kernels with a formula, in the order of a step; NULL after the last. */
const char *roofline_name(size_t i);

struct roofline_limit {
    double ms;
    bool memory; /* else arithmetic */
};
struct roofline_limit roofline_limit(const struct roofline_need *need, double fma_gflops,
                                     double triad_gbps);

#endif
