/* The options of a training run, and the streams of its random numbers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_CONFIG_H
#define TRAIN_CONFIG_H

#include <stdint.h>

#include "core/options/options.h"

enum { TRAIN_LEVELS_MAX = 3, TRAIN_TURNS_MAX = 2 * TRAIN_LEVELS_MAX - 1 };
/* Folder in cells/ of the coarse model that all cells begin from. It is no cell of the plan. */
#define TRAIN_COARSE_ID "coarse"

struct train_config {
#define OPT OPTIONS_MEMBER
#include "train/base/options.def"
};
/* The table of struct train_config: flags, defaults, ranges, help. */
const struct options_spec *train_options(void);

/* Streams of random numbers. train_stream combines them with level and step. */
enum train_stream_id {
    TRAIN_STREAM_SHUFFLE = 1,
    TRAIN_STREAM_INIT,
    TRAIN_STREAM_RACE,
    TRAIN_STREAM_VIEWS = 5, /* 4 was used by a split that was removed */
    TRAIN_STREAM_SIMILARITY,
    TRAIN_STREAM_EMBED,
    TRAIN_STREAM_BACKGROUND,
    TRAIN_STREAM_GROUND
};
uint64_t train_stream(enum train_stream_id id, uint32_t level, uint64_t step);
#endif
