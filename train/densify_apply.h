/* Inside of train/: density control of the level in work.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DENSIFY_APPLY_H
#define TRAIN_DENSIFY_APPLY_H

#include <stdint.h>

#include "core/err.h"

struct context;
struct importance;
struct model;

/* The x-th densification of the level in work, from 1: remove, clone and split under its budget.
 * *importance (NULL at first; importance_free) is made when candidates have to be ranked. ERR_DATA:
 * no Gaussian would be left; ERR_LIMIT: more than a cell can hold; ERR_MEM, ERR_DEVICE. */
enum err_code densify_apply(struct model *m, struct context *ctx, struct importance **importance,
                            uint32_t x, struct err *e) ERR_USE;

#endif
