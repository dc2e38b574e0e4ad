/* Inside of train/: one cell, from its first step to done.json.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RUN_H
#define TRAIN_RUN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "cells/cell.h"
#include "core/err.h"

struct appearance;
struct dev;
struct err;
struct photometric;
struct render;
struct scene;
struct train_cell_result;
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
    uint64_t *steps;                 /* of this process, counted on */
    bool reuse; /* a finished run with these options is taken as it is, with --overwrite as well */
};
/* Locks the cell's folder, trains what is missing in it and writes done.json last. ERR_BUSY:
 * another process is at it; ERR_ARG: it holds a finished run with other options, or options do not
 * fit; ERR_CANCEL: stopped, and the state was saved; ERR_DATA, ERR_LIMIT: it cannot be trained;
 * ERR_NOENT, ERR_IO, ERR_FORMAT: files; ERR_MEM, ERR_DEVICE. */
enum err_code run_cell(const struct run_cell *job, struct train_cell_result *out,
                       struct err *e) ERR_USE;
#endif
