/* Internal to train/: what is constant in the run of one cell. run.c fills it before the first
 * step, and no code changes it later.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_FIXED_H
#define TRAIN_FIXED_H

#include "scene/cells/cell.h"

struct dev;
struct footprint;
struct inputs;
struct photometric;
struct render;
struct trim;

struct engine { /* device, renderer and loss; borrowed */
    struct dev *dev;
    struct render *render;
    struct photometric *loss;
};
struct site { /* the cell and its ground */
    struct cell cell;
    const struct footprint *ground; /* borrowed; NULL: not known */
    const struct trim *rim;         /* where the photographs end; borrowed; NULL: not known */
    const struct inputs *inputs;    /* hashes of the run's inputs; borrowed; NULL: not known */
};

#endif
