/* Inside of train/: density control of the level in work.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DENSIFY_APPLY_H
#define TRAIN_DENSIFY_APPLY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct err;
struct level;

/* The x-th densification of the level, from 1: remove, clone and split under its budget. */
enum err_code densify_apply(struct level *l, uint32_t x, struct err *e) ERR_USE;
/* Lower every opacity to the reset value and forget its moments. */
enum err_code densify_reset_opacity(struct level *l, struct err *e) ERR_USE;

#endif
