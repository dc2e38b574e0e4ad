/* Inside of train/: levels of detail that were trained with an earlier state of the appearance
 * network take over the one that the finest level ended with, because one network reads the tiles
 * of all levels. The Gaussians of such a level learn their colours and embeddings anew; their
 * places and sizes stay.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_REFIT_H
#define TRAIN_REFIT_H

#include <stdbool.h>

#include "core/err.h"

struct appearance_train;
struct ckpt_rows;
struct model;
struct schedule;
struct stage;
struct train_config;

/* Does this run need it? */
bool refit_wanted(const struct appearance_train *a, const struct train_config *cfg,
                  const struct stage *at);
/* Is the network in a level's checkpoint another one than the network now? ERR_FORMAT, ERR_DATA,
 * ERR_IO: the checkpoint; ERR_MEM. */
enum err_code refit_look(const struct appearance_train *a, const struct ckpt_rows *c, bool *needed,
                         struct err *e) ERR_USE;
/* The schedule in which a level does it: a share of its steps, in which nothing moves, nothing
 * grows and nothing is reset. */
struct schedule refit_schedule(const struct schedule *level, double share);

#endif
