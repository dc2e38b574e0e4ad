/* Internal to train/: adapts coarser levels to the final appearance network.
 *
 * One network reads the tiles of all levels, but a coarser level was trained with an earlier state
 * of it. Its Gaussians learn colours and embeddings again with the network of the finest level.
 * Their positions and sizes stay.
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

/* Returns whether this run needs it. */
bool refit_wanted(const struct appearance_train *a, const struct stage *at);
/* Sets *needed: the network in a level's checkpoint differs from the present one. ERR_FORMAT,
 * ERR_DATA, ERR_IO: of the checkpoint. ERR_MEM. */
enum err_code refit_look(const struct appearance_train *a, const struct ckpt_rows *c, bool *needed,
                         struct err *e) ERR_USE;
/* The schedule of a refit: a fifth of the level's steps, without movement or growth. */
struct schedule refit_schedule(const struct schedule *level);
/* The schedule of a last fit with all photographs: a fifth of the level's steps, without growth.
 * Learning rates and weights are those of the level's last step. */
struct schedule refit_schedule_last(const struct schedule *level);

#endif
