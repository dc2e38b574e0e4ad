/* Internal to train/: what the terms on the shape of Gaussians share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TERM_SIZE_H
#define TRAIN_TERM_SIZE_H

#include <stdbool.h>
#include <stdint.h>

#include "train/loss/ground_parts.h"

struct gallery;
struct schedule;
struct site;
struct stage;

/* Whether they act at this step. */
bool term_size_begun(const struct gallery *g, const struct stage *at);
/* The cell's ground with these parts (borrowed). False: it is not known. */
bool term_size_ground(const struct gallery *g, const struct site *site, const struct schedule *s,
                      const uint8_t *parts, struct ground_parts *out);

#endif
