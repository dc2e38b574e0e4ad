/* Internal to train/: saves and restores a level in training.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STATE_H
#define TRAIN_STATE_H

#include "train/base/stage.h"
#include "train/state_check.h"

struct ckpt_rows;
struct engine;
struct evaluate_score;
struct model;

struct state { /* content of a checkpoint besides the Gaussians; all borrowed except `at` */
    struct state_run run;
    struct stage at;
    struct appearance_train *appearance;
    double seconds; /* time of the run so far, in all processes */
    double pixel_m; /* of the level's photographs, on the ground; 0: not known */
    /* state_load: with `owes`, the first step that the model needs to know (model_owe) */
    bool owes;
    uint32_t owes_from;
};
/* Saves everything that is needed to continue. ERR_IO: it cannot be written. ERR_MEM, ERR_DEVICE.
 */
enum err_code state_save(struct model *m, const struct state *s, const char *path,
                         struct err *e) ERR_USE;
/* Restores a state into a model that is not open, and into s. s->run and the schedules must be set;
 * at, appearance and seconds become the saved ones. Call model_close afterwards, also after
 * an error. ERR_ARG names the first option that differs from the saved run. ERR_DATA: another cell
 * or other photographs. ERR_FORMAT: it is no such file. ERR_NOENT. ERR_IO: it cannot be read.
 * ERR_MEM, ERR_DEVICE. */
enum err_code state_load(struct model *m, const struct engine *with, struct state *s,
                         const char *path, struct err *e) ERR_USE;
/* Saves the result of the current level. `score` may be NULL. ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code state_save_level(struct model *m, const struct state *s, const char *path,
                               const struct evaluate_score *score, struct err *e) ERR_USE;
/* Reads the number of Gaussians of such a result, and the scores of the test photographs; NaN:
 * none. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code state_read_level(const char *path, size_t *n, double *psnr_db, double *ssim,
                               struct err *e) ERR_USE;

/* Copies the Gaussians of a checkpoint, in slices, into a model that was opened for as many.
 * ERR_FORMAT, ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code state_fill_rows(struct model *m, const struct ckpt_rows *c, struct err *e) ERR_USE;

#endif
