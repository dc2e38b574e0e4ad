/* What training a cell takes, as a function of Gaussians, pictures and options. The formula is
 * stated in docs/cells.md and held by stability_cells: whoever adds a buffer adds it here.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_MEMORY_H
#define TRAIN_MEMORY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct scene;
struct schedule;
struct train_config;

/* Device and host together: on a CPU device they are the same memory. */
struct memory_need {
    size_t per_gaussian; /* bytes, the sum of the next three */
    size_t trained;      /* parameters, two Adam moments, statistics, gradients of regularizers */
    size_t drawn;        /* a frame's records and keys, lists of intersections and their slots */
    size_t passing;      /* the most that density control, scores or pruning need for a moment */
    size_t per_pixel;    /* of the finest level's picture: pictures, loss, scores, evaluation */
    size_t photo_bytes;  /* decoded photographs kept, and those being decoded */
    size_t group_bytes;  /* with appearance: groups of neighbours whose embeddings are compared */
    size_t gaussians;    /* most of them: inside the cell and out */
    size_t pixels;       /* of the largest picture */
    size_t total;        /* without the program itself and its OpenCL compiler */
};
/* budgets: levels[0 .. n_levels - 1].budget, and .around. `whole`: the cell has no outside. */
struct memory_need memory_estimate(const struct train_config *cfg, const struct scene *s,
                                   const uint32_t *images, size_t n_images,
                                   const struct schedule *levels, uint32_t n_levels, bool whole);

#endif
