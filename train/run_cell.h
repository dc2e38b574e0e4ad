/* Inside of train/: what one cell's run is given.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RUN_CELL_H
#define TRAIN_RUN_CELL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "cells/cell.h"

struct appearance;
struct dev;
struct gauss;
struct photometric;
struct render;
struct scene;
struct train_config;

struct run_cell { /* one cell to train; all borrowed */
    const struct train_config *cfg;
    const char *base_dir; /* cells/ goes there */
    const struct scene *scene;
    const uint32_t *images;
    uint32_t *test_images;
    size_t n_images, n_test;
    struct cell cell;
    struct dev *dev;
    struct render *render;
    struct photometric *loss;
    const struct appearance *shared; /* of all cells; NULL: the cell learns its own */
    const struct gauss *coarse;      /* of the whole scene, to begin from; NULL: sparse points */
    uint64_t *steps;                 /* of this process, counted on */
    bool reuse; /* a finished run with these options is taken as it is, with --overwrite as well */
};

#endif
