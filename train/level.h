/* Inside of train/: the training loop of one cell, and everything it holds. level.c knows
 * everybody; only run.c and tests include this.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LEVEL_H
#define TRAIN_LEVEL_H

#include "train/background.h"
#include "train/budget.h"
#include "train/context.h"
#include "train/model.h"

struct importance;
struct photometric_value;
struct regularizer;

struct level {          /* level_close, also after an error */
    struct context ctx; /* its fixed part is set by whoever makes the level */
    struct model model;
    struct budget budget; /* the decisions of --budget-rule auto */
    struct background background;
    struct importance *importance; /* made on first use, as is the next */
    struct regularizer *regularizer;
    /* -- for people */
    uint32_t repaired;          /* non-finite updates seen so far */
    double loss_mean, mse_mean; /* running means */
    double offset_mean;         /* opacity offset, mean over the visible of the last step */
    double step_s;              /* when steps were last timed */
};

/* Device buffers and the first level at step 0, from these Gaussians. ERR_LIMIT, ERR_MEM,
 * ERR_DEVICE. */
enum err_code level_open(struct level *l, const struct gauss *g, struct err *e) ERR_USE;
void level_close(struct level *l);
/* Open the photographs of the level in work and set the optimiser. After level_open, level_next and
 * state_load. ERR_MEM, ERR_LIMIT. */
enum err_code level_begin(struct level *l, struct err *e) ERR_USE;
/* One step: photograph, forward pass, loss, backward pass with Adam, density control. `value` (may
 * be NULL) gets the loss, which waits for the device. ERR_DATA: the loss is not finite, or no
 * Gaussian is left; else the errors of photographs and device. */
enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e) ERR_USE;
/* The level in work is done: the next one starts from its Gaussians with a fresh optimiser.
 * ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code level_next(struct level *l, struct err *e) ERR_USE;

#endif
