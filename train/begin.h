/* Internal to train/: everything before the first step of a cell.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_BEGIN_H
#define TRAIN_BEGIN_H

#include "core/base.h"
#include "scene/cells/footprint.h"
#include "scene/cells/trim.h"
#include "train/base/schedule.h"
#include "train/model/appearance_train.h"
#include "train/photographs/inputs.h"

struct run_cell;
struct stage;
struct train_cell_result;

struct begin { /* {.job, .lock_fd = -1} at first; call begin_close, also after an error */
    const struct run_cell *job; /* borrowed */
    char dir[FILE_PATH_MAX], resume_path[FILE_PATH_MAX];
    bool resumes; /* a saved state exists and shall be continued */
    /* those that train, then with --final-all the test photographs */
    uint32_t *all;
    size_t n_all;
    /* [n_all] part of each that shows the cell; NULL: all of each */
    struct camera_window *windows;
    double *shares; /* sizes of these parts as shares (scene/cells/window.h) */
    struct schedule levels[TRAIN_LEVELS_MAX];
    struct appearance_train appearance; /* {0}: none; the level takes it over */
    struct footprint ground;            /* nx 0: not known */
    struct trim rim;
    struct inputs inputs; /* hashes of the run's inputs */
    int lock_fd;
};

/* The file of a level's result; levels count from 1. ERR_LIMIT: the path is too long. */
enum err_code begin_level_path(const struct begin *b, uint32_t level, char *out,
                               struct err *e) ERR_USE;
/* The file with the state of the finest level after its last step. When coarser levels have been
 * made from that level, its final fit continues from this file. ERR_LIMIT: the path is too long. */
#define BEGIN_FINEST "finest.ckpt"
enum err_code begin_finest_path(const struct begin *b, char *out, struct err *e) ERR_USE;
/* Chooses photographs, windows and budgets, and touches no file. ERR_ARG, ERR_DATA, ERR_LIMIT,
 * ERR_MEM. */
enum err_code begin_budget(struct begin *b, struct err *e) ERR_USE;
/* Prepares a run. It locks the folder, chooses budgets, computes the known ground,
 * and logs what the run needs. *done: the run is complete already, and *out has its result.
 * ERR_BUSY, ERR_ARG, ERR_DATA, ERR_LIMIT, ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_MEM as in run_cell. */
enum err_code begin_run(struct begin *b, struct train_cell_result *out, bool *done,
                        struct err *e) ERR_USE;
void begin_close(struct begin *b);
/* Whether a last fit with all photographs follows the levels (--final-all). */
bool begin_wants_last(const struct begin *b);
/* Makes the first Gaussians of a new run. Free *out with gauss_free. ERR_DATA, ERR_MEM. */
enum err_code begin_gauss(const struct begin *b, const struct appearance_train *appearance,
                          struct gauss *out, struct err *e) ERR_USE;
/* Reads the scores of the levels that were finished before the one in work into *out. ERR_NOENT,
 * ERR_FORMAT, ERR_IO: of a level's file. ERR_MEM. */
enum err_code begin_earlier_levels(const struct begin *b, const struct stage *at,
                                   struct train_cell_result *out, struct err *e) ERR_USE;
/* Writes config.jsonc beside the results. --config with this file repeats the run. ERR_IO, ERR_MEM.
 */
enum err_code begin_write_config(const struct begin *b, struct err *e) ERR_USE;

#endif
