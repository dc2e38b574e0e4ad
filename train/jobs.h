/* The cells of a scene as independent jobs: a list for a cluster's scheduler, and a runner for one
 * machine that trains each in a process of its own.
 *
 * A cell's folder is all that its job shares with the world: level<k>.ckpt, resume.ckpt, and
 * done.json, the done-file, which is written last. A job that finds its done-file (and the same
 * options and plan) has nothing to do, one that finds resume.ckpt goes on, so any job may be
 * started again at any time. A lock keeps two processes out of one folder.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_JOBS_H
#define TRAIN_JOBS_H

#include "train/config.h"

struct train_cell_result;
struct train_result;

enum jobs_state { JOBS_NEW, JOBS_STARTED, JOBS_DONE };

struct jobs_cell {
    char id[32];
    enum jobs_state state; /* by the files in its folder; options are compared when it is trained */
    size_t photos;         /* it trains on */
    uint32_t n_levels, steps[TRAIN_LEVELS_MAX];
};
struct jobs_list { /* {0} is empty; jobs_list_free. In the order of the plan. */
    struct jobs_cell *cells;
    size_t n_cells;
};
/* The cells that `citysplat train SCENE` would train, without opening a device.
 * jobs_list_free it. ERR_ARG, ERR_DATA, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM as of train_run. */
enum err_code jobs_list(const char *scene_dir, const struct train_config *cfg,
                        struct jobs_list *out, struct err *e) ERR_USE;
void jobs_list_free(struct jobs_list *l);
const char *jobs_state_name(enum jobs_state s); /* "new", "started", "done" */

/* Train all of them, cfg->jobs at a time, each as a child process `program train SCENE --cell ID`
 * with its log in cells/<id>/train.log. Cores are shared out evenly; where cfg->device is a
 * comma-separated list, slot k takes entry k modulo their number. A cell that fails does not stop
 * the others; the error returned then is the first one's, with the cell's name. ERR_CANCEL: stopped
 * by a signal; every child saved its state. `program` is the path of this executable. */
enum err_code jobs_run(const char *program, const char *scene_dir, const struct train_config *cfg,
                       struct train_result *out, struct err *e) ERR_USE;

#endif
