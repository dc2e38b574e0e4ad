/* Internal to train/: the background colour of a training step.
 *
 * A surface of the background's colour can stay transparent, because photographs show no
 * difference. In front of a sky it then has holes. A background of another colour at every step
 * prevents that. In two places a changing colour does harm, and there the background keeps its
 * colour. Where photographs do not fix a distance (the sky, or ground that only one photograph
 * sees), a changing colour makes fog. Under bright surfaces it makes a second layer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_BACKGROUND_H
#define TRAIN_BACKGROUND_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct footprint;
struct photo;
struct render_options;
struct stage;
struct train_config;

struct background {     /* {0} is ready; free with background_free */
    uint8_t *where;     /* [h][w] of the last photograph; 0: the background keeps its colour */
    uint8_t *supported; /* [h][w] of the last photograph; not 0: supported ground */
    size_t cap;
};
/* Finds the pixels of a photograph that show ground which photographs support. *out: [h][w],
 * borrowed from b until the next call; NULL where ground is NULL or empty. ERR_MEM. */
enum err_code background_support(struct background *b, const struct footprint *ground,
                                 const struct photo *p, const uint8_t **out, struct err *e) ERR_USE;
/* Sets the background in `ro` for the current step and its photograph, by cfg->background_random.
 * supported: of background_support; NULL: no ground is supported. ro borrows from b until the next
 * call. The colour is a function of seed, level and step. */
void background_choose(struct background *b, const struct train_config *cfg,
                       const uint8_t *supported, const struct stage *at, const struct photo *p,
                       struct render_options *ro);
void background_free(struct background *b);

#endif
