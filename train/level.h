/* Internal to train/: the training loop of one cell, and all its state. Only run.c and tests
 * include this.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LEVEL_H
#define TRAIN_LEVEL_H

#include "train/base/fixed.h"
#include "train/base/stage.h"
#include "train/base/timing.h"
#include "train/model/appearance_train.h"
#include "train/model/model.h"
#include "train/photographs/background.h"
#include "train/photographs/gallery.h"

struct evaluate_score;
struct importance;
struct metrics_log;
struct photometric_value;
struct prune_report;
struct residual_list;
struct run_cell;
struct terms;

struct level { /* level_init, then level_close, also after an error */
    /* -- fixed for the run -- */
    const struct train_config *cfg;
    struct engine engine;
    struct site site;
    struct metrics_log *metrics; /* borrowed; NULL: no metrics are written */
    /* -- where it stands -- */
    struct stage stage;
    double seconds; /* time of earlier processes in this run */
    /* -- what is trained -- */
    struct model model;
    bool owes; /* the model needs to know the steps from owes_from on: see level_begin */
    uint32_t owes_from;
    struct appearance_train appearance; /* {0}: none; opened before level_open */
    /* -- photographs and the loss -- */
    struct gallery gallery;
    struct background background;
    struct terms *terms;           /* opened by level_begin */
    struct importance *importance; /* made on first use */
    /* -- for logs -- */
    struct timing timing;       /* run.c starts it; {0} in tests, which ignore it */
    uint32_t repaired;          /* number of non-finite updates so far */
    double loss_mean, mse_mean; /* running means */
    double offset_mean; /* opacity offset, mean over the visible Gaussians of the last step */
    double step_s;      /* time of the last measurement of step times */
};

/* Sets what is fixed for the run of one cell. `images` [n_images]: the training photographs. Parts
 * of a level point to each other, so it must not be moved from here on. */
void level_init(struct level *l, const struct run_cell *job, const uint32_t *images,
                size_t n_images);
/* Allocates device buffers and begins the first level at step 0 with these Gaussians. ERR_LIMIT,
 * ERR_MEM, ERR_DEVICE. */
enum err_code level_open(struct level *l, const struct gauss *g, struct err *e) ERR_USE;
/* Continues from a state of level_save, instead of level_open. ERR_ARG, ERR_DATA, ERR_FORMAT,
 * ERR_NOENT, ERR_IO as in state_load; ERR_MEM, ERR_DEVICE. */
enum err_code level_resume(struct level *l, const char *path, struct err *e) ERR_USE;
void level_close(struct level *l);
/* Opens the photographs of the current level and the terms of the loss, and sets the optimiser.
 * Call it after level_open and level_resume; level_next calls it. ERR_MEM, ERR_LIMIT, and the
 * errors of terms_open. */
enum err_code level_begin(struct level *l, struct err *e) ERR_USE;
/* Makes one step: photograph, forward pass, loss, backward pass with Adam, density control. `value`
 * (may be NULL) gets the loss, which waits for the device. ERR_DATA: the loss is not finite, or no
 * Gaussian is left. Else the errors of photographs and device. */
enum err_code level_step(struct level *l, struct photometric_value *value, struct err *e) ERR_USE;
/* Ends a level after its last step: removes Gaussians that contribute nothing
 * (train/density/prune.h) and reduces harmonics (train/model/harmonics.h). If that was done before,
 * it does nothing. ERR_CANCEL: stopped by a signal. ERR_MEM, ERR_DEVICE, and the errors of
 * photo_loader_get_nth. */
enum err_code level_prune(struct level *l, struct prune_report *out,
                          struct residual_list *residuals, struct err *e) ERR_USE;
/* Goes to the next level, which starts from the present Gaussians with a new optimiser. ERR_MEM,
 * ERR_LIMIT, ERR_IO, ERR_DEVICE.
 */
enum err_code level_next(struct level *l, struct err *e) ERR_USE;

/* Saves the state to continue from. `seconds`: time of all processes so far. ERR_IO, ERR_MEM,
 * ERR_DEVICE. */
enum err_code level_save(struct level *l, double seconds, const char *path, struct err *e) ERR_USE;
/* Saves the result of the current level; score may be NULL. ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code level_save_result(struct level *l, const char *path,
                                const struct evaluate_score *score, struct err *e) ERR_USE;

/* Goes back to the end of the finest level, which level_save saved, when coarser ones were made of
 * it. ERR_ARG, ERR_DATA, ERR_FORMAT, ERR_NOENT, ERR_IO, ERR_MEM, ERR_DEVICE as in level_resume. */
enum err_code level_back(struct level *l, const char *path, struct err *e) ERR_USE;

struct level_refit { /* {0} before level_refit_open; end with level_refit_end */
    bool needed;
    struct schedule was; /* schedule of the level's training */
    bool was_shared;
};
/* Prepares a refit after all levels (train/refit.h): loads level `at` (from 0) from its checkpoint,
 * ready for level_step. r->needed is false if the level has the final network already; then nothing
 * is loaded. ERR_MEM, ERR_DEVICE. ERR_NOENT, ERR_FORMAT, ERR_DATA, ERR_IO: of the checkpoint. */
enum err_code level_refit_open(struct level_refit *r, struct level *l, uint32_t at,
                               const char *path, struct err *e) ERR_USE;
/* Call it after the steps of a refit: it reduces harmonics, as at the end of every level. ERR_MEM,
 * ERR_DEVICE. */
enum err_code level_refit_finish(struct level *l, struct err *e) ERR_USE;
/* Restores the stage after the level's training, which level_save_result then writes. */
void level_refit_end(struct level_refit *r, struct level *l);

struct level_last { /* level_last_open, then level_last_end, also after an error */
    struct schedule was;
    struct gallery gallery;
};
/* Prepares a last fit after all levels: the present Gaussians, which are those of the finest level,
 * ready for level_step with these photographs. `windows` as in struct gallery; both are borrowed
 * until level_last_end. ERR_MEM, ERR_LIMIT, and the errors of terms_open. */
enum err_code level_last_open(struct level_last *r, struct level *l, const uint32_t *images,
                              size_t n_images, const struct camera_window *windows,
                              struct err *e) ERR_USE;
/* Restores photographs and stage of the level's training, which level_save_result then writes. */
void level_last_end(struct level_last *r, struct level *l);
/* Marks all levels as done. */
void level_end(struct level *l);

#endif
