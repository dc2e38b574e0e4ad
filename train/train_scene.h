/* Internal to train/: a scene and the cells of it to train.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TRAIN_SCENE_H
#define TRAIN_TRAIN_SCENE_H

#include <stdbool.h>
#include <stddef.h>

#include "codec/scene/scene.h"
#include "scene/cells/partition.h"
#include "train/run.h"

struct train_config;

struct train_scene { /* call train_scene_close, also after an error */
    const struct train_config *cfg;
    const char *dir; /* borrowed */
    struct scene scene;
    struct partition plan; /* n_cells 0: there is none, and the scene is one cell */
    size_t *cells;         /* indices into plan.cells of the cells to train; {0} without a plan */
    size_t n_cells;
    size_t n_planned; /* cells of the plan that are trained, with or without --cell */
};
/* Reads the scene in `dir` and the file `plan` of its cells (NULL: the scene's plan.json, if there
 * is one), and selects the cells that cfg names.
 * ERR_NOENT: no scene, or --cell without a plan. ERR_ARG: no such cell. ERR_DATA: no cell can be
 * trained. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code train_scene_open(const char *dir, const char *plan, const struct train_config *cfg,
                               struct train_scene *out, struct err *e) ERR_USE;
void train_scene_close(struct train_scene *s);
/* Fills cell, images and test_images of `job`; they live in the scene's arena. `index` is one of
 * s->cells. ERR_DATA: there are no photographs to train on. ERR_MEM. */
enum err_code train_scene_cell(struct train_scene *s, size_t index, struct run_cell *job,
                               struct err *e) ERR_USE;
/* Fills images and test_images of `job` with all of the scene, for a model of the whole; they live
 * in the scene's arena. ERR_DATA: there are no photographs to train on. ERR_MEM. */
enum err_code train_scene_whole(struct train_scene *s, struct run_cell *job, struct err *e) ERR_USE;
/* Lists the photographs to train on, or with SCENE_TEST to score, in the scene's arena. Without
 * test_split all of them train. ERR_MEM. */
enum err_code train_scene_images(struct scene *s, enum scene_split split, bool test_split,
                                 uint32_t **out, size_t *n, struct err *e) ERR_USE;

#endif
