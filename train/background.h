/* Inside of train/: what is behind the Gaussians in a step of training.
 *
 * A surface that is as dark as what is behind it may stay transparent: the photographs cannot tell,
 * and whoever looks at the city before a sky sees holes. Behind another colour every step it may
 * not. But where photographs look at what nothing can tell the place of (a ground that one of them
 * sees, the sky), the same colour asks for something opaque at any distance at all, which is the
 * fog around a city; and bright surfaces, which cannot hide, grow a second layer below the first.
 * There the background stays as it is.
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

struct background { /* {0} is ready; background_free */
    uint8_t *where; /* [h][w] of the last photograph, 0: the background stays */
    size_t cap;
};
/* Set ro's background for the step in work and its photograph, as cfg->background_random says.
 * ground may be NULL: then no ground is known to be supported. ro borrows from b until the next
 * call. The colour is a function of seed, level and step. ERR_MEM. */
enum err_code background_choose(struct background *b, const struct train_config *cfg,
                                const struct footprint *ground, const struct stage *at,
                                const struct photo *p, struct render_options *ro,
                                struct err *e) ERR_USE;
void background_free(struct background *b);

#endif
