/* Internal to train/: where a run stands. Only level.c advances it; other modules read it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STAGE_H
#define TRAIN_STAGE_H

#include "train/base/schedule.h"

struct stage {
    struct schedule levels[TRAIN_LEVELS_MAX];
    uint32_t n_levels;
    bool again;    /* --level-order both: levels are made of the finest once it is done */
    bool turned;   /* and it is done */
    uint32_t at;   /* levels[at] is the current level; n_levels: all are done */
    uint32_t step; /* of this level: the step in work, or the last one done; 0 at first */
    bool pruned;   /* level_prune, the end of the level, is done */
    size_t start;  /* Gaussians inside the cell when this level began */
};
/* The level that follows `at`; n_levels: none does. */
static inline uint32_t stage_after(const struct stage *s, uint32_t at)
{
    if (s->turned || (s->again && at + 1 == s->n_levels))
        return at > 0 ? at - 1 : s->n_levels;
    return at + 1;
}
/* With --level-order both: from here on the coarser levels are made of the finer ones. */
static inline void stage_turn(struct stage *s, const struct train_config *cfg)
{
    s->turned = true;
    for (uint32_t l = 0; l + 1 < s->n_levels; l++)
        s->levels[l] = schedule_again(&s->levels[l], &s->levels[l + 1], cfg);
}
/* Whether a level is pruned at its end. A level that is made of a finer one is not: its Gaussians
 * are what thinning left. Nor is a level that will be made again: it is only the start of the next
 * one. */
static inline bool stage_prunes(const struct stage *at, const struct schedule *s)
{
    return !s->derived && (!at->again || s->level == s->n_levels);
}
/* Schedule of the current level, or of the finest one when all are done. */
static inline const struct schedule *stage_schedule(const struct stage *s)
{
    return &s->levels[s->at < s->n_levels ? s->at : s->n_levels - 1];
}

#endif
