/* Inside of train/: a scene and which of its cells are to be trained.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TRAIN_SCENE_H
#define TRAIN_TRAIN_SCENE_H

#include <stddef.h>

#include "cells/partition.h"
#include "codec/scene.h"
#include "train/run.h"

struct train_config;

struct train_scene { /* train_scene_close it, also after an error */
    const struct train_config *cfg;
    const char *dir; /* borrowed */
    struct scene scene;
    struct partition plan; /* n_cells 0: none, the scene is one cell */
    size_t *cells;         /* indices into plan.cells of those to train; {0} without a plan */
    size_t n_cells;
};
enum err_code train_scene_open(const char *dir, const struct train_config *cfg,
                               struct train_scene *out, struct err *e) ERR_USE;
void train_scene_close(struct train_scene *s);
/* Fill cell, images and test_images of `job`; they live in the scene's arena. `index` is one of
 * s->cells. */
enum err_code train_scene_cell(struct train_scene *s, size_t index, struct run_cell *job,
                               struct err *e) ERR_USE;
#endif
