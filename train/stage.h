/* Inside of train/: where a run stands. level.c alone moves it on; the others read it. A level's
 * budget changes while the level grows: train/budget.c writes it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STAGE_H
#define TRAIN_STAGE_H

#include "train/schedule.h"

struct stage {
    struct schedule levels[TRAIN_LEVELS_MAX];
    uint32_t n_levels;
    uint32_t at;   /* levels[at] is in work; n_levels: all are done */
    uint32_t step; /* of this level: the one in work, or the last one that is done; 0 at first */
    bool pruned;   /* the level's last act, level_prune, is done */
    size_t start;  /* Gaussians inside the cell when this level began */
};
/* Of the level in work; of the last one when all are done. */
static inline const struct schedule *stage_schedule(const struct stage *s)
{
    return &s->levels[s->at < s->n_levels ? s->at : s->n_levels - 1];
}

#endif
