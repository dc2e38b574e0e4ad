/* Internal to train/: density control of the current level.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DENSIFY_APPLY_H
#define TRAIN_DENSIFY_APPLY_H

#include <stdint.h>

#include "core/err.h"

struct gallery;
struct importance;
struct metrics_log;
struct model;
struct site;
struct stage;
struct timing;

struct densify_run { /* all borrowed */
    struct gallery *gallery;
    const struct site *site;
    const struct stage *at;
    struct importance **importance; /* NULL at first; made when candidates are ranked */
    struct metrics_log *metrics;    /* NULL: none are written */
    struct timing *timing;          /* counts for importance while that is computed */
};
/* Does densification x of the current level, from 1: it removes, clones and splits under the
 * budget. ERR_DATA: no Gaussian would be left. ERR_LIMIT: more than a cell can hold. ERR_MEM,
 * ERR_DEVICE. */
enum err_code densify_apply(struct model *m, const struct densify_run *r, uint32_t x,
                            struct err *e) ERR_USE;

#endif
