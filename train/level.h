/* Inside of train/: the state of one cell in training. level.c moves it on, state.c saves and
 * restores it, score.c looks at it, train.c makes it. Nobody else includes this but tests.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LEVEL_H
#define TRAIN_LEVEL_H

#include "cells/cell.h"
#include "render/render.h"
#include "train/appearance_train.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/schedule.h"
#include "train/timing.h"

struct dev;
struct importance;
struct metrics_log;
struct permutation;
struct photo;
struct photo_loader;
struct photometric;
struct photometric_value;
struct regularizer;
struct render;
struct render_adam;
struct render_density_stats;
struct render_model;
struct render_options;
struct scene;

struct level {
    /* -- fixed for the run; all borrowed */
    const struct train_config *cfg;
    const struct scene *scene;
    const uint32_t *images; /* training photographs */
    size_t n_images;
    struct dev *dev;
    struct render *render;
    struct photometric *loss;
    struct importance *score;    /* made on first use by score.c, freed by level_close */
    struct regularizer *regular; /* the same, by regular.c */
    struct metrics_log *record;  /* NULL: none are written */
    struct cell cell;
    struct schedule schedule[TRAIN_LEVELS_MAX];
    uint32_t n_levels;
    struct timing spent; /* the clock that run.c started; {0} in tests, where nobody reads it */

    struct budget budget; /* the decisions of --budget auto */

    /* -- the state that a checkpoint holds */
    uint32_t at;               /* schedule[at] is in work; n_levels = all done */
    uint32_t step;             /* steps of this level that are done */
    bool pruned;               /* its last step, prune_level, is done */
    size_t start;              /* Gaussians inside the cell when this level began */
    struct render_model model; /* cap may exceed n */
    struct render_adam adam; /* moments in the layout of the model; step counts within the level */
    struct render_density_stats stats;
    bool filter_is_current;        /* model.filter is that of these Gaussians; with --aa mip only */
    struct appearance_train light; /* {0}: without appearance; opened before level_open */

    /* -- scratch */
    struct photo_loader *feed; /* of this level; opened by level_begin */
    cl_mem target;             /* uint8 [h][w][3] of the step's photograph */
    size_t target_bytes;
    cl_mem mask; /* uint8 [h][w] of the step's photograph, when it has one */
    size_t mask_bytes;
    uint32_t repaired;          /* non-finite updates seen so far */
    double loss_mean, mse_mean; /* running means for people */
    double offset_mean;         /* opacity offset, mean over the visible of the last step */
    double step_s;              /* when steps were last timed */
};

/* Device buffers and the first level at step 0, from these Gaussians. level_close it, also after an
 * error. */
enum err_code level_open(struct level *l, const struct gauss *g, struct err *e) ERR_USE;
void level_close(struct level *l);
/* Open the feed of the level in work. After level_open, level_next and a restore. */
enum err_code level_begin(struct level *l, struct err *e) ERR_USE;
/* One step: photograph, forward, loss, backward with Adam, density control. `value` (may be NULL)
 * gets the loss, which waits for the device. */
enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e) ERR_USE;
/* The level in work is done: the next one starts from its Gaussians with a fresh optimiser. */
enum err_code level_next(struct level *l, struct err *e) ERR_USE;
/* Gaussians as they are now. gauss_free it. */
enum err_code level_gauss(struct level *l, struct gauss *out, struct err *e) ERR_USE;
struct render_options level_render_options(const struct level *l, uint32_t step);
/* The same with the look of a training photograph, once the warm-up is over. */
struct render_options level_photo_options(struct level *l, uint32_t step, uint32_t image);
/* Room for like->n Gaussians of this kind, not yet filled, moments neither; `like` without arrays.
 * For level_open, and for a restore, which fills them. */
enum err_code level_reserve(struct level *l, const struct gauss *like, struct err *e) ERR_USE;
/* Other rows out of those there are: parameters as r says, moments 0 where that is PERMUTE_NEW. The
 * arrays are done one after the other, so that when they grow no more than one of them is there
 * twice. Statistics become 0. */
enum err_code level_move(struct level *l, const struct permutation *r, struct err *e) ERR_USE;
/* Draw the first n rows only, or again those that level_move made; the others stay. Statistics
 * become 0. */
enum err_code level_show(struct level *l, size_t n, struct err *e) ERR_USE;
/* The rows that are not shown are gone for good. */
enum err_code level_forget(struct level *l, struct err *e) ERR_USE;

/* Upload a photograph and run the loss of the last frame against it. */
enum err_code level_photo_loss(struct level *l, const struct photo *p, struct err *e) ERR_USE;
/* The same without gradients: for photometric_read alone. */
enum err_code level_photo_value(struct level *l, const struct photo *p, struct err *e) ERR_USE;

#endif
