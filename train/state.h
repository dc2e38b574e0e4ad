/* Inside of train/: a level in training, saved and restored.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STATE_H
#define TRAIN_STATE_H

#include <stdbool.h>

#include "core/err.h"

struct evaluate_score;

struct level; /* train/level.h */

/* Everything needed to go on, and where the run stands. */
enum err_code state_save(struct level *l, const char *path, struct err *e) ERR_USE;
/* Into a level whose fixed part is set and which was not opened. ERR_ARG names the first option
 * that differs from the saved run's; level_close it, also after an error. */
enum err_code state_load(struct level *l, const char *path, struct err *e) ERR_USE;
/* The result of the level in work; `score` may be NULL. */
enum err_code state_save_level(struct level *l, const char *path,
                               const struct evaluate_score *score, struct err *e) ERR_USE;

/* Is this file the result of the level, last of l, by a run with l's options, cell and photographs?
 */
enum err_code state_is_result_of(const struct level *l, const char *path, bool *yes,
                                 struct err *e) ERR_USE;
#endif
