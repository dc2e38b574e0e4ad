/* Photographs in, Gaussians at three levels of detail out.
 *
 * Reading order: run.c goes through the levels of a cell; begin.c is what comes before. level.c is
 * the loop, one step is a dozen lines: it hands every part what that part uses. stage.h says where
 * the run stands, fixed.h what never changes, gallery.c has the photographs, model.c the Gaussians
 * on the device. schedule.c says what happens at which step. init.c, densify_plan.c, importance.c
 * and prune.c decide which Gaussians there are. state.c saves and restores; train.c goes through
 * the cells; evaluate.c scores the result. Losses and metrics are in loss/.
 *
 * One trajectory through the levels, level 1 the coarsest: each continues from the Gaussians of the
 * one before with its own budget, densification interval and picture size (Taming 3DGS, Mallick
 * 2024, for the budgets; 3D Gaussian Splatting, Kerbl 2023, for the rest). Files of a cell:
 *   cells/<id>/level<k>.ckpt   the result of level k: Gaussians, no optimiser state
 *   cells/<id>/resume.ckpt     everything, while the cell is unfinished
 *   cells/<id>/done.json       written last
 *   cells/<id>/metrics.jsonl, config.jsonc
 * Without a plan.json (cells/partition.h) the scene is one cell, "all".
 *
 * Determinism: same seed, scene, options, device and build give the same bytes; a resumed run
 * equals the uninterrupted one. Every random number is rng_*(seed, stream, index); streams are
 * listed in train/config.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TRAIN_H
#define TRAIN_TRAIN_H

#include "train/config.h"
#include "train/result.h"

void train_result_free(struct train_result *r);
/* Do several cells with these options wait for a coarse model that they share (train/coarse.h)?
 * cfg->coarse_only makes train_run train that and nothing else. */
bool train_needs_coarse(const struct train_config *cfg);
/* Train the scene in `scene_dir`: the cells of its plan.json, or the one that cfg->cell names, or
 * all of it as one cell. train_result_free `out`, also after an error. ERR_CANCEL: stopped (signal
 * or stop_after), the state was saved and the message says how to go on; ERR_BUSY: another process
 * trains the cell; ERR_ARG: options that do not fit the scene or the state to resume from;
 * ERR_DATA: nothing to train on; ERR_NOENT, ERR_IO, ERR_FORMAT: files; ERR_MEM, ERR_DEVICE. */
enum err_code train_run(const char *scene_dir, const struct train_config *cfg,
                        struct train_result *out, struct err *e) ERR_USE;

#endif
