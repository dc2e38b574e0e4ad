/* Inside of train/: the done-file and the lock of a cell's folder.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DONE_H
#define TRAIN_DONE_H

#include "core/err.h"

struct train_cell_result;

/* Write cells/<id>/done.json: Gaussians, scores and file size of every level, seconds, version.
 * ERR_IO, ERR_MEM; ERR_FORMAT: a level's file is missing. */
enum err_code done_write(const char *cell_dir, const struct train_cell_result *r,
                         struct err *e) ERR_USE;
/* Read it into *out. ERR_NOENT: none. ERR_FORMAT: not a done-file, or a level's file is missing or
 * of another size. */
enum err_code done_read(const char *cell_dir, struct train_cell_result *out, struct err *e) ERR_USE;
/* Take the folder for this process; ERR_BUSY when another one has it, ERR_IO when it cannot be
 * written. The lock goes with the descriptor, also when the process is killed. */
enum err_code done_lock(const char *cell_dir, int *fd, struct err *e) ERR_USE;
void done_unlock(int *fd);

#endif
