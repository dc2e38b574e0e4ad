/* Inside of train/: the terms of the loss that make surfaces solid (loss/solid.h), at a step. They
 * act on the frame that is compared with the photograph.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SOLIDITY_H
#define TRAIN_SOLIDITY_H

#include <stdbool.h>
#include <stdint.h>

#include "core/err.h"

struct gallery;
struct photo;
struct site;
struct solid;
struct stage;
struct train_config;

/* Do they act at the step in work? */
bool solidity_acts(const struct train_config *cfg, const struct stage *at);
/* The unit of depth of frames, metres: how high the survey was flown, or the edge of the cell. */
double solidity_unit_m(const struct site *site);
/* After render_forward with this unit: the gradient of the frame's moments of depth. supported
 * [h][w]: not 0 where the photograph shows supported ground; NULL: nowhere. *own: NULL at first;
 * solid_close it. ERR_MEM, ERR_DEVICE. */
enum err_code solidity_step(struct solid **own, const struct gallery *gallery,
                            const struct stage *at, const struct photo *photo,
                            const uint8_t *supported, struct err *e) ERR_USE;

#endif
