/* Internal to train/: a coarser level from the model of the finer one. Pairs are merged
 * (lod/make/simplify.h) until the level's budget is met. Training then fine-tunes what is left.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_COARSEN_H
#define TRAIN_COARSEN_H

#include <stddef.h>

#include "core/err.h"

struct cell;
struct model;

/* Rows that are merged at once, so that memory does not grow with the model. Neighbours in two such
 * parts are not merged. */
enum { COARSEN_ROWS = 32768 };

struct coarsen_rule {
    const struct cell *cell;
    size_t budget; /* most Gaussians inside the cell */
    double share;  /* part of the Gaussians inside that is left, at most: 0 < share <= 1 */
    /* outside the cell so many are left as they came, from the coarse model; `share` holds for the
     * others */
    size_t around;
};
/* How many of these Gaussians inside the cell, and outside, the rule leaves. */
size_t coarsen_inside(const struct coarsen_rule *r, size_t n);
size_t coarsen_outside(const struct coarsen_rule *r, size_t n);
/* Merges the Gaussians of a model that is owed no steps (model_settle). Those inside the cell and
 * those outside are merged apart, so that none crosses its border. Moments and statistics become 0.
 * ERR_MEM, ERR_DEVICE; the model is not usable then. */
enum err_code coarsen_model(struct model *m, const struct coarsen_rule *r, struct err *e) ERR_USE;

#endif
