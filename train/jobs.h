/* The cells of a scene as independent jobs: a list for the scheduler of a cluster, and a runner for
 * one machine that trains each cell in its own process.
 *
 * A job exchanges data only through its cell's folder: level<k>.ckpt, resume.ckpt, and done.json,
 * the done-file, which is written last. A job that finds a done-file with the same options and plan
 * ends at once. A job that finds resume.ckpt continues it. Any job may therefore be started again
 * at any time. A lock allows only one process in a folder.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_JOBS_H
#define TRAIN_JOBS_H

#include "train/base/config.h"

struct train_cell_result;
struct train_result;

enum jobs_state { JOBS_NEW, JOBS_STARTED, JOBS_DONE };

struct jobs_cell {
    char id[32];
    /* by the files in its folder; options are compared later, in training */
    enum jobs_state state;
    size_t photos; /* number of training photographs */
    /* steps of the levels in the order in which they are trained (schedule.turn) */
    uint32_t n_turns, steps[TRAIN_TURNS_MAX];
    double memory_bytes, cpu_s; /* as in struct expect; 0: not asked for */
};
struct jobs_list { /* in the order of the plan; {0} is empty; free with jobs_list_free */
    struct jobs_cell *cells;
    size_t n_cells;
};
/* Lists the cells that `citysplat train SCENE` would train, without opening a device, by the
 * plan in a file (NULL: the scene's own). With
 * cfg->coarse_only the list is the coarse model, or empty if the cells need none. `needs`: also
 * what each takes of memory and time, which looks at every photograph of every cell. Free *out with
 * jobs_list_free. ERR_ARG, ERR_DATA, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM as in train_run.
 */
enum err_code jobs_list(const char *scene_dir, const char *plan, const struct train_config *cfg,
                        bool needs, struct jobs_list *out, struct err *e) ERR_USE;
void jobs_list_free(struct jobs_list *l);
const char *jobs_state_name(enum jobs_state s); /* "new", "started", "done" */

/* How many cells of the list, which must know what each needs, are trained at a time where
 * cfg->jobs is 0. Small pictures do not keep two cores busy, so on a CPU a cell gets one core, and
 * as many are in work as --memory has room for. A GPU is kept busy by one. Opens the device to see
 * which it is. ERR_ARG, ERR_DEVICE. */
enum err_code jobs_at_once(const struct train_config *cfg, const struct jobs_list *list,
                           size_t *out, struct err *e) ERR_USE;
/* The same for n_cells cells of at most cell_bytes each, n_cores and memory_bytes. */
size_t jobs_fit(size_t n_cells, double cell_bytes, size_t n_cores, double memory_bytes);

/* Trains all cells, cfg->jobs (at least 1) at a time, the longest first. Each is a child process
 * `program train SCENE --cell ID` with its log in cells/<id>/train.log. Cores are divided evenly.
 * If cfg->device is a comma-separated list, slot k uses entry k modulo their number. A cell that
 * fails does not stop the others. The result is then the first error, with the cell's name.
 * `program` is the path of this executable. ERR_CANCEL: stopped by a signal; every child saved its
 * state. */
enum err_code jobs_run(const char *program, const char *scene_dir, const struct train_config *cfg,
                       struct train_result *out, struct err *e) ERR_USE;

#endif
