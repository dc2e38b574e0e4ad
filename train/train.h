/* Training: photographs in, Gaussians at three levels of detail out.
 *
 * Reading order: begin.c prepares a cell, and run.c goes through its levels. level.c is the loop
 * over steps; it gives every part what that part uses. stage.h has the position of the run, and
 * fixed.h the data that never change. gallery.c has the photographs, model.c the Gaussians on the
 * device. terms.def lists what is minimised; term_*.c compute it. schedule.c says what happens at
 * which step. init.c, densify_plan.c, importance.c and prune.c decide which Gaussians there are.
 * state.c saves and restores; train.c goes through the cells; evaluate.c scores the result. Losses
 * and metrics are in train/loss/.
 *
 * Levels are trained one after another, level 1 the coarsest. Each continues with the Gaussians of
 * the level before, and has its own budget, densification interval and picture size. Sources:
 * Taming 3DGS, Mallick 2024, for budgets; 3D Gaussian Splatting, Kerbl 2023, for the rest. Files of
 * a cell:
 *
 *     cells/<id>/level<k>.ckpt   the result of level k: Gaussians, no optimiser state
 *     cells/<id>/resume.ckpt     the whole state, while the cell is unfinished
 *     cells/<id>/done.json       written last
 *     cells/<id>/metrics.jsonl, config.jsonc
 *
 * Without a plan.json (scene/cells/partition.h) the scene is one cell, "all".
 *
 * Determinism: the same seed, scene, options, device and build give the same bytes, and a resumed
 * run equals an uninterrupted one. Every random number is rng_*(seed, stream, index);
 * train/base/config.h lists the streams.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TRAIN_H
#define TRAIN_TRAIN_H

#include "train/base/config.h"
#include "train/base/result.h"

void train_result_free(struct train_result *r);
/* Returns whether several cells with these options need a shared coarse model first
 * (train/coarse.h). cfg->coarse_only makes train_run train only that. */
bool train_needs_coarse(const struct train_config *cfg);
/* Trains the scene in `scene_dir`: the cells of its plan.json, or the cell cfg->cell, or all of it
 * as one cell. Call train_result_free afterwards, also after an error. ERR_CANCEL: stopped by a
 * signal or stop_after; the state was saved, and the message says how to continue. ERR_BUSY:
 * another process trains the cell. ERR_ARG: options do not match the scene or the saved state.
 * ERR_DATA: there is nothing to train on. ERR_NOENT, ERR_IO, ERR_FORMAT: of files. ERR_MEM,
 * ERR_DEVICE. */
enum err_code train_run(const char *scene_dir, const struct train_config *cfg,
                        struct train_result *out, struct err *e) ERR_USE;

#endif
