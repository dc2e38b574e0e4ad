/* Internal to train/: a coarse run over the whole scene, before the cells of a plan.
 *
 * It gives all cells the same start in two respects:
 *
 * - The appearance network and its photographs. A colour can be explained by the Gaussian or by the
 *   photograph, and each cell would choose differently (docs/decisions/017-appearance.md).
 * - With --coarse-start, the first Gaussians, also those around the cell that its photographs show
 *   (docs/decisions/008-cells.md).
 *
 * The result is cells/coarse/level1.ckpt. The coarse model is complete when this file exists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_COARSE_H
#define TRAIN_COARSE_H

#include "core/splat/appearance.h"
#include "core/splat/gauss.h"
#include "train/run.h"

struct ckpt;
struct err;
struct train_config;

struct coarse {                   /* {0} is empty */
    struct appearance appearance; /* empty: none */
    struct gauss gauss;           /* empty: cells begin with sparse points */
};

/* Returns whether these options need a coarse run, if n_cells are trained. */
bool coarse_wanted(const struct train_config *cfg, size_t n_cells);
/* Fills the coarse model's run: *cfg with its options, and *out, which borrows cfg. `job` has the
 * options of the cells and all photographs. resume_path: of the run's saved state. */
void coarse_job(const struct run_cell *job, const char *resume_path, struct train_config *cfg,
                struct run_cell *out);
/* Reads the coarse model. If it is missing, or was made with other options, it is trained first.
 * job: as for run_cell, with all training and test photographs of the scene; its cfg is that of the
 * cells. Free *out with coarse_free. ERR_NOENT: it is missing and may_train is false; the message
 * says how to make it. Else the errors of run_cell. */
enum err_code coarse_get(const struct run_cell *job, bool may_train, struct coarse *out,
                         struct err *e) ERR_USE;
void coarse_free(struct coarse *s); /* idempotent, leaves {0} */
/* Reads the appearance model of a checkpoint. If there is none, *out is empty and the result
 * ERR_OK. ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code coarse_read_appearance(const struct ckpt *c, const char *path, struct appearance *out,
                                     struct err *e) ERR_USE;

#endif
