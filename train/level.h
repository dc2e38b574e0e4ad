/* Inside of train/: the training loop of one cell, and everything it holds. Only run.c and tests
 * include this.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LEVEL_H
#define TRAIN_LEVEL_H

#include "train/appearance_train.h"
#include "train/background.h"
#include "train/budget.h"
#include "train/fixed.h"
#include "train/gallery.h"
#include "train/model.h"
#include "train/stage.h"
#include "train/timing.h"

struct evaluate_score;
struct importance;
struct metrics_log;
struct photometric_value;
struct prune_report;
struct regularizer;
struct residual_list;
struct run_cell;

struct level { /* level_init; level_close, also after an error */
    /* -- fixed for the run */
    const struct train_config *cfg;
    struct engine engine;
    struct site site;
    struct metrics_log *metrics; /* borrowed; NULL: none are written */
    /* -- where it stands */
    struct stage stage;
    double seconds; /* that earlier processes spent on the run */
    /* -- what learns */
    struct model model;
    struct appearance_train appearance; /* {0}: without; opened before level_open */
    /* -- what it learns from, and what keeps it in bounds */
    struct gallery gallery;
    struct budget budget; /* the decisions of --budget-rule auto */
    struct background background;
    struct solid *solid;           /* made on first use */
    struct importance *importance; /* made on first use, as is the next */
    struct regularizer *regularizer;
    /* -- for people */
    struct timing timing;       /* started by run.c; {0} in tests, where nobody reads it */
    uint32_t repaired;          /* non-finite updates seen so far */
    double loss_mean, mse_mean; /* running means */
    double offset_mean;         /* opacity offset, mean over the visible of the last step */
    double step_s;              /* when steps were last timed */
};

/* The part that is fixed for the run of one cell. `images` [n_images]: the photographs that train.
 * The parts of a level refer to each other: it must not move from here on. */
void level_init(struct level *l, const struct run_cell *job, const uint32_t *images,
                size_t n_images);
/* Device buffers and the first level at step 0, from these Gaussians. ERR_LIMIT, ERR_MEM,
 * ERR_DEVICE. */
enum err_code level_open(struct level *l, const struct gauss *g, struct err *e) ERR_USE;
/* Instead of level_open: go on from a state that level_save wrote. ERR_ARG, ERR_DATA, ERR_FORMAT,
 * ERR_NOENT, ERR_IO: as state_load; ERR_MEM, ERR_DEVICE. */
enum err_code level_resume(struct level *l, const char *path, struct err *e) ERR_USE;
void level_close(struct level *l);
/* Open the photographs of the level in work and set the optimiser. After level_open, level_resume
 * and level_next. ERR_MEM, ERR_LIMIT. */
enum err_code level_begin(struct level *l, struct err *e) ERR_USE;
/* One step: photograph, forward pass, loss, backward pass with Adam, density control. `value` (may
 * be NULL) gets the loss, which waits for the device. ERR_DATA: the loss is not finite, or no
 * Gaussian is left; else the errors of photographs and device. */
enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e) ERR_USE;
/* After the last step of a level: remove what contributes nothing (train/prune.h) and fit the
 * smallest harmonics (train/harmonics.h). Does nothing where that was done before. ERR_CANCEL:
 * stopped by a signal; ERR_MEM, ERR_DEVICE, and what photo_loader_get_nth fails with. */
enum err_code level_prune(struct level *l, struct prune_report *out,
                          struct residual_list *residuals, struct err *e) ERR_USE;
/* The level in work is done: the next one starts from its Gaussians with a fresh optimiser.
 * ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code level_next(struct level *l, struct err *e) ERR_USE;

/* The state to go on from, after `seconds` of all processes. ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code level_save(struct level *l, double seconds, const char *path, struct err *e) ERR_USE;
/* The result of the level in work; score may be NULL. ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code level_save_result(struct level *l, const char *path,
                                const struct evaluate_score *score, struct err *e) ERR_USE;

struct level_refit { /* {0} before level_refit_open; level_refit_end */
    bool needed;
    struct schedule was; /* of the level */
    bool was_shared;
};
/* After all levels (train/refit.h): take up level `at` (from 0) from its checkpoint, ready for
 * level_step. r->needed says whether that has to be: false where the level has the network already,
 * and then nothing is open. ERR_MEM, ERR_DEVICE; ERR_NOENT, ERR_FORMAT, ERR_DATA, ERR_IO: the
 * checkpoint. */
enum err_code level_refit_open(struct level_refit *r, struct level *l, uint32_t at,
                               const char *path, struct err *e) ERR_USE;
/* After its steps: harmonics as at the end of every level. ERR_MEM, ERR_DEVICE. */
enum err_code level_refit_finish(struct level *l, struct err *e) ERR_USE;
/* The stage is what it was after the level's training, so that level_save_result writes it so. */
void level_refit_end(struct level_refit *r, struct level *l);
/* All levels are done. */
void level_end(struct level *l);

#endif
