/* Inside of train/: one coarse run over the whole scene, before the cells of a plan.
 *
 * It gives cells two things that each of them would else find for itself, and differently:
 *
 * - The appearance network and its photographs. A colour can be explained by the Gaussian or by
 *   the photograph, and each cell would choose (docs/decisions/005-shared-appearance.md).
 * - The Gaussians to begin from, with --coarse-start, and with them all that a cell's photographs
 *   show around it (docs/decisions/053-coarse-start.md).
 *
 * Its result is cells/coarse/level1.ckpt, which is also its done-file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_COARSE_H
#define TRAIN_COARSE_H

#include "core/appearance.h"
#include "core/gauss.h"
#include "train/run.h"

struct ckpt;
struct err;
struct train_config;

struct coarse {                   /* {0} is empty */
    struct appearance appearance; /* empty: none */
    struct gauss gauss;           /* empty: cells begin from sparse points */
};

/* Do these options ask for one, given the number of cells that are trained? */
bool coarse_wanted(const struct train_config *cfg, size_t n_cells);
/* Read it, or train it first where it is missing or was made with other options. job: as for
 * run_cell, with all training and test photographs of the scene; its cfg is that of the cells.
 * may_train false: ERR_NOENT says how to make it. coarse_free out. */
enum err_code coarse_get(const struct run_cell *job, bool may_train, struct coarse *out,
                         struct err *e) ERR_USE;
void coarse_free(struct coarse *s); /* idempotent, leaves {0} */
/* The appearance model of a checkpoint; *out is empty and the answer ERR_OK where it has none. */
enum err_code coarse_read_appearance(const struct ckpt *c, const char *path, struct appearance *out,
                                     struct err *e) ERR_USE;

#endif
