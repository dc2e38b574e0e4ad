/* Inside of train/: density control of the level in work.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DENSITY_H
#define TRAIN_DENSITY_H

#include "train/level.h"

/* The x-th densification of the level, from 1: remove, clone and split under its budget. */
enum err_code density_run(struct level *l, uint32_t x, struct err *e) ERR_USE;
/* Lower every opacity to the reset value and forget its moments. */
enum err_code density_reset_opacity(struct level *l, struct err *e) ERR_USE;

#endif
