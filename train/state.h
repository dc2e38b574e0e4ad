/* Inside of train/: a level in training, saved and restored.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_STATE_H
#define TRAIN_STATE_H

#include "train/stage.h"
#include "train/state_check.h"

struct budget;
struct ckpt_rows;
struct engine;
struct evaluate_score;
struct model;

struct state { /* what a checkpoint holds besides the Gaussians; all borrowed but `at` */
    struct state_run run;
    struct stage at;
    struct appearance_train *appearance;
    struct budget *budget;
    double seconds; /* spent on the run so far, by all processes */
};
/* Everything needed to go on, and where the run stands. ERR_IO: cannot be written; ERR_MEM,
 * ERR_DEVICE. */
enum err_code state_save(const struct model *m, const struct state *s, const char *path,
                         struct err *e) ERR_USE;
/* Back into a model that was not opened, and into s, whose `run` and schedules are set: at,
 * appearance, budget and seconds become those that were saved. ERR_ARG names the first
 * option that differs from the saved run's; ERR_DATA: another cell or other photographs;
 * ERR_FORMAT: not such a file; ERR_NOENT; ERR_IO: cannot be read. model_close it, also after an
 * error. */
enum err_code state_load(struct model *m, const struct engine *with, struct state *s,
                         const char *path, struct err *e) ERR_USE;
/* The result of the level in work. With Mip-Splatting the model's filter has to be current. `score`
 * may be NULL. ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code state_save_level(const struct model *m, const struct state *s, const char *path,
                               const struct evaluate_score *score, struct err *e) ERR_USE;
/* What such a result says of itself: Gaussians, and scores of the test photographs, NaN without.
 * ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code state_read_level(const char *path, size_t *n, double *psnr_db, double *ssim,
                               struct err *e) ERR_USE;

/* The Gaussians of a checkpoint into a model that was opened for as many, by the slice. ERR_FORMAT,
 * ERR_IO, ERR_MEM, ERR_DEVICE. */
enum err_code state_fill_rows(struct model *m, const struct ckpt_rows *c, struct err *e) ERR_USE;

#endif
