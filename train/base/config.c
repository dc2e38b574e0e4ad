/* The options of a training run: the table behind struct train_config.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/base/config.h"

static const struct options_def train_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct train_config, __VA_ARGS__)
#include "train/base/options.def"
};

static const struct options_spec train_spec = {
    .command = "train",
    .usage = "citysplat train SCENE [options]",
    .about = "Trains Gaussians at several levels of detail from a scene that `citysplat ingest` "
             "made. Results and measurements go to SCENE/cells/<id>/, one folder for each cell "
             "of `citysplat plan`, or to cells/all/ without a plan. Ctrl-C saves the state, and "
             "--resume continues from it. configs/ holds presets with their reasons.",
    .example = "citysplat train scene --iterations 2000 --max-edge-px 400   # a few minutes\n"
               "citysplat train scene --config configs/demo-train.jsonc\n"
               "citysplat train scene                                       # 7,000 steps\n"
               "citysplat train scene --iterations 15000,15000,30000        # as published",
    .defs = train_defs,
    .n_defs = sizeof train_defs / sizeof train_defs[0],
    .min_args = 1,
    .max_args = 1,
};

const struct options_spec *train_options(void)
{
    return &train_spec;
}

uint64_t train_stream(enum train_stream_id id, uint32_t level, uint64_t step)
{
    return ((uint64_t)id << 56) | ((uint64_t)level << 48) | step;
}
