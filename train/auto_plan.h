/* Cuts a scene into cells where its model would not fit in memory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_AUTO_PLAN_H
#define TRAIN_AUTO_PLAN_H

#include "core/err.h"

struct train_config;

/* Writes the scene's plan.json if there is none, the forecast for the whole scene exceeds
 * cfg->memory, and the forecast for every cell of the plan does not. The cells are the largest for
 * which that holds. A scene whose training in one piece has begun or is complete is left alone, and
 * so is one that no plan makes fit: a warning says which, and what to do. ERR_ARG, ERR_DATA,
 * ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_MEM as in train_run. ERR_IO: the plan cannot be written. */
enum err_code auto_plan(const char *scene_dir, const struct train_config *cfg,
                        struct err *e) ERR_USE;

#endif
