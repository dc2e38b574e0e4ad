/* Memory for training a cell, as a function of Gaussians, pictures and options. docs/scale.md
 * states the formula, and the test stability_cells checks it. A new buffer in training must be
 * added here.
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

#define MEMORY_PROGRAM_BYTES 0.15e9 /* of the program and its OpenCL compiler */

/* Memory of device and host together: on a CPU device they are the same. */
struct memory_need {
    size_t per_gaussian; /* bytes: sum of the next three */
    size_t trained;      /* parameters, moments of Adam, statistics, gradients of regularizers */
    size_t drawn;        /* records and keys of a frame, lists of intersections and their slots */
    size_t passing;      /* largest temporary need of density control, scores or pruning */
    size_t per_pixel;    /* for the finest level: pictures, loss, scores, evaluation */
    size_t photo_bytes;  /* decoded photographs in the cache, and those being decoded */
    size_t group_bytes;  /* with appearance: groups of neighbours whose embeddings are compared */
    size_t gaussians;    /* largest number of Gaussians, inside the cell and outside */
    size_t pixels;       /* of the largest picture */
    size_t total;        /* all, without the program itself and its OpenCL compiler */
};
/* Estimates the memory. Budgets are levels[0 .. n_levels - 1].budget and .around. `whole`: the cell
 * has no outside. */
struct memory_need memory_estimate(const struct train_config *cfg, const struct scene *s,
                                   const uint32_t *images, size_t n_images,
                                   const struct schedule *levels, uint32_t n_levels, bool whole);

#endif
