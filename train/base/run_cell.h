/* Internal to train/: the input of one cell's run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RUN_CELL_H
#define TRAIN_RUN_CELL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "scene/cells/cell.h"

struct appearance;
struct dev;
struct gauss;
struct photometric;
struct render;
struct scene;
struct train_config;

struct run_cell { /* one cell to train; all borrowed */
    const struct train_config *cfg;
    const char *base_dir; /* folder of cells/ */
    const struct scene *scene;
    const uint32_t *images;
    uint32_t *test_images;
    size_t n_images, n_test;
    struct cell cell;
    struct dev *dev;
    struct render *render;
    struct photometric *loss;
    /* appearance model of all cells; NULL: the cell learns its own */
    const struct appearance *shared;
    const struct gauss *coarse; /* coarse model to begin from; NULL: sparse points */
    uint64_t *steps;            /* counts the steps of this process */
    bool reuse; /* accept a finished run with these options, even with --overwrite */
};

#endif
