/* Inside of train/: levels of detail that were trained with an earlier state of the appearance
 * network take over the one that the finest level ended with, because tiles of all levels are read
 * by one network. What the Gaussians of such a level learn anew are colours and embeddings; where
 * and how large they are stays.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REFIT_H
#define TRAIN_REFIT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/err.h"
#include "train/schedule.h"

struct level;

/* Does this run need it? */
bool refit_wanted(const struct level *l);
struct refit { /* {0} before refit_open; refit_end */
    bool needed;
    struct schedule was; /* of the level */
    bool was_shared;
};
/* After all levels: take up level `at` (from 0) from its checkpoint, ready for level_step. *r says
 * whether that is needed: false when it has the network already, and then nothing is open. ERR_MEM,
 * ERR_DEVICE; ERR_NOENT, ERR_FORMAT, ERR_DATA, ERR_IO: the checkpoint. */
enum err_code refit_open(struct refit *r, struct level *l, uint32_t at, const char *path,
                         struct err *e) ERR_USE;
/* The level's context as it was after its training, so that state_save_level writes it so. */
void refit_end(struct refit *r, struct level *l);

#endif
