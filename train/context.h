/* Inside of train/: what a step of training needs besides the Gaussians: options, schedule, device,
 * renderer, photographs, loss and appearance, and where the run stands. level.c fills it and moves
 * it on; pruning, densification, importance, budgets, regularizers and checkpoints take it together
 * with the model (train/model.h) and know nothing of who called.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_CONTEXT_H
#define TRAIN_CONTEXT_H

#include "cells/cell.h"
#include "render/render.h"
#include "train/appearance_train.h"
#include "train/config.h"
#include "train/pose.h"
#include "train/schedule.h"
#include "train/timing.h"

struct dev;
struct footprint;
struct metrics_log;
struct model;
struct photo;
struct photo_loader;
struct photometric;
struct scene;
struct trim;

struct context { /* context_close */
    /* -- fixed for the run; all borrowed */
    const struct train_config *cfg;
    const struct scene *scene;
    const uint32_t *images; /* training photographs, indices into the scene's images */
    size_t n_images;
    struct dev *dev;
    struct render *render;
    struct photometric *loss;
    struct metrics_log *metrics; /* NULL: none are written */
    struct cell cell;
    const struct footprint *ground; /* NULL: not known, */
    const struct trim *rim;         /* nor where photographs end */
    struct schedule schedule[TRAIN_LEVELS_MAX];
    uint32_t n_levels;
    struct timing timing; /* the clock that run.c started; {0} in tests, where nobody reads it */
    double start_s;       /* clock_s() when this process took up the run */

    /* -- where the run stands: what a checkpoint holds */
    uint32_t at;                        /* schedule[at] is in work; n_levels = all done */
    uint32_t step;                      /* steps of this level that are done */
    bool pruned;                        /* its last step, prune_level, is done */
    size_t start;                       /* Gaussians inside the cell when this level began */
    double before_s;                    /* that earlier processes spent on the run */
    struct appearance_train appearance; /* {0}: without; opened before level_open */
    struct pose_set poses;              /* {0}: the scene's; opened before level_open */

    /* -- of the level in work */
    struct photo_loader *photos; /* opened by level_begin */
    cl_mem target;               /* uint8 [h][w][3] of the photograph that was compared last */
    size_t target_bytes;
    cl_mem mask; /* uint8 [h][w] of it, when it has one */
    size_t mask_bytes;
};
void context_close(struct context *ctx);

/* Seconds spent on the run so far, by all processes. */
double context_seconds(const struct context *ctx);
/* Of the level in work; of the last one when all are done. */
const struct schedule *context_schedule(const struct context *ctx);
/* Gaussians, inside the cell and out, that this level's budget allows. */
size_t context_most(const struct context *ctx);
/* No Gaussian over supported ground should be longer, metres: cfg->size_limit times how far apart
 * the level's budget is when it covers the cell, or two pixels of its photographs on the ground
 * where that is more. 0: no limit, or no ground that is known. */
double context_size_limit(const struct context *ctx);
/* How frames of a step are drawn, without appearance. */
struct render_options context_render_options(const struct context *ctx, uint32_t step);
/* The same in the appearance of a training photograph (an index into the scene's images), once the
 * warm-up is over. Its constants are borrowed until the next call. */
struct render_options context_photo_options(struct context *ctx, uint32_t step, uint32_t image);

/* Upload a photograph and run the loss of the last frame against it: its gradient is then in the
 * renderer's, and photometric_read waits for the value. Where the options say so the pixels that do
 * not fit are masked. ERR_MEM, ERR_DEVICE. */
enum err_code context_photo_loss(struct context *ctx, const struct photo *p, struct err *e) ERR_USE;
/* The same without gradients: for photometric_read alone. ERR_MEM, ERR_DEVICE. */
enum err_code context_photo_value(struct context *ctx, const struct photo *p,
                                  struct err *e) ERR_USE;
/* With Mip-Splatting: the model's 3-D filter for the photographs of the level in work, computed if
 * it is not that of the Gaussians as they are. Without: nothing. ERR_MEM, ERR_DEVICE. */
enum err_code context_filter(const struct context *ctx, struct model *m, struct err *e) ERR_USE;

#endif
