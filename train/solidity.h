/* Internal to train/: the terms of the loss that make surfaces solid (loss/solid.h), at a step.
 * They act on the frame that is compared with the photograph.
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
struct solidity; /* kernels, and known depths */
struct stage;
struct train_config;

/* Returns whether they act at the current step. */
bool solidity_acts(const struct train_config *cfg, const struct stage *at);
/* The unit of depth of frames, in metres: the height of the flight, or the edge of the cell. */
double solidity_unit_m(const struct site *site);
/* Before the frame of the step: hands over, without waiting, what the terms compare it with.
 * supported [h][w]: not 0 where the photograph shows supported ground; NULL: nowhere; it must stay
 * as it is until render_forward returns. *own is NULL at first; free it with solidity_free.
 * ERR_DATA: no map of --depth-prior can be used. Errors of its files; ERR_MEM, ERR_DEVICE. */
enum err_code solidity_hand_over(struct solidity **own, const struct site *site,
                                 const struct gallery *gallery, const struct stage *at,
                                 const struct photo *photo, const uint8_t *supported,
                                 struct err *e) ERR_USE;
/* Writes the gradient of the frame's moments of depth, after render_forward with the unit of the
 * site. ERR_MEM, ERR_DEVICE. */
enum err_code solidity_step(struct solidity *own, const struct gallery *gallery,
                            struct err *e) ERR_USE;

void solidity_free(struct solidity **own);

#endif
