/* Inside of train/: one appearance model for all cells of a plan.
 *
 * Cells that learn networks of their own disagree at their borders: a colour can be explained by
 * the Gaussian or by the photograph, and each cell would choose. So one coarse run over the whole
 * scene learns network and photographs first (cells/appearance/level1.ckpt, which is also its
 * done-file), and cells learn embeddings of their Gaussians only. Decision and figures:
 * docs/decisions/005-shared-appearance.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SHARED_H
#define TRAIN_SHARED_H

#include "train/run.h"

struct appearance;
struct ckpt;
struct err;
struct train_config;

#define SHARED_ID "appearance" /* folder below cells/ */

/* Do these options ask for one, given the number of cells that are trained? */
bool shared_wanted(const struct train_config *cfg, size_t n_cells);
/* Read it, or train it first where it is missing or was made with other options. job: as for
 * run_cell, with all training and test photographs of the scene; its cfg is that of the cells.
 * may_train false: ERR_NOENT says how to make it. appearance_free out. */
enum err_code shared_get(const struct run_cell *job, bool may_train, struct appearance *out,
                         struct err *e) ERR_USE;
/* The appearance model of a checkpoint; *out is empty and the answer ERR_OK where it has none. */
enum err_code shared_read_model(const struct ckpt *c, const char *path, struct appearance *out,
                                struct err *e) ERR_USE;

#endif
